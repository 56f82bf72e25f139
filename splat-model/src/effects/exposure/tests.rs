use burn::tensor::{Distribution, Int, TensorData};

use super::*;
use crate::effects::{Effect, EffectContext};
use crate::gaussians::values_of;

fn picture(device: &Device) -> Tensor<3> {
    Tensor::random([7, 5, 3], Distribution::Uniform(0.0, 1.0), device)
}

/// Gains and offsets that a photograph might have.
const AFFINE: [[f32; 4]; 3] = [[1.2, 0.05, 0.0, 0.02], [0.0, 0.9, -0.03, 0.0], [0.1, 0.0, 0.7, -0.01]];

#[test]
fn the_map_is_affine_in_the_colour() {
    let device = Device::flex();
    let image = picture(&device);
    let shown = values_of(apply(&image, &Tensor::from_floats(AFFINE, &device)));
    for (before, after) in values_of(image).chunks_exact(3).zip(shown.chunks_exact(3)) {
        for (row, after) in AFFINE.iter().zip(after) {
            let expected = row[0] * before[0] + row[1] * before[1] + row[2] * before[2] + row[3];
            assert!((expected - after).abs() < 1e-6, "{after} instead of {expected}");
        }
    }
}

#[test]
fn identities_change_nothing_and_cost_nothing() {
    let device = Device::flex();
    let mut exposure = Exposure::new(ExposureConfig::default(), 2, &device);
    let image = picture(&device);
    let shown = apply(&Tensor::from_inner(image.clone()), &exposure.tracked(1)).inner();
    assert_eq!(values_of(shown), values_of(image));
    assert_eq!(exposure.pulled(0).into_scalar::<f32>(), 0.0);
}

/// Two photographs of opposite exposures: the mean of their maps is the identity.
#[test]
fn the_maps_of_photographs_are_found_around_the_identity() {
    let device = Device::flex();
    let mut exposure = Exposure::new(ExposureConfig { weight: 0.0, ..ExposureConfig::default() }, 2, &device);
    let image = picture(&device);
    let identity = exposure.neutral();
    let first = Tensor::<2>::from_floats(AFFINE, &device);
    let maps = [first.clone(), identity.clone() * 2.0 - first];
    let truths = maps.clone().map(|map| apply(&image, &map));
    let tracked = Tensor::from_inner(image);
    let steps = 1200;
    for step in 1..=steps {
        let view = step % 2;
        let shown = apply(&tracked, &exposure.tracked(view));
        let loss = (shown - Tensor::from_inner(truths[view].clone())).square().mean() + exposure.pulled(view);
        exposure.step(&mut loss.backward(), EffectContext { view, step, steps, verdict: None });
    }
    let error = |found: Tensor<2>, expected: Tensor<2>| (found - expected).abs().max().into_scalar::<f32>();
    for (view, map) in maps.into_iter().enumerate() {
        assert!(error(exposure.value(view), map) < 0.01, "{}", exposure.value(view));
    }
    let mean = (exposure.value(0) + exposure.value(1)) / 2.0;
    assert!(error(mean, identity) < 1e-6);
}

/// A change that all photographs have in common goes to the scene.
#[test]
fn maps_that_move_together_are_set_back() {
    let device = Device::flex();
    let mut exposure = Exposure::new(ExposureConfig::default(), 3, &device);
    for step in 1..=3 {
        let mut gradients = exposure.tracked(step - 1).sum().backward();
        exposure.step(&mut gradients, EffectContext { view: step - 1, step, steps: 10, verdict: None });
    }
    for view in 0..3 {
        let strayed = (exposure.value(view) - exposure.neutral()).abs().max().into_scalar::<f32>();
        assert!(strayed < 0.005, "{strayed}: a step is 0.01 to 0.006 long");
    }
}

#[test]
fn a_verdict_holds_a_map_back() {
    let device = Device::flex();
    let mut exposure = Exposure::new(ExposureConfig::default(), 2, &device);
    let verdict = Tensor::<1, Int>::from_data(TensorData::from([4, 1]), &device);
    let mut gradients = exposure.tracked(0).sum().backward();
    exposure.step(&mut gradients, EffectContext { view: 0, step: 5, steps: 10, verdict: Some(&verdict) });
    assert_eq!(values_of(exposure.value(0)), values_of(exposure.neutral()));
}
