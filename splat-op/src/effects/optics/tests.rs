use burn::tensor::{DType, Device, Tensor, TensorData};
use fearless_simd::prelude::*;
use glam::{DQuat, DVec3};

use super::cpu::{expose_backward_cpu, expose_cpu};
use super::formulas::{Change, Moving, Rolled, Widened};
use super::*;
use crate::SplatError;
use crate::project::{COLUMNS, Ellipse};
use crate::simd::{LaneNumber, Real, dispatch};
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

pub(super) const CAMERA: Intrinsics = Intrinsics { fy: 44.0, cx: 23.0, cy: 19.0, ..Intrinsics::centred(48, 36, 40.0) };

const MARGIN: f64 = 0.3;

/// A motion, exact in f32.
pub(super) const TWIST: [f64; PARAMETERS] = [0.125, -0.09375, 0.1875, 0.375, -0.3125, 0.125];

pub(super) fn exposures() -> [OpticsSpec; 2] {
    [OpticsEffect::MotionBlur, OpticsEffect::RollingShutter].map(|exposure| OpticsSpec {
        intrinsics: CAMERA,
        exposure,
        margin: MARGIN,
    })
}

/// `[count, 7]`: ellipses in and around a picture of 48 × 36 px, every fourth a needle, every fifth far outside; exact in f32.
pub(super) fn ellipses(count: usize, seed: u64) -> Vec<f64> {
    let mut random = Random::new(seed);
    let mut row = |i: usize| {
        let far = if i % 5 == 4 { 4.0 } else { 1.0 };
        [
            24.0 + far * random.between(-30.0, 30.0),
            18.0 + far * random.between(-25.0, 25.0),
            random.between(-2.0, 2.0).exp(),
            random.between(-3.0, 3.0),
            if i % 4 == 1 { 1e-3 } else { random.between(-2.0, 2.0).exp() },
            random.between(1.0, 5.0),
            random.between(0.1, 0.9),
        ]
    };
    (0..count).flat_map(|i| row(i).map(|value| f64::from(value as f32))).collect()
}

fn exposed<F: Real>(projected: &[f64], twist: &[f64], spec: &OpticsSpec) -> Vec<f64> {
    let of = |values: &[f64]| values.iter().map(|value| F::of(*value)).collect::<Vec<F>>();
    let (projected, twist) = (of(projected), of(twist));
    let found = expose_cpu(Exposed { projected: &projected[..], twist: &twist[..] }, spec);
    found.into_iter().map(Real::f64).collect()
}

/// The covariance `[xx, xy, yy]` of a packed ellipse.
fn covariance(row: &[f64]) -> [f64; 3] {
    let (u, shear, v) = (row[2], row[3], row[4]);
    [u * u, shear * u * u, shear * shear * u * u + v * v]
}

fn determinant([xx, xy, yy]: [f64; 3]) -> f64 {
    xx * yy - xy * xy
}

/// Compares an ellipse with the expected covariance, and its opacity with what conserves light, if that `grows`.
fn check_covariance(before: &[f64], after: &[f64], right: [f64; 3], grows: bool, tolerance: f64) {
    let (old, found) = (covariance(before), covariance(after));
    let size = [right[0], (right[0] * right[2]).sqrt(), right[2]];
    for entry in 0..3 {
        let error = (found[entry] - right[entry]).abs() / size[entry];
        assert!(error <= tolerance, "{found:?} instead of {right:?}");
    }
    // By the factor, which keeps all digits. The expected value loses digits in f64 for a needle.
    let area = after[2] * after[4];
    let lost = 1e-15 * right[0] * right[2] / determinant(right);
    let error = (area * area / determinant(right) - 1.0).abs();
    assert!(error <= 8.0 * tolerance + lost, "determinant off by {error:e}");
    let light = before[6] * if grows { (determinant(old) / determinant(right)).sqrt() } else { 1.0 };
    let lost = lost + 1e-15 * old[0] * old[2] / determinant(old);
    assert!((after[6] / light - 1.0).abs() <= 4.0 * tolerance + lost, "{} instead of {light}", after[6]);
}

/// Returns the first of the lanes, which hold the same value.
fn first<S: Simd, F: Real>(lanes: LaneNumber<S, F>) -> f64 {
    lanes.0[0].f64()
}

