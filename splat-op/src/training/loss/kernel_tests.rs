//! Tests of the moments and the loss on GPUs against sums written out in f64.

use super::launch::{launch_moments, launch_photometric};
use super::taps::Compared;
use super::tests::{moments_of, pictures, shares, variance_of_white};
use crate::gpu::Buffer;
use crate::testing::ceiling::{PerturbedReference, to_f32};
use crate::testing::gpu::gpus;

#[test]
fn moments_are_double_sums() {
    for (size, planes) in [([1, 1], 1), ([3, 40], 2), ([33, 17], 3), ([101, 64], 1)] {
        let inputs = pictures(size, planes);
        let reference = PerturbedReference::new(&inputs[1..2], |inputs| moments_of(&inputs[0], size).to_vec());
        for (form, gpu) in gpus() {
            let found = launch_moments(&gpu, &Buffer::from_slice(&gpu, &to_f32(&inputs[1])), size);
            for (i, found) in found.into_iter().enumerate() {
                let found = found.read(&gpu);
                reference.check(&format!("{size:?}, {form}"), i, &found, &vec![Some(0); found.len()]);
            }
        }
    }
}

#[test]
fn a_white_picture_keeps_the_digits_of_its_variance() {
    for size in [[1, 1], [3, 40], [33, 17], [101, 64]] {
        for (form, gpu) in gpus() {
            let white = Buffer::from_slice(&gpu, &vec![1.0_f32; size[0] * size[1]]);
            let [_, variance] = launch_moments(&gpu, &white, size);
            for (i, (found, expected)) in variance.read(&gpu).into_iter().zip(variance_of_white(size)).enumerate() {
                let error = (f64::from(found) - expected).abs();
                assert!(error <= 1e-6 * expected, "{size:?}, {form}, {i}: {found} instead of {expected}");
            }
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
