use glam::{DAffine3, DMat3, DQuat, DVec3};
use splat_op::RenderOptions;
use splat_op::optics::{blurred, rolled};

use super::super::testing::{average, camera, check_gradient, distance, host, pose, render, tensor};
use super::*;

const TWIST: [f64; 6] = [0.021, -0.017, 0.03, 0.06, -0.05, 0.02];

fn twist(scale: f64) -> Tensor<1> {
    tensor(&TWIST.map(|value| value * scale), [6])
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
fn a_blurred_ellipse_is_the_average_of_sub_exposures() {
    let camera = camera();
    let pictures: Vec<_> =
        poses(&pose(), &twist(1.0), 32).into_iter().map(|pose| render(camera, pose, |projected| projected)).collect();
    let truth = average(&pictures);
    let sharp = render(camera, pose(), |projected| projected);
    let margin = RenderOptions::exact().jacobian_margin;
    let found = render(camera, pose(), |projected| blurred(&projected, &twist(1.0), margin).unwrap());
    let (without, with) = (distance(&sharp, &truth), distance(&found, &truth));
    assert!(without > 1e-3 && with < 0.1 * without, "{with:e}, and {without:e} without blur");
}

#[test]
fn a_rolled_ellipse_is_in_each_row_where_it_is_at_that_time() {
    let camera = camera();
    let (height, row) = (camera.height, 2 * camera.width);
    let at_row = |y: usize| {
        let time = (y as f64 + 0.5) / height as f64 - 0.5;
        render(camera, pose_at(&pose(), &twist(2.0), time), |projected| projected)[y * row..][..row].to_vec()
    };
    let truth: Vec<f64> = (0..height).flat_map(at_row).collect();
    let still = render(camera, pose(), |projected| projected);
    let margin = RenderOptions::exact().jacobian_margin;
    let found = render(camera, pose(), |projected| rolled(&projected, &twist(2.0), margin).unwrap());
    let (without, with) = (distance(&still, &truth), distance(&found, &truth));
    assert!(without > 1e-2 && with < 0.1 * without, "{with:e}, and {without:e} without");
}
