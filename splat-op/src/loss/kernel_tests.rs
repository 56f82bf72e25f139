//! Tests of the window and the loss on GPUs against sums written out in f64.

use super::launch::{launch_photometric, launch_window};
use super::taps::Compared;
use super::tests::{pictures, shares, window};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, to_f32};
use crate::testing::gpu::gpus;

#[test]
fn window_is_the_double_sum() {
    for (size, planes) in [([1, 1], 1), ([3, 40], 2), ([33, 17], 3), ([101, 64], 1)] {
        let inputs = pictures(size, planes);
        let reference = PerturbedReference::new(&inputs[..1], |inputs| vec![window(&inputs[0], size)]);
        for (form, gpu) in gpus() {
            let found = launch_window(&gpu, &Buffer::from_slice(&gpu, &to_f32(&inputs[0])), size).read(&gpu);
            reference.check(&format!("{size:?}, {form}"), 0, &found, &vec![Some(0); found.len()]);
        }
    }
}

#[test]
fn loss_and_derivative_agree_with_the_definition() {
    for (size, planes, lambda) in
        [([1, 1], 1, 0.2), ([37, 21], 3, 0.2), ([16, 33], 2, 1.0), ([20, 12], 3, 0.0), ([6, 150], 1, 0.2)]
    {
        let inputs = pictures(size, planes);
        let reference =
            PerturbedReference::new(&inputs, |inputs| vec![vec![shares(inputs, size, lambda).iter().sum()]]);
        // Derivative of the sum by finite differences of the definition.
        let total = |x: &[f64]| {
            let moved = [x.to_vec(), inputs[1].clone(), inputs[2].clone(), inputs[3].clone()];
            shares(&moved, size, lambda).iter().sum::<f64>()
        };
        for (form, gpu) in gpus() {
            let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&inputs[i]));
            let device = Compared { image: buffer(0), truth: buffer(1), mean: buffer(2), variance: buffer(3) };
            let (found, gradient) = launch_photometric(&gpu, &device, size, lambda, true);
            let plain = launch_photometric(&gpu, &device, size, lambda, false);
            let found = found.read(&gpu);
            assert!(plain.1.is_none() && plain.0.read(&gpu) == found, "asking for the derivative changes the loss");
            reference.check(&format!("{size:?}, {form}: loss"), 0, &found, &[Some(0)]);
            let gradient = gradient.expect("asked for").read(&gpu);
            let largest = gradient.iter().fold(0.0_f32, |m, g| m.max(g.abs()));
            assert_eq!(gradient.len(), inputs[0].len());
            for i in (0..gradient.len()).step_by(7) {
                let mut x = inputs[0].clone();
                let mut at = |step: f64| {
                    x[i] = inputs[0][i] + step;
                    total(&x)
                };
                let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
                let error = (f64::from(gradient[i]) - difference).abs();
                assert!(error <= 2e-5 * f64::from(largest), "{size:?}, {form}, {i}: {} {difference}", gradient[i]);
            }
        }
    }
}

/// More cubes than one cube has units.
#[test]
fn the_loss_of_a_larger_picture_is_the_sum_of_its_shares() {
    let (size, planes, lambda) = ([300, 800], 3, 0.2);
    let inputs = pictures(size, planes);
    let expected: f64 = shares(&inputs, size, lambda).iter().sum();
    for (form, gpu) in gpus() {
        let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&inputs[i]));
        let device = Compared { image: buffer(0), truth: buffer(1), mean: buffer(2), variance: buffer(3) };
        let found = f64::from(launch_photometric(&gpu, &device, size, lambda, false).0.read(&gpu)[0]);
        assert!((found - expected).abs() <= 1e-6 * expected, "{form}: {found} instead of {expected}");
    }
}
