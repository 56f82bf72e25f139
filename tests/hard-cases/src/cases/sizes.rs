//! Sizes: from a millionth of a pixel to values whose squares overflow.

use crate::case::HardCase;
use crate::scene::{HardScene, SMOOTH, Splat, TruthSource};

pub fn cases() -> Vec<HardCase> {
    let antialiased = SMOOTH.with_antialias(true);
    let small = |sigma_px: f64| {
        let hard = Splat::at([12.3, 30.8], 3.0, sigma_px);
        HardScene::new(format!("{sigma_px:.0e} px"), &[hard]).with_neighbour(&neighbour())
    };
    let large = |label: &str, px: [f64; 2], sigma_px: f64| {
        let hard = Splat::at(px, 3.0, sigma_px).scale([1.0, 0.8, 1.2].map(|s| s * sigma_px * 3.0 / 60.0));
        HardScene::new(label, &[hard, Splat::at([30.0, 20.0], 5.0, 4.0).colour(&[0.2, 0.3, 0.9])])
    };
    vec![
        HardCase::scenes(
            "far below a pixel",
            "its size is lost beside the blur in every sum, and so is the gradient that would make it grow",
            vec![small(1e-3), small(1e-6)],
        )
        .hardness("1e-6 px"),
        HardCase::scenes(
            "far below a pixel, compensated",
            "the compensation is a ratio of two areas, one of them almost zero; below its floor it has no gradient",
            [0.3, 0.06, 1e-3, 1e-6].map(|px| small(px).with_options(antialiased)).into(),
        )
        .hardness("1e-6 px"),
        HardCase::scenes(
            "large, compensated",
            "the compensation differs from one only by the blur's share, a difference of almost equal areas",
            [30.0, 1e3, 1e5]
                .map(|px| large(&format!("{px:.0e} px"), [20.0, 15.0], px).with_options(antialiased))
                .into(),
        )
        .hardness("1e5 px"),
        HardCase::scenes(
            "larger than the screen",
            "it covers every tile, and moments over the picture are tiny beside its size",
            vec![large("in view", [31.0, 18.0], 1e3), large("beside the view", [-700.0, 900.0], 1e3)],
        )
        .hardness("1e3 px"),
        HardCase::scenes(
            "larger than the scene",
            "the far end of a splat is a million pictures away",
            vec![large("in view", [31.0, 18.0], 1e7), large("beside the view", [-5e5, 7e5], 1e7)],
        )
        .hardness("1e7 px"),
        HardCase::scenes(
            "log-scale −50",
            "a training run that diverged can store this value, and its squared scale is below the range of f32",
            vec![stored("−50", [-50.0; 3], TruthSource::Wide).with_neighbour(&logit(neighbour()))],
        )
        .hardness("2e-22 units"),
        HardCase::scenes(
            "log-scale +50",
            "a training run that diverged can store this value, and its squared scale is above the range of f32",
            vec![stored("+50", [50.0, 49.5, 50.2], TruthSource::Wide)],
        )
        .hardness("5e21 units"),
        HardCase::scenes(
            "log-scale +50, −50 and 0",
            "it is a needle whose determinant no float can represent and whose direction is within rounding error",
            vec![stored("mixed", [50.0, -50.0, 0.0], TruthSource::Twin)],
        )
        .hardness("ratio 3e43"),
    ]
}

/// A neighbour beside the hard Gaussians.
fn neighbour() -> Splat {
    Splat::at([47.2, 9.4], 2.0, 1.5).colour(&[0.3, 0.9, 0.6])
}

/// Converts scale and opacity to log scale and logit.
fn logit(splat: Splat) -> Splat {
    let scale = splat.scale.map(f64::ln);
    splat.scale(scale).opacity(0.85)
}

fn stored(label: &str, log_scale: [f64; 3], truth: TruthSource) -> HardScene {
    let hard = Splat::at([12.3, 30.8], 3.0, 1.0).scale(log_scale).opacity(0.4);
    HardScene::new(label, &[hard]).stored().with_truth(truth)
}
