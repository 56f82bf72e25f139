//! Poisoned Gaussians, in every slot and at random, and training runs that diverge: detected at once on the CPU, and on a GPU by
//! a verdict that is read later without waiting.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use proptest::prelude::*;
use splat_hard_cases::cases::poison::{Poisoned, SLOTS, VALUES};
use splat_model::capture::{Photo, PointCloud};
use splat_model::trainer::{LossInputs, TrainConfig, TrainError, Trainer};
use splat_op::{Intrinsics, with_gradient};
use splat_tests::{devices, places};

proptest! {
    // The battery judges every slot of one scene. This test draws scene, Gaussian and number at random.
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_poisoned_splat_is_as_if_it_were_not_there(
        seed in 0_u64..1_000, slot in 0..SLOTS.len(), row in 0_usize..24, column: usize,
        value in prop_oneof![prop::sample::select(VALUES.to_vec()), any::<u32>().prop_map(f32::from_bits)],
    ) {
        let (slot, _, columns) = SLOTS[slot];
        for place in places() {
            let outcome = Poisoned::new(seed).judge(&place, slot, row, column % columns, value);
            prop_assert!(outcome.passed(), "on {}: {:?}", place.name, outcome.failures);
        }
    }
}

/// Three arbitrary photographs, and points in front of the cameras.
fn capture() -> (Vec<Photo>, PointCloud) {
    let intrinsics = Intrinsics::centred(24, 16, 20.0);
    let photo = |i: usize| Photo {
        name: format!("{i}.png"),
        intrinsics,
        cam_from_world: DAffine3::from_translation(DVec3::new(0.2 * i as f64, 0.0, 3.0)),
        rgb: (0..3 * 24 * 16).map(|pixel| (pixel * (i + 3) % 251) as u8).collect(),
        alpha: None,
        mask: None,
    };
    let positions =
        (0..40).map(|i| [0.04 * i as f32 - 0.8, (i % 7) as f32 * 0.1 - 0.3, (i % 5) as f32 * 0.1]).collect();
    ((0..3).map(photo).collect(), PointCloud { positions, colours: vec![[90, 128, 200]; 40] })
}

/// Creates a run whose loss at step `bad` is finite, with one element of its derivative that is not.
fn run(device: &Device, steps: usize, bad: usize) -> Trainer {
    let (photos, points) = capture();
    let config = TrainConfig { steps, ..TrainConfig::default() };
    Trainer::new(photos, &points, config, device).expect("a valid run").with_loss(move |seen: &LossInputs| {
        let loss = (seen.image.clone() - seen.truth.image()).abs().mean();
        if seen.step != bad {
            return loss;
        }
        let scales = seen.input.splats.scales.clone();
        let device = scales.device().inner();
        let mut gradient = vec![0.0; scales.shape().num_elements()];
        gradient[7] = f32::NAN;
        let gradient = Tensor::<1>::from_floats(gradient.as_slice(), &device).reshape(scales.dims());
        loss + with_gradient(scales, Tensor::zeros([1], &device), gradient)
    })
}

#[test]
fn a_step_that_is_not_finite_leaves_the_scene_as_it_was() {
    for (name, device) in devices() {
        let (steps, bad) = (70, 6);
        let mut trainer = run(&device, steps, bad);
        let mut view = String::new();
        let (mut before, mut found) = (None, None);
        for step in 1..=steps {
            if step == bad {
                before = Some(trainer.gaussians().to_rows());
            }
            match trainer.step() {
                Ok(report) if step == bad => view = report.view,
                Ok(_) => {}
                Err(error) => {
                    found = Some((step, error));
                    break;
                }
            }
        }
        let (stopped, error) = found.unwrap_or_else(|| panic!("{name}: the run is not stopped"));
        let message = error.to_string();
        let TrainError::NonFinite { step, view: named, what, .. } = error else { panic!("{name}: {message}") };
        assert_eq!((step, what.as_str()), (bad, "the gradient of `log_scales`"), "{name}");
        // The error comes at once on the CPU, and within fifty steps on a device that would otherwise have to wait.
        let late = stopped - bad;
        assert!(
            if name == "gpu" { late > 0 && late <= 50 && named == view } else { late == 0 },
            "{name}: {late} steps late"
        );
        assert!(trainer.gaussians().to_rows() == before.expect("reached"), "{name}: the scene changed");
    }
}

/// The guard does not change a run with finite values.
#[test]
fn a_sound_run_is_finite_on_every_device() {
    for (name, device) in devices() {
        let mut trainer = run(&device, 8, 0);
        let start = trainer.gaussians().to_rows();
        while !trainer.is_done() {
            trainer.step().expect("sound");
        }
        let rows = trainer.gaussians().to_rows();
        assert!(rows != start && rows.unusable() == 0, "{name}");
    }
}
