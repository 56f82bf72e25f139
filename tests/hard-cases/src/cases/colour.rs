//! Colours: out of range, at the clamp, and of several orders of magnitude at once.

use crate::case::HardCase;
use crate::random::Random;
use crate::scene::{HardScene, Splat};

/// The constant function among the spherical harmonics, `1 / (2 √π)`.
const Y0: f64 = 0.282_094_791_773_878_14;

pub fn cases() -> Vec<HardCase> {
    vec![
        HardCase::scenes(
            "harmonics of 1e4",
            "a colour is a sum of terms of both signs, each a thousand times larger than the colour",
            [1, 2, 3, 4].map(large_harmonics).into(),
        )
        .hardness("coefficients 1e4"),
        HardCase::scenes(
            "negative colours at the clamp",
            "a clamped channel has no gradient while its neighbours do; a channel just above zero has its full gradient",
            vec![clamped()],
        )
        .hardness("colour ± 1e-4"),
        HardCase::scenes(
            "features of 1e-6, 1 and 1e6",
            "channels that span twelve orders of magnitude share a transmittance, and their gradients meet in one sum",
            vec![mixed("small first", [1e-6, 1.0, 1e6]), mixed("large first", [1e6, 1.0, 1e-6])],
        )
        .hardness("ratio 1e12"),
    ]
}

/// Two layers with different coefficients.
fn harmonics(label: String, degree: usize, colours: [Vec<f64>; 2]) -> HardScene {
    let [front, back] = colours;
    let splats = [Splat::at([24.3, 20.6], 3.0, 3.0).colour(&front), Splat::at([30.8, 24.1], 4.0, 5.0).colour(&back)];
    HardScene::new(label, &splats).with_harmonics(degree)
}

fn large_harmonics(degree: usize) -> HardScene {
    let mut random = Random::new(degree as u64);
    let count = 3 * (degree + 1) * (degree + 1);
    let colours = [random.fill(count, -1e4, 1e4), random.fill(count, -1e4, 1e4)];
    harmonics(format!("degree {degree}"), degree, colours)
}

fn clamped() -> HardScene {
    let coefficient = |colour: f64| (colour - 0.5) / Y0;
    let colours = [[-3.0, 1e-4, 0.7], [-1e-4, 0.4, -1e4]].map(|row| row.map(coefficient).to_vec());
    harmonics("degree 0".into(), 0, colours)
}

fn mixed(label: &str, sizes: [f64; 3]) -> HardScene {
    let mut random = Random::new(5);
    let splats: Vec<Splat> = (0..6)
        .map(|_| {
            let px = [random.between(18.0, 38.0), random.between(14.0, 30.0)];
            let splat = Splat::at(px, random.between(2.0, 6.0), random.between(1.0, 5.0));
            splat.colour(&sizes.map(|size| size * random.between(-1.0, 1.0)))
        })
        .collect();
    HardScene::new(label, &splats).with_background(&sizes.map(|size| 0.3 * size))
}