fn lanes<S: Simd, F: Real>(simd: S, value: f64) -> LaneNumber<S, F> {
    LaneNumber::splat(simd, F::of(value))
}

fn ellipse<S: Simd, F: Real>(simd: S, row: &[f64]) -> Ellipse<LaneNumber<S, F>> {
    Ellipse::from_row(&row.iter().map(|value| lanes(simd, *value)).collect::<Vec<_>>())
}

fn widened<F: Real>(row: &[f64], w: [f64; 2]) -> [f64; COLUMNS] {
    dispatch!(F, simd => widened_by::<_, F>(simd, row, w))
}

fn widened_by<S: Simd, F: Real>(simd: S, row: &[f64], w: [f64; 2]) -> [f64; COLUMNS] {
    let e = ellipse::<S, F>(simd, row);
    Widened::new(&e, w.map(|value| lanes(simd, value))).of(&e).to_row().map(first)
}

fn rolled<F: Real>(row: &[f64], velocity: [f64; 2], height: f64) -> [f64; COLUMNS] {
    dispatch!(F, simd => rolled_by::<_, F>(simd, row, velocity, height))
}

fn rolled_by<S: Simd, F: Real>(simd: S, row: &[f64], velocity: [f64; 2], height: f64) -> [f64; COLUMNS] {
    let e = ellipse::<S, F>(simd, row);
    Rolled::new(&e, velocity.map(|value| lanes(simd, value)), lanes(simd, height)).of(&e).to_row().map(first)
}

fn velocity_by<S: Simd>(simd: S, row: [f64; COLUMNS], twist: [f64; PARAMETERS], axes: [[f64; 4]; 2]) -> [f64; 2] {
    let lanes = |value: f64| lanes::<S, f64>(simd, value);
    let change = Change {
        exposure: OpticsEffect::MotionBlur,
        axes: axes.map(|axis| axis.map(lanes)),
        height: lanes(1.0),
        twist: twist.map(lanes),
    };
    Moving::new(&ellipse(simd, &row), &change).velocity.map(first)
}

/// The gradients of `sigma_u`, the shear, `sigma_v`, the opacity and `w`.
fn widened_backward<S: Simd, F: Real>(simd: S, [row, grad]: [[f64; COLUMNS]; 2], w: [f64; 2]) -> [f64; 6] {
    let [e, grad] = [row, grad].map(|row| ellipse::<S, F>(simd, &row));
    let (of_ellipse, of_w) = Widened::new(&e, w.map(|value| lanes(simd, value))).backward(&e, &grad);
    let row = of_ellipse.to_row();
    [row[2], row[3], row[4], row[6], of_w[0], of_w[1]].map(first)
}

#[test]
fn a_widened_ellipse_has_the_sum_of_the_covariances() {
    let mut random = Random::new(3);
    for row in ellipses(24, 1).chunks(COLUMNS) {
        let [wx, wy] = [(); 2].map(|()| f64::from(random.between(-2.5, 2.5) as f32));
        let [xx, xy, yy] = covariance(row);
        let right = [xx + wx * wx, xy + wx * wy, yy + wy * wy];
        check_covariance(row, &widened::<f64>(row, [wx, wy]), right, true, 1e-13);
        check_covariance(row, &widened::<f32>(row, [wx, wy]), right, true, 2e-6);
    }
}

#[test]
fn a_rolled_ellipse_is_that_of_the_linear_map() {
    let mut random = Random::new(4);
    let height = 36.0;
    for row in ellipses(24, 2).chunks(COLUMNS) {
        let velocity = [(); 2].map(|()| f64::from(random.between(-9.0, 9.0) as f32));
        let k = 1.0 / (1.0 - velocity[1] / height);
        let q = k * velocity[0] / height;
        let [xx, xy, yy] = covariance(row);
        let right = [xx + 2.0 * q * xy + q * q * yy, k * (xy + q * yy), k * k * yy];
        check_covariance(row, &rolled::<f64>(row, velocity, height), right, false, 1e-13);
        check_covariance(row, &rolled::<f32>(row, velocity, height), right, false, 2e-6);
    }
}

