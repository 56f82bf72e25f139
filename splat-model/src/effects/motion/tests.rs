use burn::tensor::DType;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use splat_op::CameraModel;

use super::super::testing::{
    FIELDS, average, camera, check_gradient, distance, ellipses, host, numbers, pose, render, tensor, varied, vectors,
};
use super::*;

const TWIST: [f64; 6] = [0.021, -0.017, 0.03, 0.06, -0.05, 0.02];

fn twist(scale: f64) -> Tensor<1> {
    tensor(&TWIST.map(|value| value * scale), [6], DType::F64)
}

fn affine(pose: Tensor<2>) -> DAffine3 {
    let m = host(pose);
    let column = |j: usize| DVec3::new(m[j], m[4 + j], m[8 + j]);
    DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) }
}

/// `exp(ξ)` by many small steps of the differential equation `p' = ω × p + τ`.
fn exponential(twist: [f64; 6]) -> DAffine3 {
    let (rotation, shift) = (DVec3::from_slice(&twist[..3]), DVec3::from_slice(&twist[3..]));
    let steps = 1 << 14;
    let half = DAffine3::from_quat(DQuat::from_scaled_axis(rotation / (2.0 * f64::from(steps))));
    let step = half * DAffine3::from_translation(shift / f64::from(steps)) * half;
    (0..steps).fold(DAffine3::IDENTITY, |all, _| step * all)
}

#[test]
fn poses_follow_the_twist() {
    for (scale, tolerance) in [(1.0, 1e-10), (40.0, 1e-7), (0.0, 0.0_f64)] {
        for (pose_found, t) in poses(&pose(), &twist(scale), 4).into_iter().zip([-0.375, -0.125, 0.125, 0.375]) {
            let found = affine(pose_found);
            let expected = exponential(TWIST.map(|value| value * scale * t)) * affine(pose());
            assert!(
                found.abs_diff_eq(expected, tolerance.max(f64::EPSILON)),
                "{scale} {t}: {found} instead of {expected}"
            );
            let square = found.matrix3 * found.matrix3.transpose();
            assert!(square.abs_diff_eq(DMat3::IDENTITY, 1e-14), "no rotation: {square}");
        }
    }
    assert_eq!(host(pose_at(&pose(), &twist(0.0), 0.3)), host(pose()), "to the last bit");
    check_gradient(&[TWIST.to_vec(), host(pose().reshape([12]))].concat(), |values| {
        let pose = values.clone().narrow(0, 6, 12).reshape([3, 4]);
        pose_at(&pose, &values.narrow(0, 0, 6), 0.4).reshape([12])
    });
    check_gradient(&[0.0; 6], |twist| pose_at(&beside(pose(), &twist), &twist, 0.4).reshape([12]));
}

/// `pose`, on an autodiff device if `like` is.
fn beside(pose: Tensor<2>, like: &Tensor<1>) -> Tensor<2> {
    if like.is_autodiff() { Tensor::from_inner(pose) } else { pose }
}

#[test]
fn velocities_are_the_slopes_of_where_points_go() {
    let camera = camera();
    let points = [DVec3::new(-0.4, 0.3, 2.0), DVec3::new(0.7, -0.9, 3.5), DVec3::new(0.0, 0.0, 1.0)];
    let px = |point: DVec3| camera.projector().px_from_cam(point).unwrap();
    let mut values = vec![0.0; FIELDS * 3];
    for (i, point) in points.into_iter().enumerate() {
        values[2 * i..][..2].copy_from_slice(&px(point).to_array());
        (values[2 * 3 + i], values[4 * 3 + i], values[5 * 3 + i]) = (1.0, 1.0, point.z);
    }
    let ellipses = ellipses(&tensor(&values, [FIELDS * 3], DType::F64), 3);
    for axis in 0..6 {
        let mut unit = [0.0; 6];
        unit[axis] = 1.0;
        let found = velocity(&ellipses, &camera, &tensor(&unit, [6], DType::F64), &RenderOptions::standard()).unwrap();
        let found = host(found);
        let moved = |by: f64, point: DVec3| {
            let (rotation, shift) = (DVec3::from_slice(&unit[..3]) * by, DVec3::from_slice(&unit[3..]) * by);
            px(DQuat::from_scaled_axis(rotation) * point + shift)
        };
        for (i, point) in points.into_iter().enumerate() {
            let expected = (moved(1e-5, point) - moved(-1e-5, point)) / 2e-5;
            for (found, expected) in found[2 * i..][..2].iter().zip(expected.to_array()) {
                assert!((found - expected).abs() < 1e-6, "axis {axis}, {point}: {found} instead of {expected}");
            }
        }
    }
}

#[test]
fn a_blurred_ellipse_is_the_average_of_sub_exposures() {
    let camera = camera();
    let pictures: Vec<_> =
        poses(&pose(), &twist(1.0), 32).into_iter().map(|pose| render(camera, pose, |e| e)).collect();
    let truth = average(&pictures);
    let sharp = render(camera, pose(), |e| e);
    let found = render(camera, pose(), |e| {
        let v = velocity(&e, &camera, &twist(1.0), &RenderOptions::exact()).unwrap();
        blurred(e, v)
    });
    let (without, with) = (distance(&sharp, &truth), distance(&found, &truth));
    assert!(without > 1e-3 && with < 0.1 * without, "{with:e}, and {without:e} without blur");
}

