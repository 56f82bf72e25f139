//! Tests of the CPU twin against sums written out in f64.

use super::cpu::{moments_cpu, photometric_cpu};
use super::sweep::PlaneSize;
use super::taps::Compared;
use crate::simd::Real;
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
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

/// Each value's share of the loss from image, truth, mean and variance of the truth.
pub(super) fn shares(inputs: &[Vec<f64>], size: [usize; 2], lambda: f64) -> Vec<f64> {
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

/// Mean and `σy² + C2` by the definition.
pub(super) fn moments_of(y: &[f64], size: [usize; 2]) -> [Vec<f64>; 2] {
    let mean = window(y, size);
    let square: Vec<f64> = y.iter().map(|y| y * y).collect();
    let variance = window(&square, size).iter().zip(&mean).map(|(yy, m)| yy - m * m + 9e-4).collect();
    [mean, variance]
}

/// `σ² + C2` of a white picture by the share of the window beyond the border, each of whose taps is positive.
pub(super) fn variance_of_white([width, height]: [usize; 2]) -> Vec<f64> {
    let weight = |d: i64| (-(d as f64).powi(2) / 4.5).exp();
    let sum: f64 = (-5..=5).map(weight).sum();
    let beyond = |row: i64, column: i64| -> f64 {
        let around = (-5..=5).flat_map(|down| (-5..=5).map(move |along| (down, along)));
        let inside =
            |down, along| (0..height as i64).contains(&(row + down)) && (0..width as i64).contains(&(column + along));
        around.filter(|&(d, a)| !inside(d, a)).map(|(d, a)| weight(d) * weight(a) / (sum * sum)).sum()
    };
    let pixels = (0..height as i64).flat_map(|row| (0..width as i64).map(move |column| (row, column)));
    pixels.map(|(row, column)| beyond(row, column)).map(|o| o * (1.0 - o) + 9e-4).collect()
}

/// A picture and a photograph, rounded to f32, and the photograph's mean and `σy² + C2`.
pub(super) fn pictures(size: [usize; 2], planes: usize) -> Vec<Vec<f64>> {
    let mut random = Random::new((size[0] + 1000 * size[1]) as u64);
    let len = planes * size[0] * size[1];
    let [x, y] = [0, 1].map(|_| rounded(&random.fill(len, 0.0, 1.0)));
    let [mean, variance] = moments_of(&y, size);
    vec![x, y, mean, variance]
}

/// Widths around multiples of a vector, heights around multiples of a band, planes smaller than the window.
const SIZES: [[usize; 2]; 8] = [[1, 1], [8, 3], [37, 21], [16, 33], [7, 96], [20, 97], [64, 101], [3, 300]];

fn twin<F: Real>(
    inputs: &[Vec<F>],
    [width, height]: [usize; 2],
    lambda: f64,
    with_gradient: bool,
) -> (F, Option<Vec<F>>) {
    let inputs = Compared { image: &inputs[0][..], truth: &inputs[1], mean: &inputs[2], variance: &inputs[3] };
    photometric_cpu(inputs, PlaneSize { width, height }, lambda, with_gradient)
}

#[test]
fn moments_are_double_sums() {
    for size @ [width, height] in SIZES {
        for planes in [1, 3] {
            let [_, photograph, mean, variance] = pictures(size, planes).try_into().expect("four");
            for (found, expected) in moments_cpu(&photograph, PlaneSize { width, height }).iter().zip([mean, variance])
            {
                assert_eq!(found.len(), expected.len());
                for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    assert!((found - expected).abs() <= 1e-14, "{size:?}, {i}: {found} instead of {expected}");
                }
            }
            let by_definition = |inputs: &[Vec<f64>]| moments_of(&inputs[0], size).to_vec();
            let reference = PerturbedReference::new(std::slice::from_ref(&photograph), by_definition);
            for (i, narrow) in moments_cpu(&to_f32(&photograph), PlaneSize { width, height }).iter().enumerate() {
                reference.check(&format!("{size:?}"), i, narrow, &vec![Some(0); narrow.len()]);
            }
        }
    }
}