#[test]
fn extents_whose_squares_no_f32_holds_are_widened() {
    for size in [1e-30, 1e30] {
        let given = [0.0, 0.0, size, 0.5, 2.0 * size, 1.0, 0.8];
        let after = widened::<f32>(&given, [0.75 * size, -size]);
        // (1, ½, 2) and w = (¾, −1), by hand: a = 1.5625, cov = ½ − ¾, det = 4 + (−1 − ⅜)² + 4 · 0.5625.
        let det: f64 = 4.0 + 1.375 * 1.375 + 2.25;
        let expected = [1.25 * size, -0.25 / 1.5625, (det / 1.5625).sqrt() * size, 1.0, 0.8 * 2.0 / det.sqrt()];
        for (found, expected) in after[2..].iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} instead of {expected}");
        }
    }
}

#[test]
fn a_rolling_shutter_by_hand() {
    // Round, at (30, 36) of 48 rows: a quarter of the height below the middle. It moves down by 12 px: k = 4/3.
    let given = [30.0, 36.0, 2.0, 0.0, 3.0, 1.0, 0.5];
    // y' = 4/3 (36 − 6) = 40, t = 40/48 − 1/2 = 1/3, x' = 30 − 6/3; q = −4/3 · 6/48 = −1/6.
    let xx = 4.0 + 9.0 / 36.0;
    let expected: [f64; 7] =
        [28.0, 40.0, f64::sqrt(xx), -4.0 / 3.0 * 9.0 / 6.0 / xx, 4.0 / 3.0 * 6.0 / f64::sqrt(xx), 1.0, 0.5];
    for (found, expected) in rolled::<f64>(&given, [-6.0, 12.0], 48.0).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
    }
    // Faster than the shutter: clamped to half of the height.
    let rows = |vy: f64| rolled::<f64>(&given, [0.0, vy], 48.0);
    assert_eq!(rows(48.0), rows(24.0));
    assert_eq!(rows(-1e9), rows(-24.0));
    assert!(rows(24.0) != rows(23.0));
}

#[test]
fn velocities_are_the_slopes_of_where_points_go() {
    let axes = exposures()[0].axes();
    let px = |point: DVec3| CAMERA.projector().px_from_cam(point).unwrap();
    for point in [DVec3::new(-0.4, 0.3, 2.0), DVec3::new(0.7, -0.9, 3.5), DVec3::new(0.0, 0.0, 1.0)] {
        let centre = px(point);
        let row = [centre.x, centre.y, 1.0, 0.0, 1.0, point.z, 1.0];
        for axis in 0..6 {
            let mut unit = [0.0; PARAMETERS];
            unit[axis] = 1.0;
            let found = dispatch!(f64, simd => velocity_by(simd, row, unit, axes));
            let moved = |by: f64| {
                let (rotation, shift) = (DVec3::from_slice(&unit[..3]) * by, DVec3::from_slice(&unit[3..]) * by);
                px(DQuat::from_scaled_axis(rotation) * point + shift)
            };
            let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            for (found, expected) in found.into_iter().zip(expected.to_array()) {
                assert!((found - expected).abs() < 1e-6, "axis {axis}, {point}: {found} instead of {expected}");
            }
        }
    }
}

#[test]
fn without_motion_nothing_changes() {
    let given = ellipses(9, 5);
    for spec in exposures() {
        assert_eq!(exposed::<f64>(&given, &[0.0; PARAMETERS], &spec), given, "to the last bit");
        assert_eq!(exposed::<f32>(&given, &[0.0; PARAMETERS], &spec), given, "to the last bit");
    }
}

#[test]
fn gradients_are_the_differences_of_the_change() {
    // More than a run of the twin.
    let count = 1_100;
    let mut projected = ellipses(count, 6);
    // Steps of differences are too long for thinner needles.
    projected.chunks_mut(COLUMNS).for_each(|row| row[4] = row[4].max(0.2));
    let weights = Random::new(7).fill(COLUMNS * count, -1.0, 1.0);
    for spec in exposures() {
        let found = expose_backward_cpu(Exposed { projected: &projected[..], twist: &TWIST[..] }, &weights, &spec);
        check_gradient("projected", &projected[..70 * COLUMNS], &found.projected[..70 * COLUMNS], 1, |rows| {
            inner_product(&exposed::<f64>(rows, &TWIST, &spec), &weights[..rows.len()])
        });
        check_gradient("twist", &TWIST, &found.twist, 1, |twist| {
            inner_product(&exposed::<f64>(&projected, twist, &spec), &weights)
        });
    }
}

