use burn::tensor::{DType, Device, Tensor, TensorData};

use super::*;
use crate::SplatError;
use crate::testing::devices;
use crate::testing::finite::{check_gradient, inner_product};
use crate::testing::random::Random;

/// Numbers of a pose.
const POSE: usize = 12;

/// A correction and a pose, or their gradients.
#[derive(Clone, Copy)]
struct Corrected<T> {
    correction: T,
    cam_from_world: T,
}

fn tensor(values: &[f64], columns: usize, device: &Device, dtype: DType) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len() / columns, columns]), (device, dtype))
}

fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}

/// The corrected pose, and the gradients of its sum with these weights.
fn found(
    inputs: Corrected<&[f64]>,
    weights: &[f64],
    unit: f64,
    on: (&Device, DType),
) -> (Vec<f64>, Corrected<Vec<f64>>) {
    let tracked = |values: &[f64], columns| Tensor::from_inner(tensor(values, columns, on.0, on.1)).require_grad();
    let (correction, pose) = (tracked(inputs.correction, 3), tracked(inputs.cam_from_world, 4));
    let value = corrected(&correction, &pose, unit).unwrap();
    let gradients = (value.clone() * Tensor::from_inner(tensor(weights, 4, on.0, on.1))).sum().backward();
    let of = |of: &Tensor<2>| host(of.grad(&gradients).expect("tracked"));
    (host(value), Corrected { correction: of(&correction), cam_from_world: of(&pose) })
}

const IN_F64: DType = DType::F64;

fn corrected_of(inputs: Corrected<&[f64]>, unit: f64) -> Vec<f64> {
    let device = Device::flex();
    let (correction, pose) =
        (tensor(inputs.correction, 3, &device, IN_F64), tensor(inputs.cam_from_world, 4, &device, IN_F64));
    host(corrected(&correction, &pose, unit).unwrap())
}

/// A correction and a pose that is no rotation, exact in f32.
fn correction(seed: u64, size: f64) -> Corrected<Vec<f64>> {
    let mut random = Random::new(seed);
    let mut fill = |count: usize, size: f64| -> Vec<f64> {
        random.fill(count, -size, size).iter().map(|value| f64::from(*value as f32)).collect()
    };
    Corrected { correction: fill(6, size), cam_from_world: fill(POSE, 2.0) }
}

/// A pose, points and directions.
struct Sighted<T> {
    pose: T,
    points: T,
    directions: T,
}

/// The miss in f64 and its derivative with respect to the pose.
fn miss_of(inputs: &Sighted<&[f64]>, scale: f64) -> (f64, Vec<f64>) {
    let tensor = |values: &[f64], columns| tensor(values, columns, &Device::flex(), IN_F64);
    let pose = Tensor::from_inner(tensor(inputs.pose, 4)).require_grad();
    let value = miss(&pose, &tensor(inputs.points, 3), &tensor(inputs.directions, 3), scale).unwrap();
    let gradient = pose.grad(&value.backward()).expect("tracked").into_data().try_to_vec::<f64>().unwrap();
    (value.into_scalar::<f64>(), gradient)
}

/// A pose near the identity, points in front of it and directions near them, exact in f32.
fn sighted(count: usize) -> Sighted<Vec<f64>> {
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
    let [pose, points, directions] = [pose, points, directions]
        .map(|values: Vec<f64>| values.iter().map(|value| f64::from(*value as f32)).collect());
    Sighted { pose, points, directions }
}

const ROBUST: f64 = 0.0625;

