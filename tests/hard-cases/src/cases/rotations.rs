//! Rotations: quaternions of zero or extreme length, and the two quaternions of each rotation.

use burn::tensor::DType;

use crate::case::{CaseOutcome, HardCase, TestDevice};
use crate::evaluate::{Outputs, evaluate};
use crate::scene::{HardScene, Splat, TruthSource};

/// A quaternion without special values.
const QUAT: [f64; 4] = [0.61, -0.42, 0.37, 0.55];

pub fn cases() -> Vec<HardCase> {
    vec![
        HardCase::scenes(
            "zero quaternion",
            "it has no direction, and normalising it gives NaN in every implementation without a check",
            [("0", 0.0), ("−0", -0.0)]
                .map(|(label, zero)| scene(label, [zero; 4]).with_culled(&[0]).with_truth(TruthSource::Twin))
                .into(),
        )
        .hardness("|q| 0"),
        HardCase::scenes(
            "quaternions of length 1e-15 to 1e-19",
            "the sum of squares is out of range, and the gradient is divided by the length",
            [1e-15, 1e-19].map(|length| scene(&format!("{length:.0e}"), QUAT.map(|q| q * length))).into(),
        )
        .hardness("|q|² 1e-38"),
        HardCase::scenes(
            "subnormal quaternion",
            "it has few digits left, its square has none, and its true gradient exceeds the range of f32",
            vec![scene("1e-39", QUAT.map(|q| q * 1e-39))],
        )
        .hardness("|q| 1e-39"),
        HardCase::scenes(
            "quaternion of length 1e30",
            "the sum of squares overflows",
            vec![scene("1e30", QUAT.map(|q| q * 1e30))],
        )
        .hardness("|q|² 1e60"),
        HardCase::check(
            "the two signs of a rotation",
            "q and −q are the same rotation: only the sign of the gradient may differ, and no other bit",
            both_signs,
        ),
    ]
}

fn scene(label: &str, quat: [f64; 4]) -> HardScene {
    let hard = Splat::at([18.3, 27.6], 3.0, 1.0).scale([0.06, 0.03, 0.1]).quat(quat);
    let neighbour = Splat::at([50.2, 8.4], 2.0, 1.3).colour(&[0.3, 0.9, 0.6]);
    HardScene::new(label, &[hard]).with_neighbour(&neighbour)
}

fn both_signs(place: &TestDevice) -> CaseOutcome {
    let [plus, minus] = [QUAT, QUAT.map(|q| -q)].map(|quat| {
        let scene = HardScene { neighbours: 0, ..scene("both signs", quat) }.rounded();
        evaluate(&scene, &scene.weights(), &place.device, DType::F32)
    });
    let mut outcome = CaseOutcome::default();
    let Outputs { pictures, gradients } = minus;
    for (plus, minus) in plus.pictures.iter().zip(&pictures) {
        outcome.require(plus.values == minus.values, || format!("{} differs", plus.name));
    }
    for (plus, mut minus) in plus.gradients.iter().zip(gradients) {
        if plus.name == "rotations" {
            minus.values[..4].iter_mut().for_each(|g| *g = -*g);
        }
        outcome.require(plus.values == minus.values, || format!("the gradient of {} differs", plus.name));
    }
    outcome
}
