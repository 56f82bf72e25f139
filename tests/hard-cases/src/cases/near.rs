//! The near plane, the inside of splats, and the border of the view.

use crate::case::HardCase;
use crate::random::Random;
use crate::scene::{HardScene, SMOOTH, Splat, camera};

pub fn cases() -> Vec<HardCase> {
    let near = SMOOTH.near as f32;
    let at_near = |label: &str, z: f32, culled: &[usize]| {
        let z = f64::from(z);
        let hard = Splat::at([16.4, 30.1], z, 1.6);
        HardScene::new(label, &[hard]).with_neighbour(&neighbour()).with_culled(culled).holding_depth()
    };
    let behind = |label: &str, z: f64| {
        let hard = Splat::at([20.0, 20.0], 1.0, 8.0).mean([0.1, -0.2, z]);
        HardScene::new(label, &[hard]).with_neighbour(&neighbour()).with_culled(&[0])
    };
    let lens = camera();
    // Slopes at which the Jacobian is clamped.
    let margin = |size: usize, focal: f64| SMOOTH.jacobian_margin * size as f64 / (2.0 * focal);
    let limit_x = (lens.width as f64 - lens.cx) / lens.fx + margin(lens.width, lens.fx);
    let limit_y = -lens.cy / lens.fy - margin(lens.height, lens.fy);
    let sloped = |label: String, x: f64, y: f64| {
        let hard = Splat::at([20.0, 20.0], 2.0, 9.0).mean([2.0 * x, 2.0 * y, 2.0]).scale([0.4, 0.3, 0.5]);
        HardScene::new(label, &[hard, background_splat()])
    };
    vec![
        HardCase::scenes(
            "centre at the near plane ± 1 ulp",
            "one ulp decides whether a splat is drawn, a hundred times as large as one unit farther away",
            vec![
                at_near("one ulp behind it", near.next_up(), &[]),
                at_near("on it", near, &[0]),
                at_near("one ulp before it", near.next_down(), &[0]),
            ],
        )
        .hardness("z 0.01 ± 9e-10"),
        HardCase::scenes(
            "crosses the camera plane",
            "half of it is behind the camera, where the projection is undefined",
            vec![crossing("along the view", [0.1, 0.1, 3.0]), crossing("all around", [2.0, 2.5, 3.0])],
        ),
        HardCase::scenes(
            "camera inside a splat",
            "the Jacobian grows with 1/z², and the centre projects far outside the picture",
            vec![
                inside("before the centre", [0.01, -0.008, 0.05]),
                inside("beside the centre", [0.3, 0.2, 0.05]),
                inside("at the near plane", [0.002, 0.001, 0.0101]),
            ],
        )
        .hardness("scale 1, z 0.05"),
        HardCase::scenes(
            "centre on the optical axis",
            "offsets and slopes are exactly zero, and so are the lateral components of the direction",
            vec![
                HardScene::new("features", &[axial().colour(&[0.5, 0.2, 0.8]), background_splat()]),
                HardScene::new("harmonics", &[harmonic(axial()), harmonic(background_splat())]).with_harmonics(3),
            ],
        ),
        HardCase::scenes(
            "grazing the border of the view",
            "the slope in the Jacobian is clamped at a limit beyond the border, where its gradient jumps",
            [1.0 - 1e-4, 1.0 + 1e-4, 1.5]
                .into_iter()
                .flat_map(|share| {
                    [
                        sloped(format!("{share} of the limit right"), share * limit_x, 0.05),
                        sloped(format!("{share} of the limit above"), -0.04, share * limit_y),
                        sloped(format!("{share} of both limits"), share * limit_x, share * limit_y),
                    ]
                })
                .chain([
                    sloped("on the left edge".into(), -lens.cx / lens.fx, 0.1),
                    sloped("on the lower edge".into(), 0.1, (lens.height as f64 - lens.cy) / lens.fy),
                ])
                .collect(),
        )
        .hardness("limit ± 1e-4"),
        HardCase::scenes(
            "behind the camera",
            "its projection is a mirror image: within range, and wrong",
            vec![behind("far", -3.0), behind("by the near distance", -0.01), behind("on the camera plane", 0.0)],
        ),
    ]
}

fn neighbour() -> Splat {
    Splat::at([47.2, 9.4], 2.0, 1.5).colour(&[0.3, 0.9, 0.6])
}

fn background_splat() -> Splat {
    Splat::at([30.0, 24.0], 6.0, 7.0).colour(&[0.1, 0.8, 0.5])
}

fn crossing(label: &str, scale: [f64; 3]) -> HardScene {
    let hard = Splat::at([20.0, 16.0], 0.5, 1.0).scale(scale).quat([0.95, 0.1, 0.2, -0.1]);
    HardScene::new(label, &[hard, background_splat()])
}

fn inside(label: &str, mean: [f64; 3]) -> HardScene {
    let hard = Splat::at([20.0, 16.0], 1.0, 1.0).mean(mean).scale([1.0, 0.7, 1.3]);
    HardScene::new(label, &[hard, background_splat()])
}

fn axial() -> Splat {
    Splat::at([28.5, 22.5], 2.0, 4.0)
}

/// Replaces features by SH coefficients of degree 3.
fn harmonic(splat: Splat) -> Splat {
    let colour = Random::new((splat.mean[2] * 8.0) as u64).fill(48, -0.4, 0.4);
    splat.colour(&colour)
}
