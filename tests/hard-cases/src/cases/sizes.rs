//! Sizes: from a millionth of a pixel to values whose squares overflow.

use burn::tensor::{DType, Device};

use crate::case::{CaseOutcome, HardCase, MeasuredDeviation, TestDevice};
use crate::compare::relative_error;
use crate::evaluate::{compensated_opacities, evaluate};
use crate::scene::{HardScene, SMOOTH, Splat, TruthSource};

/// The gradient of the standard deviations in [`crate::evaluate::GRADIENTS`].
const SCALES: usize = 2;

/// Largest error of a compensated gradient, relative to its largest element.
const COMPENSATED_BOUND: f64 = 1e-5;

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
        HardCase::check(
            "the compensation's gradient, and detached",
            "implementations that find it unstable treat the compensation as constant in the backward pass",
            |place| judge_detached(place, &compensated()),
        )
        .hardness(detached_hardness()),
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

/// Gaussians around the size at which the compensation matters, with the compensation.
fn compensated() -> Vec<HardScene> {
    let scene = |sigma_px: f64| {
        let hard = Splat::at([12.3, 30.8], 3.0, sigma_px);
        HardScene::new(format!("{sigma_px} px"), &[hard]).with_options(SMOOTH.with_antialias(true)).rounded()
    };
    [0.1, 0.3, 1.0, 3.0].map(scene).into()
}

/// Gradients of the standard deviations in f64, and without what flows through the compensation.
fn with_and_without(scene: &HardScene) -> [Vec<f64>; 2] {
    let (device, weights) = (Device::flex(), scene.weights());
    let with = evaluate(scene, &weights, &device, DType::F64).gradients[SCALES].values.clone();
    // The same picture from opacities that are compensated beforehand.
    let compensation = compensated_opacities(scene);
    let options = scene.options.with_antialias(false);
    let constant = HardScene { options, opacities: compensation, ..scene.clone() };
    [with, evaluate(&constant, &weights, &device, DType::F64).gradients[SCALES].values.clone()]
}

fn detached_hardness() -> String {
    let error = |scene: &HardScene| {
        let [with, without] = with_and_without(scene);
        format!("{:.0}% at {}", 100.0 * relative_error(&without, &with), scene.label)
    };
    let errors: Vec<String> = compensated().iter().map(error).collect();
    format!("detached, the gradient of the sizes is off by {}", errors.join(", "))
}

fn judge_detached(place: &TestDevice, scenes: &[HardScene]) -> CaseOutcome {
    let mut outcome = CaseOutcome::default();
    let mut worst = MeasuredDeviation::default();
    for scene in scenes {
        let [expected, detached] = with_and_without(scene);
        let found = evaluate(scene, &scene.weights(), &place.device, DType::F32);
        let error = relative_error(&found.gradients[SCALES].values, &expected);
        worst = worst.worst(MeasuredDeviation { error, used: error / COMPENSATED_BOUND });
        outcome.require(error <= COMPENSATED_BOUND, || format!("{}: off by {error:.1e}", scene.label));
        let lost = relative_error(&detached, &expected);
        outcome.require(lost > 0.01, || format!("{}: detaching changes nothing ({lost:.1e})", scene.label));
    }
    outcome.gradient = Some(worst);
    outcome
}
