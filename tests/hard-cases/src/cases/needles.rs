//! Needles and discs: one axis much longer, or much shorter, than the others.

use std::f64::consts::FRAC_1_SQRT_2;

use crate::case::HardCase;
use crate::scene::{HardScene, SMOOTH, Splat, camera};

/// Scale ratios.
const RATIOS: [f64; 3] = [1e2, 1e4, 1e6];

/// Standard deviation of the short axes of long Gaussians, px.
const SHORT_PX: f64 = 0.5;
/// Standard deviation of the long axes of thin Gaussians, px.
const LONG_PX: f64 = 6.0;

/// Centre of the Gaussians in the picture, px.
const CENTRE_PX: [f64; 2] = [26.3, 20.6];

pub fn cases() -> Vec<HardCase> {
    let mut cases = Vec::new();
    for ratio in RATIOS {
        let power = ratio.log10();
        for (plane, turns) in [("in the image plane", in_plane()), ("out of the plane", out_of_plane())] {
            let scenes = |short: f64, long: f64, disc: bool| {
                turns.iter().map(|(label, quat)| scene(label, *quat, short, long, disc)).collect::<Vec<_>>()
            };
            let named = |what: &str| format!("{what} 1e{power:.0} {plane}");
            cases.push(
                HardCase::scenes(
                    named("long needle"),
                    "the covariance's determinant is a difference of products that agree in most digits",
                    scenes(SHORT_PX, SHORT_PX * ratio, false),
                )
                .hardness(format!("ratio {ratio:.0e}")),
            );
            cases.push(
                HardCase::scenes(
                    named("thin needle"),
                    "two axes are far shorter than a pixel, and their gradients are tiny beside that of the long axis",
                    scenes(LONG_PX / ratio, LONG_PX, false),
                )
                .hardness(format!("ratio {ratio:.0e}")),
            );
            cases.push(
                HardCase::scenes(
                    named("thin disc"),
                    "edge-on it looks like a needle, and a small rotation changes which axis is visible",
                    scenes(LONG_PX / ratio, LONG_PX, true),
                )
                .hardness(format!("ratio {ratio:.0e}")),
            );
        }
    }
    let compensated = |turns: Vec<(String, [f64; 4])>| {
        let options = SMOOTH.with_antialias(true);
        let scene = |(label, quat): (String, _)| scene(&label, quat, 0.1, 1e3, false).with_options(options);
        turns.into_iter().map(scene).collect::<Vec<_>>()
    };
    cases.push(
        HardCase::scenes(
            "needle 1e4, compensated",
            "the compensation is the square root of a ratio of two determinants, and both lose their digits",
            [compensated(in_plane()), compensated(out_of_plane())].concat(),
        )
        .hardness("ratio 1e4"),
    );
    cases.push(
        HardCase::scenes(
            "long needle 1e4 beside a neighbour",
            "it crosses the whole picture, and any error of its slope would move it onto other Gaussians",
            in_plane().into_iter().enumerate().map(beside_a_neighbour).collect(),
        )
        .hardness("ratio 1e4"),
    );
    cases
}

/// Places a neighbour at a distance across the needle that is turned into an octant.
fn beside_a_neighbour((octant, (label, quat)): (usize, (String, [f64; 4]))) -> HardScene {
    const ACROSS_PX: f64 = 17.0;
    let (sin, cos) = degrees(octant).to_radians().sin_cos();
    let [x, y] = CENTRE_PX;
    let neighbour = Splat::at([x - ACROSS_PX * sin, y + ACROSS_PX * cos], 2.0, 0.5).colour(&[0.3, 0.9, 0.6]);
    HardScene::new(label, &[needle(quat, SHORT_PX, SHORT_PX * 1e4, false)]).with_neighbour(&neighbour)
}

/// Rotations about the line of observation, into each octant of the picture and off its axes.
fn in_plane() -> Vec<(String, [f64; 4])> {
    let turn = |octant: usize| {
        let degrees = degrees(octant);
        let half = degrees.to_radians() / 2.0;
        (format!("{degrees}°"), [half.cos(), 0.0, 0.0, half.sin()])
    };
    (0..8).map(turn).collect()
}

fn degrees(octant: usize) -> f64 {
    45.0 * octant as f64 + 17.0
}

/// Rotations of the x axis into each octant of space.
fn out_of_plane() -> Vec<(String, [f64; 4])> {
    let octants = (0..8).map(|octant: usize| [4, 2, 1].map(|bit| if octant & bit == 0 { -1.0 } else { 1.0 }));
    octants
        .map(|[x, y, z]| {
            // Not quite a diagonal, so that no two components are equal.
            let v = [0.6 * x, 0.5 * y, 0.62449979983984 * z];
            // The shortest rotation from the x axis to v: (1 + x·v, x × v), of any length.
            (format!("octant {x:+} {y:+} {z:+}"), [1.0 + v[0], 0.0, -v[2], v[1]])
        })
        .collect()
}

fn needle(quat: [f64; 4], short_px: f64, long_px: f64, disc: bool) -> Splat {
    let hard = Splat::at(CENTRE_PX, 3.0, 1.0).quat(quat);
    let px = 3.0 / camera().fx;
    let scale = if disc { [long_px, long_px, short_px] } else { [long_px, short_px, short_px] };
    hard.scale(scale.map(|s| s * px))
}

fn scene(label: &str, quat: [f64; 4], short_px: f64, long_px: f64, disc: bool) -> HardScene {
    let hard = needle(quat, short_px, long_px, disc);
    // A second layer, so that transmittances matter.
    let behind =
        Splat::at([30.0, 24.0], 4.0, 5.0).quat([FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2, 0.1]).colour(&[0.1, 0.8, 0.5]);
    HardScene::new(label, &[hard, behind])
}
