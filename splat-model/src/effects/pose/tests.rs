use splat_op::{Camera, Intrinsics};

use super::*;

fn pose() -> DAffine3 {
    DAffine3::from_rotation_translation(glam::DQuat::from_rotation_y(0.7), DVec3::new(0.3, -0.2, 2.0))
}

fn tensor(pose: &DAffine3, device: &Device) -> Tensor<2> {
    Camera::new(Intrinsics::centred(8, 8, 8.0), pose, device).cam_from_world
}

fn poses(correction: [[f32; 3]; 2], extent: f64, device: &Device) -> Poses {
    let mut poses = Poses::new(PoseConfig::default(), extent, 1, device);
    poses.corrections[0].set(Tensor::from_floats(correction, device));
    poses
}

#[test]
fn no_correction_is_the_pose_to_the_last_bit() {
    let device = Device::flex();
    let given = tensor(&pose(), &device);
    let corrected = poses([[0.0; 3]; 2], 5.0, &device).apply(given.clone(), 0).inner();
    assert_eq!(values_of(corrected), values_of(given));
}

#[test]
fn corrections_are_rigid_about_the_camera() {
    let device = Device::flex();
    for omega in [[0.02, -0.01, 0.03], [1.0, 2.0, -3.0], [300.0, 0.0, 1.0]] {
        let mut poses = poses([omega, [0.1, 0.0, -0.2]], 5.0, &device);
        let found = values_of(poses.apply(tensor(&pose(), &device), 0).inner());
        let expected = poses.corrected(&pose(), 0);
        let omega = DVec3::from_array(omega.map(f64::from));
        let angle = 2.0 * (omega.length() / 2.0).atan();
        let turn = DAffine3::from_axis_angle(omega.normalize(), angle);
        let by_axis = DAffine3::from_translation(DVec3::new(0.5, 0.0, -1.0)) * turn * pose();
        assert!(expected.abs_diff_eq(by_axis, 1e-6), "{expected:?} and {by_axis:?}");
        for (i, found) in found.into_iter().enumerate() {
            let expected = if i % 4 == 3 { expected.translation[i / 4] } else { expected.matrix3.col(i % 4)[i / 4] };
            assert!((f64::from(found) - expected).abs() < 2e-6, "{found} instead of {expected}");
        }
    }
}

/// Compares the gradient of autodiff with finite differences of the corrected pose in f64.
#[test]
fn gradients_are_those_of_the_map() {
    let device = Device::flex();
    let at = [[0.3_f32, -0.2, 0.1], [0.05, 0.1, -0.02]];
    let weights: Vec<f64> = (0..12).map(|i| (1.7 * f64::from(i)).sin()).collect();
    let value = |correction: [[f32; 3]; 2]| {
        let moved = poses(correction, 2.0, &device).corrected(&pose(), 0);
        let entry = |i: usize| if i % 4 == 3 { moved.translation[i / 4] } else { moved.matrix3.col(i % 4)[i / 4] };
        (0..12).map(|i| weights[i] * entry(i)).sum::<f64>()
    };
    let mut poses = poses(at, 2.0, &device);
    let rows: Vec<f32> = weights.iter().map(|&weight| weight as f32).collect();
    let weights = Tensor::<1>::from_floats(rows.as_slice(), &device).reshape([3, 4]);
    let loss = (poses.apply(tensor(&pose(), &device), 0) * Tensor::from_inner(weights)).sum();
    let gradient = values_of(poses.corrections[0].gradient(&mut loss.backward()).unwrap());
    for i in 0..6 {
        let moved = |by: f32| {
            let mut correction = at;
            correction.as_flattened_mut()[i] += by;
            (value(correction), f64::from(correction.as_flattened()[i]))
        };
        let ((high, to), (low, from)) = (moved(1e-3), moved(-1e-3));
        // Corrections are learned in units of their reach.
        let expected = (high - low) / (to - from) * 0.06;
        assert!((f64::from(gradient[i]) - expected).abs() < 6e-6, "{i}: {} instead of {expected}", gradient[i]);
    }
}

/// For any length of run and number of photographs, a camera with a constant gradient moves as far as configured.
#[test]
fn a_camera_goes_as_far_as_stated() {
    let device = Device::flex();
    for (views, steps) in [(1, 40), (2, 400)] {
        let mut poses = Poses::new(PoseConfig { reach_extents: 0.02, ..PoseConfig::default() }, 1.0, views, &device);
        for step in (1..=steps).filter(|step| step % views == 0) {
            let mut gradients = poses.corrections[0].tracked().sum().backward();
            poses.step(&mut gradients, EffectContext { view: 0, step, steps, verdict: None });
        }
        let moved = values_of(poses.corrections[0].value());
        for (moved, reach) in moved.into_iter().zip([0.06, 0.06, 0.06, 0.02, 0.02, 0.02]) {
            assert!((-1.1 * reach..-0.9 * reach).contains(&moved), "{moved} of {reach} in {steps} steps");
        }
    }
}
