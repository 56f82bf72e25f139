//! The window and the loss against sums written out in f64.

use super::launch::{DeviceInputs, launch_photometric, launch_window};
use crate::gpu::Buffer;
use crate::testing::ceiling::{Yardstick, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

/// `Kx` by the definition: every pair of a pixel and a tap.
fn window(x: &[f64], [width, height]: [usize; 2]) -> Vec<f64> {
    let weight = |d: usize| (-(d as f64).powi(2) / 4.5).exp();
    let sum = weight(0) + 2.0 * (1..=5).map(weight).sum::<f64>();
    let mut out = vec![0.0; x.len()];
    for (i, out) in out.iter_mut().enumerate() {
        let (plane, row, column) = (i / (width * height), i / width % height, i % width);
        for r in row.saturating_sub(5)..(row + 6).min(height) {
            for c in column.saturating_sub(5)..(column + 6).min(width) {
                let tap = weight(row.abs_diff(r)) * weight(column.abs_diff(c)) / (sum * sum);
                *out += tap * x[(plane * height + r) * width + c];
            }
        }
    }
    out
}

/// Shares of the loss from image, truth, mean and variance of the truth.
fn shares(inputs: &[Vec<f64>], size: [usize; 2], lambda: f64) -> Vec<f64> {
    let [x, y, mean_y, variance_y] = [0, 1, 2, 3].map(|i| &inputs[i]);
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
    let (mean_x, xx, xy) = (window(x, size), window(&product(x, x), size), window(&product(x, y), size));
    let n = x.len() as f64;
    let share = |i: usize| {
        let cross = mean_x[i] * mean_y[i];
        let square = mean_x[i] * mean_x[i];
        let above = (2.0 * cross + 1e-4) * (2.0 * (xy[i] - cross) + 9e-4);
        let below = (square + mean_y[i] * mean_y[i] + 1e-4) * (xx[i] - square + variance_y[i]);
        ((1.0 - lambda) * (x[i] - y[i]).abs() + lambda * (1.0 - above / below)) / n
    };
    (0..x.len()).map(share).collect()
}

fn pictures(size: [usize; 2], planes: usize) -> Vec<Vec<f64>> {
    let mut random = Random::new((size[0] + 1000 * size[1]) as u64);
    let len = planes * size[0] * size[1];
    let [x, y] = [0, 1].map(|_| rounded(&random.fill(len, 0.0, 1.0)));
    let mean = window(&y, size);
    let square: Vec<f64> = y.iter().map(|y| y * y).collect();
    let variance = window(&square, size).iter().zip(&mean).map(|(yy, m)| yy - m * m + 9e-4).collect::<Vec<_>>();
    vec![x, y, rounded(&mean), rounded(&variance)]
}

#[test]
fn window_is_the_double_sum() {
    for (size, planes) in [([1, 1], 1), ([3, 40], 2), ([33, 17], 3), ([101, 64], 1)] {
        let inputs = pictures(size, planes);
        let yardstick = Yardstick::new(&inputs[..1], |inputs| vec![window(&inputs[0], size)]);
        for (form, gpu) in gpus() {
            let found = launch_window(&gpu, &Buffer::from_slice(&gpu, &to_f32(&inputs[0])), size).read(&gpu);
            yardstick.check(&format!("{size:?}, {form}"), 0, &found, &vec![Some(0); found.len()]);
        }
    }
}

#[test]
fn loss_and_derivative_agree_with_the_definition() {
    for (size, planes, lambda) in [([1, 1], 1, 0.2), ([37, 21], 3, 0.2), ([16, 33], 2, 1.0), ([20, 12], 3, 0.0)] {
        let inputs = pictures(size, planes);
        let yardstick = Yardstick::new(&inputs, |inputs| vec![shares(inputs, size, lambda)]);
        // The derivative of the sum by differences of the definition.
        let total = |x: &[f64]| {
            let moved = [x.to_vec(), inputs[1].clone(), inputs[2].clone(), inputs[3].clone()];
            shares(&moved, size, lambda).iter().sum::<f64>()
        };
        for (form, gpu) in gpus() {
            let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&inputs[i]));
            let device = DeviceInputs { image: buffer(0), truth: buffer(1), mean: buffer(2), variance: buffer(3) };
            let (found, gradient) = launch_photometric(&gpu, &device, size, lambda, true);
            let plain = launch_photometric(&gpu, &device, size, lambda, false);
            let found = found.read(&gpu);
            assert!(plain.1.is_none() && plain.0.read(&gpu) == found, "asking for the derivative changes the loss");
            yardstick.check(&format!("{size:?}, {form}: shares"), 0, &found, &vec![Some(0); found.len()]);
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
