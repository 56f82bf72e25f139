use burn::tensor::{Device, Tensor, TensorData};

use super::cpu::{corrected_backward_cpu, corrected_cpu, miss_cpu};
use super::*;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

/// A correction and a pose that is no rotation, exact in f32.
pub(super) fn correction(seed: u64, size: f64) -> Corrected<Vec<f64>> {
    let mut random = Random::new(seed);
    let mut fill = |count: usize, size: f64| -> Vec<f64> {
        random.fill(count, -size, size).iter().map(|value| f64::from(*value as f32)).collect()
    };
    Corrected { correction: fill(6, size), cam_from_world: fill(POSE, 2.0) }
}

/// A pose near the identity, points in front of it and directions near them, exact in f32.
pub(super) fn sighted(count: usize) -> Sighted<Vec<f64>> {
    let mut random = Random::new(count as u64);
    let mut pose = random.fill(POSE, -0.1, 0.1);
    (0..3).for_each(|i| pose[5 * i] += 1.0);
    let (mut points, mut directions) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let point = [random.between(-2.0, 2.0), random.between(-2.0, 2.0), random.between(1.0, 6.0)];
        let away = point.map(|x| x + random.between(-0.3, 0.3));
        let length = away.iter().map(|x| x * x).sum::<f64>().sqrt();
        points.extend(point);
        directions.extend(away.map(|x| x / length));
    }
    Sighted { pose, points, directions }.map(|values| values.iter().map(|value| f64::from(*value as f32)).collect())
}

pub(super) const ROBUST: f64 = 0.0625;

#[test]
fn no_correction_is_the_pose_to_the_last_bit_and_others_are_rigid() {
    let Corrected { cam_from_world, .. } = correction(1, 1.0);
    let still = Corrected { correction: &[0.0; 6][..], cam_from_world: &cam_from_world[..] };
    assert_eq!(corrected_cpu(still, 3.0), cam_from_world);
    let identity: Vec<f64> = (0..POSE).map(|i| if i % 5 == 0 { 1.0 } else { 0.0 }).collect();
    for size in [0.01, 1.0, 300.0] {
        let Corrected { correction, .. } = correction(2, size);
        let found = corrected_cpu(Corrected { correction: &correction[..], cam_from_world: &identity[..] }, 3.0);
        for (i, k) in [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)] {
            let product: f64 = (0..3).map(|j| found[4 * i + j] * found[4 * k + j]).sum();
            assert!((product - if i == k { 1.0 } else { 0.0 }).abs() < 1e-12, "rows {i} and {k}: {product}");
        }
        // It rotates by 2 atan(|ω|/2) about ω, which it leaves where it is.
        let omega = &correction[..3];
        let square: f64 = omega.iter().map(|x| x * x).sum();
        let trace = found[0] + found[5] + found[10];
        assert!((trace - 1.0 - 2.0 * (2.0 * (square.sqrt() / 2.0).atan()).cos()).abs() < 1e-12);
        for i in 0..3 {
            assert!((inner_product(&found[4 * i..4 * i + 3], omega) - omega[i]).abs() < 1e-12 * size);
            assert!((found[4 * i + 3] - 3.0 * correction[3 + i]).abs() < 1e-12 * size);
        }
    }
}

#[test]
fn gradients_are_those_of_differences() {
    for size in [0.0, 0.05, 2.0] {
        let inputs = correction(3, size);
        let weights = Random::new(4).fill(POSE, -1.0, 1.0);
        let slices = inputs.each_ref().map(|values| &values[..]);
        let found = corrected_backward_cpu(slices, &weights, 1.5);
        let total =
            |correction: &[f64]| inner_product(&corrected_cpu(Corrected { correction, ..slices }, 1.5), &weights);
        check_gradient("correction", &inputs.correction, &found, 1, total);
    }
    let inputs = sighted(600);
    let slices = inputs.each_ref().map(|values| &values[..]);
    let (_, gradient) = miss_cpu(slices, ROBUST);
    check_gradient("pose", &inputs.pose, &gradient, 1, |pose| miss_cpu(Sighted { pose, ..slices }, ROBUST).0);
}

#[test]
fn the_miss_is_about_the_mean_angle() {
    // Two points: one seen where it is, one a quarter turn off.
    let pose: Vec<f64> = (0..POSE).map(|i| if i % 5 == 0 { 1.0 } else { 0.0 }).collect();
    let inputs = Sighted {
        pose: &pose[..],
        points: &[0.0, 0.0, 5.0, 0.0, 0.0, 2.0][..],
        directions: &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0][..],
    };
    let (value, _) = miss_cpu(inputs, 1e-3);
    assert!((value - 0.5 * ((2.0_f64 + 1e-6).sqrt() - 1e-3)).abs() < 1e-12, "{value}");
    let empty = Sighted { points: &[][..], directions: &[][..], ..inputs };
    assert_eq!(miss_cpu(empty, 1e-3), (0.0, vec![0.0; POSE]));
    // A point at the camera has no direction, and numbers stay finite.
    let inside = Sighted { points: &[0.0, 0.0, 0.0][..], directions: &[0.0, 0.0, 1.0][..], ..inputs };
    assert!(miss_cpu(inside, 1e-3).1.iter().all(|value| value.is_finite()));
}

#[test]
fn tensors_get_their_gradients_and_other_shapes_are_refused() {
    let device = Device::flex().autodiff();
    let tensor =
        |values: &[f64], shape: [usize; 2]| Tensor::<2>::from_data(TensorData::new(values.to_vec(), shape), &device);
    let Corrected { correction, cam_from_world } = correction(5, 0.3);
    let (given, pose) = (tensor(&correction, [2, 3]).require_grad(), tensor(&cam_from_world, [3, 4]));
    let inputs = sighted(20);
    let (points, directions) = (tensor(&inputs.points, [20, 3]).inner(), tensor(&inputs.directions, [20, 3]).inner());
    // A graph is differentiated once.
    let moved = || corrected(&given, &pose, 2.0).unwrap();
    let twin = miss(&moved(), &points, &directions, ROBUST).unwrap();
    let tensors = miss_in_tensors(&moved(), &points, &directions, ROBUST);
    let gradient = |value: Tensor<1>| {
        let found = given.grad(&(value * 3.0).backward()).unwrap().into_data().try_to_vec::<f32>().unwrap();
        found.into_iter().map(f64::from).collect::<Vec<f64>>()
    };
    let apart = twin.clone().into_scalar::<f32>() - tensors.clone().into_scalar::<f32>();
    assert!(apart.abs() < 1e-6, "{apart}");
    let slices = Corrected { correction: &correction[..], cam_from_world: &cam_from_world[..] };
    let sighted = |pose| Sighted { pose, points: &inputs.points[..], directions: &inputs.directions[..] };
    let (_, of_pose) = miss_cpu(sighted(&corrected_cpu(slices, 2.0)[..]), ROBUST);
    let expected = corrected_backward_cpu(slices, &of_pose, 2.0);
    for (path, found) in [("twin", gradient(twin)), ("tensors", gradient(tensors))] {
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - 3.0 * expected).abs() < 1e-5, "{path}: {found} instead of {}", 3.0 * expected);
        }
    }
    let wrong = tensor(&cam_from_world, [4, 3]);
    assert!(matches!(corrected(&given, &wrong, 1.0), Err(SplatError::Shape { name: "cam_from_world", .. })));
    assert!(matches!(miss(&wrong, &points, &directions, 1.0), Err(SplatError::Shape { name: "pose", .. })));
}
