//! Opacity and transmittance: saturated, at the thresholds, and through thousands of layers.

use splat_op::{Intrinsics, RenderOptions};

use crate::case::HardCase;
use crate::random::Random;
use crate::scene::{HardScene, SMOOTH, STANDARD, Splat, TruthSource};

/// Number of layers of a deep stack.
const LAYERS: usize = 10_000;

pub fn cases() -> Vec<HardCase> {
    let unlimited = SMOOTH.with_alpha_max(1.0);
    let cut = STANDARD.alpha_min as f32;
    let limit = STANDARD.alpha_max as f32;
    vec![
        HardCase::scenes(
            "logit −50",
            "the opacity is too small to be visible, yet its gradient must be able to restore it",
            vec![saturated("−50", -50.0)],
        )
        .hardness("opacity 2e-22"),
        HardCase::scenes(
            "logit +50",
            "one minus the opacity is zero in f32, and so is the derivative of the logistic function computed from it",
            vec![saturated("+50", 50.0)],
        )
        .hardness("1 − opacity 2e-22"),
        HardCase::scenes(
            "opacity 0",
            "the derivative divides by the opacity",
            vec![HardScene::new("0", &[front(0.0)]).with_neighbour(&neighbour()).with_options(STANDARD)],
        ),
        HardCase::scenes(
            "opacity 1",
            "no light passes, and without the limit of 0.99 a formula that divides by `1 − α` divides by zero",
            vec![
                HardScene::new("alpha up to 0.99", &[front(1.0), behind()]),
                HardScene::new("alpha up to 1", &[front(1.0), behind()]).with_options(unlimited),
            ],
        )
        .hardness("1 − α = 0"),
        HardCase::scenes(
            "alpha at the cut ± 1 ulp",
            "one ulp decides whether a pixel is drawn; the backward pass must make the forward pass's decision",
            [("below", cut.next_down()), ("on it", cut), ("above", cut.next_up())]
                .map(|(label, opacity)| at_threshold(label, opacity, STANDARD))
                .into(),
        )
        .hardness("1/255 ± 5e-10"),
        HardCase::scenes(
            "alpha at its limit ± 1 ulp",
            "one ulp decides whether a pixel has a gradient",
            [("below", limit.next_down()), ("on it", limit), ("above", limit.next_up())]
                .map(|(label, opacity)| at_threshold(label, opacity, SMOOTH))
                .into(),
        )
        .hardness("0.99 ± 6e-8"),
        HardCase::scenes(
            "transmittance at its cut ± 1 ulp",
            "one ulp decides whether a pixel is finished, and thereby whether the layers behind it contribute",
            [("below", 0.25_f32.next_down()), ("on it", 0.25), ("above", 0.25_f32.next_up())]
                .map(|(label, cut)| finishing(label, f64::from(cut)))
                .into(),
        )
        .hardness("0.25 ± 3e-8"),
        HardCase::scenes(
            "10,000 layers of alpha 0.99",
            "the transmittance is zero after twenty layers; dividing it back loses every gradient",
            vec![stack("0.99", LAYERS, 0.99)],
        )
        .hardness("T 1e-20000"),
        HardCase::scenes(
            "10,000 layers of alpha 1/255",
            "the transmittance is rounded ten thousand times forwards and, if divided back, as many times backwards",
            vec![stack("1/255", LAYERS, 1.0 / 255.0)],
        )
        .hardness("T 9e-18"),
        HardCase::scenes(
            "transmittance below f32",
            "the transmittance leaves the range of f32 among the layers, through the subnormal numbers",
            vec![stack("0.7", 200, 0.7)],
        )
        .hardness("T 3e-105"),
    ]
}

fn neighbour() -> Splat {
    Splat::at([50.5, 8.5], 2.0, 1.3).colour(&[0.3, 0.9, 0.6])
}

/// A Gaussian at the exact centre of a pixel, so that its alpha there is its opacity.
fn front(opacity: f64) -> Splat {
    Splat::at([28.5, 22.5], 2.0, 1.4).opacity(opacity)
}

fn behind() -> Splat {
    Splat::at([30.1, 24.2], 3.0, 3.0).colour(&[0.1, 0.8, 0.5])
}

fn saturated(label: &str, logit: f64) -> HardScene {
    let store = |splat: Splat, logit: f64| {
        let scale = splat.scale.map(f64::ln);
        splat.scale(scale).opacity(logit)
    };
    let hard = store(Splat::at([24.8, 26.1], 2.0, 1.6), logit);
    HardScene::new(label, &[hard]).with_neighbour(&store(neighbour(), 0.85)).stored()
}

fn at_threshold(label: &str, opacity: f32, options: RenderOptions) -> HardScene {
    HardScene::new(label, &[front(f64::from(opacity))])
        .with_neighbour(&neighbour())
        .with_options(options)
        .with_truth(TruthSource::Twin)
        .holding_alpha()
}

/// Two layers that leave a transmittance of exactly a quarter at one pixel, and one layer behind them.
fn finishing(label: &str, transmittance_min: f64) -> HardScene {
    let layer = |depth: f64, opacity: f64| {
        let splat = Splat::at([28.5, 22.5], depth, 1.0).opacity(opacity);
        splat.colour(&[0.2 * depth, 0.5, 1.0 - 0.1 * depth])
    };
    HardScene::new(label, &[layer(2.0, 0.5), layer(3.0, 0.5), layer(4.0, 0.25)])
        .with_options(SMOOTH.with_transmittance_min(transmittance_min))
        .with_truth(TruthSource::Twin)
        .holding_alpha()
}

/// Wide layers in front of a small picture, in random order.
fn stack(label: &str, layers: usize, alpha: f64) -> HardScene {
    let lens = Intrinsics::pinhole(9, 7, [20.0, 20.0], [4.2, 3.1]);
    let mut random = Random::new(11);
    let splats: Vec<Splat> = (0..layers)
        .map(|_| {
            let px = [random.between(2.0, 7.0), random.between(1.0, 6.0)];
            let splat = Splat::seen_by(&lens, px, random.between(2.0, 9.0), 60.0);
            splat.opacity(alpha).colour(&random.fill(3, 0.0, 1.0))
        })
        .collect();
    HardScene::new(label, &splats).with_camera(lens).holding_depth()
}
