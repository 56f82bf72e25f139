use burn::tensor::{DType, TensorData};
use glam::{DVec2, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::gaussians::values_of;

const SIZE: [usize; 2] = [9, 12];

fn cameras() -> Vec<Intrinsics> {
    let plain = Intrinsics::pinhole(SIZE[1], SIZE[0], [14.0, 15.0], [5.5, 4.75]);
    let none = [0.0; 8];
    let opencv = [0.05, -0.01, 0.002, -0.001, 0.0, 0.0, 0.0, 0.0];
    let fisheye = [0.02, -0.003, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    vec![
        plain,
        plain.with_lens(CameraModel::OpenCv, opencv),
        plain.with_lens(CameraModel::Fisheye, fisheye),
        plain.with_lens(CameraModel::Orthographic, none),
    ]
}

fn picture(values: Vec<f64>, channels: usize, device: &Device) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values, [SIZE[0], SIZE[1], channels]), (device, DType::F64))
}

/// The depths of a plane through `(0, 0, distance)` with a unit normal, in a camera's frame.
fn depths_of_plane(camera: &Intrinsics, normal: DVec3, distance: f64) -> Vec<f64> {
    let px = (0..SIZE[0] * SIZE[1]).map(|i| DVec2::new((i % SIZE[1]) as f64 + 0.5, (i / SIZE[1]) as f64 + 0.5));
    px.map(|px| {
        let ray = camera.cam_from_px(px);
        let orthographic = camera.model == CameraModel::Orthographic;
        let origin = DVec3::new((px.x - camera.cx) / camera.fx, (px.y - camera.cy) / camera.fy, 0.0);
        let (origin, ray) = if orthographic { (origin, ray) } else { (DVec3::ZERO, ray / ray.z) };
        normal.dot(DVec3::new(0.0, 0.0, distance) - origin) / normal.dot(ray)
    })
    .collect()
}

#[test]
fn a_plane_has_its_normal_through_every_lens_at_any_distance() {
    let device = Device::flex();
    for camera in cameras() {
        let rays = PixelRays::new(&camera, &device);
        for normal in [DVec3::new(0.0, 0.0, -1.0), DVec3::new(0.5, -0.3, -0.8), DVec3::new(-0.6, 0.5, -0.7)] {
            let normal = normal.normalize();
            for distance in [1e-2, 3.0, 1e4] {
                let depths = depths_of_plane(&camera, normal, distance);
                let found = values_of(rays.normals(picture(depths, 1, &device)).cast(DType::F32));
                assert_eq!(found.len(), 3 * (SIZE[0] - 2) * (SIZE[1] - 2));
                // An orthographic camera's points are as far apart at any depth: f64 has digits for all.
                let error = found.chunks(3).map(|n| DVec3::new(n[0].into(), n[1].into(), n[2].into()).distance(normal));
                let worst = error.fold(0.0, f64::max);
                assert!(worst <= 2e-5, "{:?}, {normal}, {distance}: {worst:e}", camera.model);
            }
        }
    }
}

#[test]
fn normals_that_agree_cost_nothing_and_others_their_cosine() {
    let device = Device::flex();
    let (camera, normal) = (cameras()[0], DVec3::new(0.5, -0.3, -0.8).normalize());
    let rays = PixelRays::new(&camera, &device);
    let depth = picture(depths_of_plane(&camera, normal, 2.0), 1, &device);
    let alpha = picture(vec![0.75; SIZE[0] * SIZE[1]], 1, &device);
    for (shown, expected) in [(normal, 0.0), (normal.any_orthonormal_vector(), 0.75), (-normal, 1.5)] {
        let shown = picture((shown * 0.75).to_array().repeat(SIZE[0] * SIZE[1]), 3, &device);
        let loss = rays.normal_consistency(shown, depth.clone(), alpha.clone()).into_scalar::<f64>();
        assert!((loss - expected).abs() < 1e-5, "{loss}, expected {expected}");
    }
    // Where nothing is seen there is no surface.
    let [nothing, black] = [1, 3].map(|channels| picture(vec![0.0; channels * SIZE[0] * SIZE[1]], channels, &device));
    assert_eq!(rays.normal_consistency(black, nothing.clone(), nothing).into_scalar::<f64>(), 0.0);
}

#[test]
fn the_gradient_is_that_of_the_loss() {
    let device = Device::flex();
    for camera in cameras() {
        let rays = PixelRays::new(&camera, &device);
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut numbers = |count: usize, from: f64, to: f64| -> Vec<f64> {
            (0..count).map(|_| random.random_range(from..to)).collect()
        };
        let count = SIZE[0] * SIZE[1];
        let (depths, normals, alphas) =
            (numbers(count, 2.0, 2.4), numbers(3 * count, -1.0, 1.0), numbers(count, 0.0, 1.0));
        let tracked = device.clone().autodiff();
        let depth = picture(depths.clone(), 1, &tracked).require_grad();
        let shown = picture(normals.clone(), 3, &tracked).require_grad();
        let alpha = picture(alphas.clone(), 1, &tracked);
        let grads = rays.normal_consistency(shown.clone(), depth.clone(), alpha).backward();
        let of = |picture: &Tensor<3>| picture.grad(&grads).unwrap().into_data().iter::<f64>().collect::<Vec<f64>>();
        let (of_depth, of_normals) = (of(&depth), of(&shown));
        let value = |depths: Vec<f64>, normals: Vec<f64>| {
            let [depth, shown] = [(depths, 1), (normals, 3)].map(|(values, n)| picture(values, n, &device));
            rays.normal_consistency(shown, depth, picture(alphas.clone(), 1, &device)).into_scalar::<f64>()
        };
        for (found, which) in [(of_depth, 0), (of_normals, 1)] {
            let largest = found.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
            assert!(largest > 0.0);
            for (i, found) in found.iter().enumerate() {
                let at = |offset: f64| {
                    let mut moved = [depths.clone(), normals.clone()];
                    moved[which][i] += offset;
                    let [depths, normals] = moved;
                    value(depths, normals)
                };
                let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
                // The scale of the differences is a constant of the gradient: it changes the length alone, whose floor is 1e-3 of it.
                assert!((found - expected).abs() <= 1e-4 * largest, "{which}, {i}: {found}, {expected}");
            }
        }
    }
}

#[test]
fn discs_are_thin_and_needles_are_not() {
    let device = Device::flex().autodiff();
    let ratio = |scales: [f32; 3]| {
        let scales = Tensor::<2>::from_floats([scales], &device).require_grad();
        let loss = thickness(scales.clone());
        let grads = loss.clone().backward();
        let grad = values_of(scales.grad(&grads).unwrap());
        assert!(grad.iter().all(|value| value.is_finite()), "{grad:?}");
        loss.into_scalar::<f32>()
    };
    let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-5, "{found}, expected {expected}");
    near(ratio([2.0, 0.1, 1.0]), 0.1);
    near(ratio([0.01, 0.01, 5.0]), 1.0);
    near(ratio([3.0, 3.0, 3.0]), 1.0);
    near(ratio([1e-20, 1e10, 1e-3]), 0.0);
    assert_eq!(thickness(Tensor::<2>::zeros([0, 3], &device)).into_scalar::<f32>(), 0.0);
}
