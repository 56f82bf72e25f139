//! Cameras: extreme fields of view, principal points and picture sizes.

use splat_op::{CameraModel, Intrinsics};

use crate::case::HardCase;
use crate::scene::{HardScene, Splat, TruthSource, camera};

pub fn cases() -> Vec<HardCase> {
    let focal = |width: usize, degrees: f64| width as f64 / (2.0 * (degrees / 2.0).to_radians().tan());
    let plain = camera();
    let wide = plain.with_focal(focal(60, 170.0), focal(60, 170.0));
    let narrow = plain.with_focal(focal(60, 1.0), focal(60, 1.0));
    let sized = |width: usize, height: usize| {
        let centre_px = [0.47 * width as f64, 0.52 * height as f64];
        let lens = Intrinsics::pinhole(width, height, [plain.fx, plain.fy], centre_px);
        HardScene { label: format!("{width} × {height}"), ..view(lens) }
    };
    let offset =
        |cx: f64, cy: f64| HardScene { label: format!("{cx}, {cy}"), ..view(plain.with_principal_point(cx, cy)) };
    vec![
        HardCase::scenes(
            "1° field of view",
            "x/z is tiny and is multiplied by a focal length of thousands of pixels",
            vec![view(narrow)],
        )
        .hardness("fx 3438 px"),
        HardCase::scenes(
            "170° field of view",
            "slopes reach eleven, and the affine approximation is clamped at its limit for most of the view",
            vec![view(wide)],
        )
        .hardness("fx 2.6 px"),
        HardCase::scenes(
            "principal point outside the picture",
            "the projected centre is a difference of large numbers",
            vec![offset(-400.0, 900.0), offset(30.5, -2000.0), offset(5000.0, 20.0)],
        )
        .hardness("5000 px"),
        HardCase::scenes(
            "fx / fy = 10 and 1/10",
            "round splats become needles in the picture",
            vec![view(plain.with_focal(plain.fx, 6.0)), view(plain.with_focal(6.0, plain.fy))],
        ),
        HardCase::scenes("1 × 1 picture", "the only tile has one pixel", vec![sized(1, 1)]),
        HardCase::scenes(
            "1 × 5000 and 5000 × 1 pictures",
            "every tile is cut to a width or height of one pixel, and coordinates have few digits after the decimal point",
            vec![sized(1, 5000), sized(5000, 1)],
        )
        .hardness("5000 px"),
        HardCase::scenes(
            "pictures with incomplete tiles",
            "tiles at the border lie partly outside the picture",
            vec![sized(17, 33), sized(31, 16), sized(16, 16), sized(15, 47)],
        ),
        HardCase::scenes(
            "parallel rays",
            "a splat's picture does not depend on its distance, which spans eight digits",
            vec![parallel()],
        )
        .hardness("depths of 0.05 to 2e6"),
        HardCase::scenes(
            "panorama, splats at the poles",
            "longitudes mean nothing there, and a splat is as wide as the picture",
            vec![all_around(&[[0.0, -2.0, 0.0], [0.01, -3.0, -0.02], [1e-6, 2.5, 1e-6], [0.6, 0.2, 2.0]])],
        ),
        HardCase::scenes(
            "panorama, splats across the seam",
            "a splat shows at both borders, and its longitude jumps by 360°",
            vec![all_around(&[[0.0, 0.1, -2.0], [1e-7, -0.8, -3.0], [-0.1, 1.9, -2.0], [0.6, 0.2, 2.0]])],
        ),
    ]
}

/// Splats on parallel rays, far and near, seen at 12 px per scene unit.
fn parallel() -> HardScene {
    let mut lens = camera();
    lens.model = CameraModel::Orthographic;
    (lens.fx, lens.fy) = (12.0, 12.5);
    let at = |px: [f64; 2], depth: f64, sigma: f64| {
        let splat = Splat::seen_by(&lens, px, 1.0, sigma);
        let [x, y, _] = splat.mean;
        let [a, b, c] = splat.scale;
        splat.mean([x, y, depth]).scale([a, 0.4 * b, 1.3 * c])
    };
    let splats = [
        at([20.0, 18.0], 0.05, 3.0),
        at([25.0, 20.0], 40.0, 6.0).colour(&[0.1, 0.8, 0.5]).quat([0.3, 0.8, 0.1, -0.4]),
        at([45.0, 30.0], 2e6, 5.0).colour(&[0.9, 0.1, 0.9]).opacity(0.95),
    ];
    HardScene::new("depths", &splats).with_camera(lens).with_truth(TruthSource::Twin)
}

/// Splats at some centres around the camera, in a panorama.
fn all_around(centres: &[[f64; 3]]) -> HardScene {
    let splat = |(i, &mean): (usize, &[f64; 3])| {
        let splat = Splat::at([0.0; 2], 1.0, 1.0).mean(mean).scale([0.5, 0.2, 0.3]);
        let shade = i as f64 / centres.len() as f64;
        splat.colour(&[1.0 - shade, 0.4, shade])
    };
    let splats: Vec<Splat> = centres.iter().enumerate().map(splat).collect();
    // At this width no pixel's centre lies on an edge of the cube, where rounding chooses the face.
    HardScene::new("all around", &splats).as_panorama(64, 32)
}

/// Three layers whose positions and sizes scale with the picture.
fn view(lens: Intrinsics) -> HardScene {
    let (width, height) = (lens.width as f64, lens.height as f64);
    let size = (width.min(height) / 8.0).max(0.7);
    let at = |x: f64, y: f64, depth: f64, sigma: f64| {
        let splat = Splat::seen_by(&lens, [x * width, y * height], depth, sigma);
        let [a, b, c] = splat.scale;
        splat.scale([a, 0.4 * b, 1.3 * c])
    };
    let splats = [
        at(0.4, 0.45, 3.0, size),
        at(0.55, 0.5, 5.0, 2.0 * size).colour(&[0.1, 0.8, 0.5]).quat([0.3, 0.8, 0.1, -0.4]),
        at(0.8, 0.3, 8.0, 0.6 * size).colour(&[0.9, 0.1, 0.9]).opacity(0.95),
    ];
    HardScene::new("plain", &splats).with_camera(lens)
}