/// A much wider blur than ellipse, where a derivative by differences of shares would lose all digits.
#[test]
fn gradients_keep_their_digits_where_widths_differ() {
    for w in [[3e4, -2e4], [1e-4, 2e-4]] {
        let row = [0.0, 0.0, 0.7, -0.4, 1.3, 1.0, 0.8];
        let grad = [0.0, 0.0, 0.3, -0.7, 0.9, 0.0, 0.6];
        let rounded = [row, grad].map(|row| row.map(|value| f64::from(value as f32)));
        let in_f32 = dispatch!(f32, simd => widened_backward::<_, f32>(simd, rounded, w));
        let expected = dispatch!(f64, simd => widened_backward::<_, f64>(simd, rounded, w));
        for (i, (found, expected)) in in_f32.into_iter().zip(expected).enumerate() {
            let error = (found - expected).abs();
            assert!(error <= 4e-6 * expected.abs() + 1e-30, "{w:?}, {i}: {found:e} instead of {expected:e}");
        }
    }
}

#[test]
fn a_culled_gaussian_stays_and_has_no_say() {
    let row = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0];
    let grad = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
    for spec in exposures() {
        assert_eq!(exposed::<f32>(&row, &TWIST, &spec), row);
        let found = expose_backward_cpu(Exposed { projected: &row[..], twist: &TWIST[..] }, &grad, &spec);
        assert_eq!((&found.projected[..], &found.twist[..]), (&grad[..], &[0.0; PARAMETERS][..]));
    }
}

fn projected(rows: &[f64], camera: &Intrinsics, device: &Device) -> Projected {
    let rows = TensorData::new(rows.to_vec(), [rows.len() / COLUMNS, COLUMNS]);
    Projected::of(Tensor::from_data(rows, (device, DType::F32)), *camera)
}

#[test]
fn tensors_get_their_gradients() {
    let device = Device::flex().autodiff();
    let rows = ellipses(5, 8);
    let before = Projected::of(projected(&rows, &CAMERA, &device).packed().clone().require_grad(), CAMERA);
    let twist = Tensor::<1>::from_floats([0.01, -0.02, 0.03, 0.1, 0.2, -0.1], &device).require_grad();
    let after = super::rolled(&blurred(&before, &twist, MARGIN).unwrap(), &twist, MARGIN).unwrap();
    assert_eq!(after.len(), 5);
    let gradients = after.packed().clone().sum().backward();
    assert!(twist.grad(&gradients).unwrap().abs().min().into_scalar::<f32>() > 0.0);
    assert_eq!(before.packed().grad(&gradients).unwrap().dims(), [5, COLUMNS]);
    // Neither is tracked, and one of the two.
    let still = projected(&rows, &CAMERA, &Device::flex());
    assert!(!blurred(&still, &twist.clone().inner(), MARGIN).unwrap().packed().is_require_grad());
    let fixed = Projected::of(Tensor::from_inner(still.packed().clone()), CAMERA);
    let gradients = blurred(&fixed, &twist, MARGIN).unwrap().packed().clone().sum().backward();
    assert!(twist.grad(&gradients).is_some());
}

#[test]
fn what_cannot_be_changed_is_refused() {
    let device = Device::flex();
    let rows = ellipses(2, 9);
    let short = Tensor::<1>::zeros([5], &device);
    let error = blurred(&projected(&rows, &CAMERA, &device), &short, MARGIN).unwrap_err();
    assert!(matches!(error, SplatError::Shape { name: "twist", expected: "[6]", .. }), "{error}");
    let bent = Intrinsics { model: CameraModel::Fisheye, ..CAMERA };
    let error =
        blurred(&projected(&rows, &bent, &device), &Tensor::zeros([6], &device), MARGIN).unwrap_err().to_string();
    assert!(error.contains("Fisheye") && error.contains("average renders"), "{error}");
}
