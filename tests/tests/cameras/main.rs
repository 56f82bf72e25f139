//! Cameras with parallel rays, cameras that see all directions, and covariances in place of rotations and scales, against the exact
//! renderer, differences and each other.

mod covariances;
mod gradients;
mod orthographic;
mod panoramas;

use burn::tensor::{DType, Device, Tensor};
use glam::{DAffine3, DQuat, DVec3};
use splat_hard_cases::exact::{ExactGaussian, ExactPixel, ExactPose};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Rendered, Splats};
use splat_tests::random::Random;
use splat_tests::scene::{host, tensor};
use splat_tests::{cpu_devices, gpu};

/// No cuts, so that renders are continuous.
const SMOOTH: RenderOptions = RenderOptions::exact().with_alpha_min(0.0).with_depth(true);

fn f64s() -> (Device, DType) {
    (Device::flex(), DType::F64)
}

/// Every device with its float types: both on the CPU, f32 on the GPU.
fn everywhere() -> Vec<(Device, DType)> {
    let cpus = cpu_devices().into_iter().flat_map(|(_, device)| [DType::F32, DType::F64].map(|t| (device.clone(), t)));
    cpus.chain(gpu().map(|device| (device, DType::F32))).collect()
}

fn turned() -> DAffine3 {
    let rotation = DQuat::from_xyzw(0.2, -0.15, 0.1, 0.9).normalize();
    DAffine3::from_rotation_translation(rotation, DVec3::new(0.2, -0.1, 0.3))
}

fn pose_of(pose: &DAffine3) -> ExactPose {
    ExactPose { rotation: pose.matrix3, translation: pose.translation }
}

fn pose_rows(pose: &DAffine3) -> Vec<f64> {
    let (m, t) = (pose.matrix3, pose.translation);
    (0..3).flat_map(|i| [m.x_axis[i], m.y_axis[i], m.z_axis[i], t[i]]).collect()
}

/// Gaussians whose centres are given, of `size` times their distance from the origin, with two features.
fn gaussians(random: &mut Random, centres: &[DVec3], size: f64) -> Vec<ExactGaussian> {
    let mut of = |low: f64, high: f64| f64::from(random.between(low, high) as f32);
    let centres = centres.iter().map(|centre| centre.as_vec3().as_dvec3());
    let gaussian = |mean: DVec3| ExactGaussian {
        mean,
        rotation: [of(-1.0, 1.0), of(-1.0, 1.0), of(-1.0, 1.0), of(0.1, 1.0)],
        scale: DVec3::new(of(0.6, 1.0), of(0.6, 1.0), of(0.6, 1.0)) * f64::from((size * mean.length()) as f32),
        opacity: of(0.3, 0.9),
        features: vec![of(0.0, 1.0), of(0.0, 1.0)],
    };
    centres.map(gaussian).collect()
}

fn splats(of: &[ExactGaussian], (device, dtype): &(Device, DType)) -> Splats {
    let flat = |each: &dyn Fn(&ExactGaussian) -> Vec<f64>| of.iter().flat_map(each).collect::<Vec<f64>>();
    let n = of.len();
    Splats {
        means: tensor(&flat(&|g| g.mean.to_array().to_vec()), [n, 3], device, *dtype),
        rotations: tensor(&flat(&|g| g.rotation.to_vec()), [n, 4], device, *dtype),
        scales: tensor(&flat(&|g| g.scale.to_array().to_vec()), [n, 3], device, *dtype),
        opacities: tensor(&flat(&|g| vec![g.opacity]), [n], device, *dtype),
        colour: Colour::Features(tensor(&flat(&|g| g.features.clone()), [n, 2], device, *dtype)),
    }
}

fn pose_on(pose: &DAffine3, (device, dtype): &(Device, DType)) -> Tensor<2> {
    tensor(&pose_rows(pose), [3, 4], device, *dtype)
}

fn camera(intrinsics: Intrinsics, pose: &DAffine3, at: &(Device, DType)) -> Camera {
    Camera { intrinsics, cam_from_world: pose_on(pose, at) }
}

/// Channels of a picture, then alpha and depth, pixel by pixel.
fn pixels(of: Rendered<3>) -> Vec<f64> {
    host(Tensor::cat(vec![of.colour, of.alpha, of.depth.expect("asked for")], 2))
}

fn flat(pixel: &ExactPixel, length: f64) -> [f64; 4] {
    [pixel.features[0], pixel.features[1], pixel.alpha, pixel.depth * length]
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    // `max` drops NaN.
    assert!(a.iter().chain(b).all(|value| value.is_finite()));
    a.iter().zip(b).fold(0.0, |most, (a, b)| most.max((a - b).abs()))
}

/// Centres that the camera of [`turned`] sees.
fn before_a_wall(random: &mut Random, count: usize) -> Vec<DVec3> {
    let pose = turned().inverse();
    let mut of = |low: f64, high: f64| random.between(low, high);
    (0..count).map(|_| pose.transform_point3(DVec3::new(of(-3.0, 3.0), of(-2.0, 2.0), of(0.5, 9.0)))).collect()
}
