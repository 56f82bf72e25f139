use burn::tensor::DType;

use super::super::testing::{FIELDS, check_gradient, ellipses, host, numbers, tensor, varied, vectors};
use super::*;

const COUNT: usize = 24;

/// The covariance `[xx, xy, yy]` and the opacity of ellipse `i` in the numbers of `COUNT` ellipses.
fn covariance(numbers: &[f64], i: usize) -> ([f64; 3], f64) {
    let [u, shear, v, opacity] = [2, 3, 4, 6].map(|field| numbers[field * COUNT + i]);
    ([u * u, shear * u * u, shear * shear * u * u + v * v], opacity)
}

fn determinant([xx, xy, yy]: [f64; 3]) -> f64 {
    xx * yy - xy * xy
}

/// Compares a change of ellipses with the expected change of each covariance, in both precisions. `grows`: whether
/// opacities fall as areas grow.
fn check(change: impl Fn(Ellipses, DType) -> Ellipses, expected: impl Fn(usize, [f64; 3]) -> [f64; 3], grows: bool) {
    for (dtype, tolerance) in [(DType::F64, 1e-13), (DType::F32, 2e-6)] {
        // Rounded to f32, so that both precisions start from the same values.
        let before: Vec<f64> = varied(COUNT).iter().map(|&value| f64::from(value as f32)).collect();
        let after = host(numbers(change(ellipses(&tensor(&before, [FIELDS * COUNT], dtype), COUNT), dtype)));
        for i in 0..COUNT {
            let (old, opacity) = covariance(&before, i);
            let (found, dimmed) = covariance(&after, i);
            let right = expected(i, old);
            let size = [right[0], (right[0] * right[2]).sqrt(), right[2]];
            for entry in 0..3 {
                let error = (found[entry] - right[entry]).abs() / size[entry];
                assert!(error <= tolerance, "{dtype:?}, ellipse {i}: {found:?} instead of {right:?}");
            }
            // By the factor, which keeps all digits. The expected value loses digits in f64 for a needle.
            let u_v = after[2 * COUNT + i] * after[4 * COUNT + i];
            let error = (u_v * u_v / determinant(right) - 1.0).abs();
            let lost = 1e-15 * right[0] * right[2] / determinant(right);
            assert!(error <= 8.0 * tolerance + lost, "{dtype:?}, ellipse {i}: determinant off by {error:e}");
            let light = opacity * if grows { (determinant(old) / determinant(right)).sqrt() } else { 1.0 };
            let lost = 1e-15 * old[0] * old[2] / determinant(old) + lost;
            assert!(
                (dimmed / light - 1.0).abs() <= 4.0 * tolerance + lost,
                "{dtype:?}, ellipse {i}: {dimmed} instead of {light}"
            );
        }
    }
}

fn added(old: [f64; 3], more: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|entry| old[entry] + more[entry])
}

#[test]
fn a_widened_ellipse_has_the_sum_of_the_covariances() {
    let w: Vec<f64> = vectors(COUNT, 2.5).iter().map(|&value| f64::from(value as f32)).collect();
    let of = |dtype| tensor(&w, [COUNT, 2], dtype);
    let at = |i: usize| (w[2 * i], w[2 * i + 1]);
    check(
        |ellipses, dtype| widen_along(ellipses, of(dtype)),
        |i, old| added(old, [at(i).0 * at(i).0, at(i).0 * at(i).1, at(i).1 * at(i).1]),
        true,
    );
    check(
        |ellipses, dtype| widen(ellipses, of(dtype)),
        |i, old| added(old, [at(i).0 * at(i).0, 0.0, at(i).1 * at(i).1]),
        true,
    );
}

#[test]
fn a_sheared_ellipse_is_that_of_the_linear_map() {
    let w: Vec<f64> = vectors(COUNT, 0.1).iter().map(|&value| f64::from(value as f32)).collect();
    let (q, k): (Vec<f64>, Vec<f64>) = w.chunks(2).map(|pair| (pair[0], f64::from((pair[1] as f32).exp()))).unzip();
    check(
        |ellipses, dtype| sheared(ellipses, tensor(&q, [COUNT], dtype), tensor(&k, [COUNT], dtype)),
        |i, [xx, xy, yy]| {
            let (q, k) = (q[i], k[i]);
            [xx + 2.0 * q * xy + q * q * yy, k * (xy + q * yy), k * k * yy]
        },
        false,
    );
}

#[test]
fn with_nothing_added_nothing_changes() {
    for dtype in [DType::F64, DType::F32] {
        let before = tensor(&varied(COUNT), [FIELDS * COUNT], dtype);
        let nothing = || tensor(&[0.0; 2 * COUNT], [COUNT, 2], dtype);
        let (zeros, ones) = (tensor(&[0.0; COUNT], [COUNT], dtype), tensor(&[1.0; COUNT], [COUNT], dtype));
        let given = || ellipses(&before, COUNT);
        for after in [widen_along(given(), nothing()), widen(given(), nothing()), sheared(given(), zeros, ones)] {
            assert_eq!(host(numbers(after)), host(before.clone()), "to the last bit");
        }
    }
}

#[test]
fn extents_whose_squares_no_f32_holds_are_widened() {
    for size in [1e-30, 1e30] {
        let given = [0.0, 0.0, size, 0.5, 2.0 * size, 1.0, 0.8];
        let after = widen_along(
            ellipses(&tensor(&given, [FIELDS], DType::F32), 1),
            tensor(&[0.75 * size, -size], [1, 2], DType::F32),
        );
        let after = host(numbers(after));
        // (1, ½, 2) and w = (¾, −1), by hand: a = 1.5625, cov = ½ − ¾, det = 4 + (−1 − ⅜)² + 4 · 0.5625.
        let det: f64 = 4.0 + 1.375 * 1.375 + 2.25;
        let expected = [1.25 * size, -0.25 / 1.5625, (det / 1.5625).sqrt() * size, 1.0, 0.8 * 2.0 / det.sqrt()];
        for (found, expected) in after[2..].iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} instead of {expected}");
        }
    }
}

#[test]
fn gradients_are_those_of_differences() {
    let count = 6;
    let at = [varied(count), vectors(count, 1.5)].concat();
    let more = |values: &Tensor<1>| values.clone().narrow(0, FIELDS * count, 2 * count).reshape([count, 2]);
    check_gradient(&at, |values| numbers(widen_along(ellipses(&values, count), more(&values))));
    check_gradient(&at, |values| numbers(widen(ellipses(&values, count), more(&values))));
    check_gradient(&at, |values| {
        let (q, k) = (column(&more(&values), 0), column(&more(&values), 1).exp());
        numbers(sheared(ellipses(&values, count), q, k))
    });
}

#[test]
fn a_culled_gaussian_stays_as_it_is() {
    let device = burn::tensor::Device::flex().autodiff();
    let row = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0];
    let given = Tensor::<1>::from_floats(row, &device);
    for change in [widen_along, widen] {
        let by = Tensor::<2>::from_floats([[3.0, -4.0]], &device).require_grad();
        let after = numbers(change(ellipses(&given, 1), by.clone()));
        assert_eq!(host(after.clone().inner()), row);
        let mut gradients = after.sum().backward();
        assert_eq!(host(by.grad_remove(&mut gradients).unwrap()), [0.0, 0.0]);
    }
}