#[test]
fn a_rolled_ellipse_is_in_each_row_where_it_is_at_that_time() {
    let camera = camera();
    let (height, row) = (camera.height, 2 * camera.width);
    let at_row = |y: usize| {
        let time = (y as f64 + 0.5) / height as f64 - 0.5;
        render(camera, pose_at(&pose(), &twist(2.0), time), |e| e)[y * row..][..row].to_vec()
    };
    let truth: Vec<f64> = (0..height).flat_map(at_row).collect();
    let still = render(camera, pose(), |e| e);
    let found = render(camera, pose(), |e| {
        let v = velocity(&e, &camera, &twist(2.0), &RenderOptions::exact()).unwrap();
        rolled(e, v, height)
    });
    let (without, with) = (distance(&still, &truth), distance(&found, &truth));
    assert!(without > 1e-2 && with < 0.1 * without, "{with:e}, and {without:e} without");
}

#[test]
fn a_rolling_shutter_by_hand() {
    // Round, at (30, 36) of 48 rows: a quarter of the height below the middle. It moves down by 12 px: k = 4/3.
    let given = [30.0, 36.0, 2.0, 0.0, 3.0, 1.0, 0.5];
    let v = tensor(&[-6.0, 12.0], [1, 2], DType::F64);
    let after = host(numbers(rolled(ellipses(&tensor(&given, [FIELDS], DType::F64), 1), v, 48)));
    // y' = 4/3 (36 − 6) = 40, t = 40/48 − 1/2 = 1/3, x' = 30 − 6/3; q = −4/3 · 6/48 = −1/6.
    let xx = 4.0 + 9.0 / 36.0;
    let expected: [f64; 7] =
        [28.0, 40.0, f64::sqrt(xx), -4.0 / 3.0 * 9.0 / 6.0 / xx, 4.0 / 3.0 * 6.0 / f64::sqrt(xx), 1.0, 0.5];
    for (found, expected) in after.iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
    }
    // Faster than the shutter: clamped to half of the height.
    let rows = |vy: f64| {
        let v = tensor(&[0.0, vy], [1, 2], DType::F64);
        host(numbers(rolled(ellipses(&tensor(&given, [FIELDS], DType::F64), 1), v, 48)))
    };
    assert_eq!(rows(48.0), rows(24.0));
    assert_eq!(rows(-1e9), rows(-24.0));
    assert!(rows(24.0) != rows(23.0));
}

#[test]
fn no_motion_changes_nothing() {
    for dtype in [DType::F64, DType::F32] {
        let before = tensor(&varied(9), [FIELDS * 9], dtype);
        let given = || ellipses(&before, 9);
        let v = || velocity(&given(), &camera(), &tensor(&[0.0; 6], [6], dtype), &RenderOptions::standard()).unwrap();
        assert_eq!(host(numbers(blurred(given(), v()))), host(before.clone()), "to the last bit");
        assert_eq!(host(numbers(rolled(given(), v(), 36))), host(before.clone()), "to the last bit");
    }
}

#[test]
fn gradients_are_those_of_differences() {
    let count = 5;
    let at = [varied(count), TWIST.to_vec(), vectors(count, 9.0)].concat();
    let twist = |values: &Tensor<1>| values.clone().narrow(0, FIELDS * count, 6);
    let of = |values: &Tensor<1>| {
        velocity(&ellipses(values, count), &camera(), &twist(values), &RenderOptions::standard()).unwrap()
    };
    check_gradient(&at, |values| of(&values).reshape([2 * count]));
    check_gradient(&at, |values| numbers(blurred(ellipses(&values, count), of(&values) * 9.0)));
    check_gradient(&at, |values| {
        let v = values.clone().narrow(0, FIELDS * count + 6, 2 * count).reshape([count, 2]);
        numbers(rolled(ellipses(&values, count), v, 36))
    });
}

#[test]
fn a_culled_gaussian_stays_and_has_no_say() {
    let device = burn::tensor::Device::flex().autodiff();
    let row = [0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0];
    let given = ellipses(&Tensor::from_floats(row, &device), 1);
    let twist = Tensor::<1>::from_floats([0.1, 0.2, 0.3, 4.0, 5.0, 6.0], &device).require_grad();
    let v = velocity(&given, &camera(), &twist, &RenderOptions::standard()).unwrap();
    let (blurred, rolled) = (numbers(blurred(given.clone(), v.clone())), numbers(rolled(given, v.clone(), 36)));
    assert_eq!([host(blurred.clone().inner()), host(rolled.clone().inner())], [row, row]);
    let mut gradients = (blurred.sum() + rolled.sum() + v.sum()).backward();
    assert_eq!(host(twist.grad_remove(&mut gradients).unwrap()), [0.0; 6]);
}

#[test]
fn a_lens_is_told_what_to_do() {
    let camera = Intrinsics { model: CameraModel::Fisheye, ..camera() };
    let given = ellipses(&tensor(&varied(2), [FIELDS * 2], DType::F64), 2);
    let error = velocity(&given, &camera, &twist(1.0), &RenderOptions::standard()).unwrap_err();
    assert_eq!(error, ScreenError::Lens(CameraModel::Fisheye));
    assert!(error.to_string().contains("Fisheye") && error.to_string().contains("average renders"), "{error}");
}
