use burn::tensor::Device;

use super::*;
use crate::gaussians::values_of;

#[test]
fn rates_fall_from_the_first_to_the_last_step() {
    let rate = Falling { from: 0.01, to: 0.001 };
    let rates = [1, 51, 101, 200].map(|step| rate.at(step, 101));
    for (rate, expected) in rates.into_iter().zip([0.01, 0.01 / 10.0_f64.sqrt(), 0.001, 0.001]) {
        assert!((rate - expected).abs() < 1e-12, "{rate}");
    }
    assert_eq!(rate.at(1, 1), 0.01);
}

#[test]
fn a_reach_is_the_unit_of_steps() {
    let device = Device::flex();
    let (start, reach) = ([[1.0, -3.0], [0.0, 5.0]], [[0.5, 2.0], [0.25, 1.0]]);
    let tensor = |rows: [[f32; 2]; 2]| Tensor::<2>::from_floats(rows, &device);
    let mut learned = Learned::reaching(tensor(start), tensor(reach));
    assert_eq!(values_of(learned.value()), values_of(tensor(start)));
    let loss = (learned.tracked() * Tensor::from_inner(tensor([[1.0, -1.0], [100.0, 0.01]]))).sum();
    // With 4 visits the rate is limited to the largest step.
    learned.step_within(&mut loss.backward(), 0.5, 1, EffectContext { view: 0, step: 1, steps: 4, verdict: None });
    let moved = values_of(learned.value() - tensor(start));
    let expected = [-1.0, 1.0, -1.0, -1.0].into_iter().zip([0.5, 2.0, 0.25, 1.0]);
    for (moved, (sign, reach)) in moved.into_iter().zip(expected) {
        assert!((f64::from(moved) - sign * reach * LARGEST_STEP).abs() < 1e-6, "{moved}");
    }
}

#[test]
fn what_is_not_a_number_moves_nothing() {
    let device = Device::flex();
    let mut learned = Learned::new(Tensor::<1>::zeros([3], &device));
    let weights = Tensor::<1>::from_floats([1.0, f32::NAN, -2.0], &device);
    let loss = (learned.tracked() * Tensor::from_inner(weights)).sum();
    assert!(learned.step(&mut loss.backward(), 0.5, None));
    let values = values_of(learned.value());
    assert!((values[0] + 0.5).abs() < 1e-6 && values[1] == 0.0 && (values[2] - 0.5).abs() < 1e-6, "{values:?}");
}

/// Views of a batch are rendered before a step is taken on any of them.
#[test]
fn views_of_a_batch_step_one_after_the_other() {
    let device = Device::flex();
    let mut learned = Learned::new(Tensor::<1>::zeros([1], &device));
    let of_views = [1.0, -3.0].map(|slope| (learned.tracked() * slope).sum().backward());
    for mut gradients in of_views {
        assert!(learned.step(&mut gradients, 0.5, None));
        assert!(!learned.step(&mut gradients, 0.5, None), "a gradient is taken once");
    }
    let mut expected = (Tensor::<1>::zeros([1], &device), Moments::new(&Tensor::<1>::zeros([1], &device)));
    for (i, slope) in [1.0, -3.0].into_iter().enumerate() {
        let gradient = Tensor::from_floats([slope], &device);
        expected.0 = Adam::default().step(expected.0, gradient, 0.5, &mut expected.1, i + 1);
    }
    assert_eq!(values_of(learned.value()), values_of(expected.0));
}