#[test]
fn a_white_picture_keeps_the_digits_of_its_variance() {
    for size @ [width, height] in SIZES {
        let white = vec![1.0_f32; width * height];
        let [_, variance] = moments_cpu(&white, PlaneSize { width, height });
        for (i, (&found, expected)) in variance.iter().zip(variance_of_white(size)).enumerate() {
            let error = (f64::from(found) - expected).abs();
            assert!(error <= 6e-7 * expected, "{size:?}, {i}: {found} instead of {expected}");
        }
    }
}

#[test]
fn loss_and_derivative_agree_with_the_definition() {
    for size in SIZES {
        for (planes, lambda) in [(1, 0.2), (3, 0.2), (2, 1.0), (3, 0.0)] {
            let inputs = pictures(size, planes);
            let total = |x: &[f64]| {
                let moved = [x.to_vec(), inputs[1].clone(), inputs[2].clone(), inputs[3].clone()];
                shares(&moved, size, lambda).iter().sum::<f64>()
            };
            let expected = total(&inputs[0]);
            let (plain, none) = twin(&inputs, size, lambda, false);
            let (found, gradient) = twin(&inputs, size, lambda, true);
            assert!((found - expected).abs() <= 1e-13, "{size:?}: {found} instead of {expected}");
            assert!(none.is_none() && plain == found, "asking for the derivative changes the loss");
            let gradient = gradient.expect("asked for");
            assert_eq!(gradient.len(), inputs[0].len());
            let largest = gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
            // An odd step visits rows and columns of all kinds.
            let step = gradient.len().div_ceil(8) | 1;
            for i in (0..gradient.len()).step_by(step) {
                let mut x = inputs[0].clone();
                let mut at = |step: f64| {
                    x[i] = inputs[0][i] + step;
                    total(&x)
                };
                let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
                let error = (gradient[i] - difference).abs();
                assert!(error <= 1e-6 * largest, "{size:?}, {i}: {} instead of {difference}", gradient[i]);
            }
            // f32 against f64: sixteen roundings of the loss, and the derivative as far as its terms cancel.
            let narrow: Vec<Vec<f32>> = inputs.iter().map(|values| to_f32(values)).collect();
            let (loss, narrow) = twin(&narrow, size, lambda, true);
            assert!((f64::from(loss) - found).abs() <= 16.0 * f64::from(f32::EPSILON), "{size:?}: {loss} for {found}");
            for (i, (narrow, wide)) in narrow.expect("asked for").iter().zip(&gradient).enumerate() {
                let error = (f64::from(*narrow) - wide).abs();
                assert!(error <= 1e-4 * largest, "{size:?}, {i}: {narrow} in f32, {wide} in f64");
            }
        }
    }
}

/// The bands depend on the size of the picture alone, and their sums are added in order.
#[test]
fn threads_change_no_bit() {
    let size = [53, 97];
    let inputs: Vec<Vec<f32>> = pictures(size, 3).iter().map(|values| to_f32(values)).collect();
    let with_threads = |count| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("a pool of a few threads");
        pool.install(|| twin(&inputs, size, 0.2, true))
    };
    let one = with_threads(1);
    assert!([2, 3, 7].into_iter().all(|count| with_threads(count) == one));
}

#[test]
fn what_is_not_a_number_spreads_as_far_as_the_window_reaches() {
    let size = [40, 90];
    let mut inputs: Vec<Vec<f32>> = pictures(size, 1).iter().map(|values| to_f32(values)).collect();
    inputs[0][45 * 40 + 20] = f32::NAN;
    let (loss, gradient) = twin(&inputs, size, 0.2, true);
    assert!(loss.is_nan());
    for (i, g) in gradient.expect("asked for").iter().enumerate() {
        let reached = (i / 40).abs_diff(45) <= 10 && (i % 40).abs_diff(20) <= 10;
        assert_eq!(g.is_nan(), reached, "pixel {}, {}", i % 40, i / 40);
    }
}

#[test]
fn no_pixels_no_loss() {
    let none: Vec<Vec<f32>> = vec![Vec::new(); 4];
    assert_eq!(twin(&none, [0, 5], 0.2, true), (0.0, Some(Vec::new())));
    assert!(moments_cpu::<f32>(&[], PlaneSize { width: 4, height: 0 }).iter().all(Vec::is_empty));
}