#[test]
fn no_correction_is_the_pose_to_the_last_bit_and_others_are_rigid() {
    let Corrected { cam_from_world, .. } = correction(1, 1.0);
    let still = Corrected { correction: &[0.0; 6][..], cam_from_world: &cam_from_world[..] };
    assert_eq!(corrected_of(still, 3.0), cam_from_world);
    let identity: Vec<f64> = (0..POSE).map(|i| if i % 5 == 0 { 1.0 } else { 0.0 }).collect();
    for size in [0.01, 1.0, 300.0] {
        let Corrected { correction, .. } = correction(2, size);
        let found = corrected_of(Corrected { correction: &correction[..], cam_from_world: &identity[..] }, 3.0);
        for (i, k) in [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)] {
            let product: f64 = (0..3).map(|j| found[4 * i + j] * found[4 * k + j]).sum();
            assert!((product - if i == k { 1.0 } else { 0.0 }).abs() < 1e-12, "rows {i} and {k}: {product}");
        }
        // It rotates by 2 atan(|ω|/2) about ω, which it leaves where it is.
        let omega = &correction[..3];
        let square: f64 = omega.iter().map(|x| x * x).sum();
        let trace = found[0] + found[5] + found[10];
        assert!((trace - 1.0 - 2.0 * (2.0 * (square.sqrt() / 2.0).atan()).cos()).abs() < 1e-12);
        let axial = [found[9] - found[6], found[2] - found[8], found[4] - found[1]];
        for i in 0..3 {
            assert!((axial[i] - 2.0 * omega[i] / (1.0 + square / 4.0)).abs() < 1e-12, "the sense of the rotation");
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
        let slices = Corrected { correction: &inputs.correction[..], cam_from_world: &inputs.cam_from_world[..] };
        let (_, of) = found(slices, &weights, 1.5, (&Device::flex(), IN_F64));
        let total = |inputs: Corrected<&[f64]>| inner_product(&corrected_of(inputs, 1.5), &weights);
        check_gradient("correction", &inputs.correction, &of.correction, 1, |correction| {
            total(Corrected { correction, ..slices })
        });
        check_gradient("pose", &inputs.cam_from_world, &of.cam_from_world, 1, |cam_from_world| {
            total(Corrected { cam_from_world, ..slices })
        });
    }
    let Sighted { pose, points, directions } = sighted(600);
    let at = |pose: &[f64]| miss_of(&Sighted { pose, points: &points[..], directions: &directions[..] }, ROBUST);
    check_gradient("pose", &pose, &at(&pose).1, 1, |pose| at(pose).0);
}

/// Numbers of about 2, of which sums of a dozen products are taken.
#[test]
fn every_device_agrees_with_f64() {
    let close = |found: &[f64], expected: &[f64], what: &str| {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "{what}: {found} instead of {expected}");
        }
    };
    for (seed, size) in [(1, 0.05), (2, 1.0)] {
        let inputs = correction(seed, size);
        let weights: Vec<f64> = Random::new(6).fill(POSE, -1.0, 1.0).iter().map(|w| f64::from(*w as f32)).collect();
        let slices = Corrected { correction: &inputs.correction[..], cam_from_world: &inputs.cam_from_world[..] };
        let (expected, of_expected) = found(slices, &weights, 1.5, (&Device::flex(), IN_F64));
        for device in devices() {
            let (value, of) = found(slices, &weights, 1.5, (&device, DType::F32));
            close(&value, &expected, &format!("{device:?}: pose"));
            close(&of.correction, &of_expected.correction, &format!("{device:?}: of the correction"));
            close(&of.cam_from_world, &of_expected.cam_from_world, &format!("{device:?}: of the pose"));
        }
    }
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
    let (value, _) = miss_of(&inputs, 1e-3);
    assert!((value - 0.5 * ((2.0_f64 + 1e-6).sqrt() - 1e-3)).abs() < 1e-12, "{value}");
    let nothing = Tensor::<2>::zeros([0, 3], &Device::flex());
    let value = miss(&Tensor::zeros([3, 4], &Device::flex()), &nothing, &nothing, 1e-3).unwrap();
    assert_eq!(value.into_scalar::<f32>(), 0.0);
    // A point at the camera has no direction, and numbers stay finite.
    let inside = Sighted { points: &[0.0, 0.0, 0.0][..], directions: &[0.0, 0.0, 1.0][..], ..inputs };
    assert!(miss_of(&inside, 1e-3).1.iter().all(|value| value.is_finite()));
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
    let value = miss(&corrected(&given, &pose, 2.0).unwrap(), &points, &directions, ROBUST).unwrap() * 3.0;
    let of_given = given.grad(&value.backward()).unwrap().into_data().try_to_vec::<f32>().unwrap();
    let slices = Corrected { correction: &correction[..], cam_from_world: &cam_from_world[..] };
    let sighted = Sighted {
        pose: &corrected_of(slices, 2.0)[..],
        points: &inputs.points[..],
        directions: &inputs.directions[..],
    };
    let (_, expected) = found(slices, &miss_of(&sighted, ROBUST).1, 2.0, (&Device::flex(), IN_F64));
    for (found, expected) in of_given.iter().zip(&expected.correction) {
        assert!((f64::from(*found) - 3.0 * expected).abs() < 1e-5, "{found} instead of {}", 3.0 * expected);
    }
    let wrong = tensor(&cam_from_world, [4, 3]);
    assert!(matches!(corrected(&given, &wrong, 1.0), Err(SplatError::Shape { name: "cam_from_world", .. })));
    assert!(matches!(miss(&wrong, &points, &directions, 1.0), Err(SplatError::Shape { name: "pose", .. })));
}
