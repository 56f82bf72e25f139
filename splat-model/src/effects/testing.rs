//! Helpers for tests of optics and motion: gradients by differences, and a small scene that is rendered stage by stage, in f64.

use burn::tensor::{DType, Device, Tensor, TensorData};
use splat_op::{Camera, Colour, Extras, Intrinsics, Projected, RenderOptions, Splats, intersect, project, rasterize};

/// `values` as a tensor on the CPU.
pub(super) fn tensor<const D: usize>(values: &[f64], shape: [usize; D]) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (&Device::flex(), DType::F64))
}

pub(super) fn host<const D: usize>(tensor: Tensor<D>) -> Vec<f64> {
    tensor.into_data().iter::<f64>().collect()
}

/// Compares the gradient of a weighted sum of `of(at)` with central differences, in f64.
#[track_caller]
pub(super) fn check_gradient(at: &[f64], of: impl Fn(Tensor<1>) -> Tensor<1>) {
    let sum = |values: Tensor<1>| {
        let out = of(values);
        let weights: Vec<f64> = (0..out.dims()[0]).map(|i| (1.7 * i as f64 + 0.3).sin()).collect();
        let weights = tensor(&weights, [weights.len()]);
        let weights = if out.is_autodiff() { Tensor::from_inner(weights) } else { weights };
        (out * weights).sum()
    };
    let variable = tensor(at, [at.len()]).autodiff().require_grad();
    let mut gradients = sum(variable.clone()).backward();
    let found = host(variable.grad_remove(&mut gradients).expect("the sum depends on its input"));
    let largest = found.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    assert!(largest > 0.0, "there is no gradient at all");
    for i in 0..at.len() {
        let step = 1e-5 * at[i].abs().max(1e-2);
        let moved = |by: f64| {
            let mut values = at.to_vec();
            values[i] += by;
            host(sum(tensor(&values, [values.len()])))[0]
        };
        let expected = (moved(step) - moved(-step)) / (2.0 * step);
        let tolerance = 1e-6 * expected.abs() + 1e-8 * largest;
        assert!((found[i] - expected).abs() <= tolerance, "input {i}: {} instead of {expected}", found[i]);
    }
}

/// The scene's camera, 48 × 36 px.
pub(super) fn camera() -> Intrinsics {
    Intrinsics::pinhole(48, 36, [40.0, 44.0], [23.0, 19.0])
}

/// `[3, 4]`: the scene's pose.
pub(super) fn pose() -> Tensor<2> {
    let (sin, cos) = 0.1_f64.sin_cos();
    tensor(&[cos, 0.0, sin, 0.1, 0.0, 1.0, 0.0, -0.05, -sin, 0.0, cos, 0.2], [3, 4])
}

/// Gaussians of a few px that hardly overlap, parallel to the image plane, and one behind the camera.
pub(super) fn scene() -> Splats {
    let means = [-0.9, -0.5, 2.6, 0.8, 0.6, 3.3, 0.1, -0.8, 3.9, -0.7, 0.9, 4.2, 1.0, -0.6, 3.0, 0.0, 0.0, -2.0];
    let scales = [0.25, 0.3, 0.05, 0.35, 0.25, 0.05, 0.4, 0.3, 0.05, 0.3, 0.45, 0.05, 0.25, 0.25, 0.05, 0.3, 0.3, 0.3];
    let turned = [1.0, 0.0, 0.0, 0.3];
    let count = 6;
    let features: Vec<f64> = (0..2 * count).map(|i| (4.3 * i as f64 + 0.4).cos()).collect();
    Splats {
        means: tensor(&means, [count, 3]),
        rotations: tensor(&turned.repeat(count), [count, 4]),
        scales: tensor(&scales, [count, 3]),
        opacities: tensor(&vec![0.3; count], [count]),
        colour: Colour::Features(tensor(&features, [count, 2])),
    }
}

/// `[H · W · 2]`: a render of the scene from a pose, with changed ellipses.
pub(super) fn render(camera: Intrinsics, pose: Tensor<2>, change: impl Fn(Projected) -> Projected) -> Vec<f64> {
    let (options, splats) = (RenderOptions::exact(), scene());
    let Colour::Features(features) = &splats.colour else { unreachable!("features, above") };
    let projected =
        project(&splats, &Camera { intrinsics: camera, cam_from_world: pose }, &Extras::default(), &options).unwrap();
    let projected = change(projected);
    let intersections = intersect(&projected, &options).unwrap();
    host(rasterize(&projected, features, &intersections, &Extras::default(), &options).unwrap().colour)
}

pub(super) fn average(pictures: &[Vec<f64>]) -> Vec<f64> {
    (0..pictures[0].len())
        .map(|i| pictures.iter().map(|picture| picture[i]).sum::<f64>() / pictures.len() as f64)
        .collect()
}

/// The largest difference between two renders.
pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}
