//! Covariances in place of rotations and scales.

use glam::DMat3;
use splat_op::{CameraModel, Projection, SplatError, project, render_view};

use super::*;

fn pinhole() -> Intrinsics {
    Intrinsics::centred(48, 32, 24.0)
}

fn scene(count: usize) -> Vec<ExactGaussian> {
    let mut random = Random::new(20);
    let centres = before_a_wall(&mut random, count);
    gaussians(&mut random, &centres, 0.1)
}

/// Covariances, row by row.
fn covariances(of: &[ExactGaussian]) -> Vec<f64> {
    let covariance = |gaussian: &ExactGaussian| {
        let [w, x, y, z] = gaussian.rotation;
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()) * DMat3::from_diagonal(gaussian.scale);
        (axes * axes.transpose()).to_cols_array()
    };
    of.iter().flat_map(covariance).collect()
}

/// Extras with covariances, and Gaussians without rotations and scales.
fn by_covariances(of: &[ExactGaussian], values: &[f64], at: &(Device, DType)) -> (Splats, Extras) {
    let given = splats(of, at);
    let (rotations, scales) = (given.rotations.zeros_like(), given.scales.zeros_like());
    let covariances = tensor(values, [of.len(), 3, 3], &at.0, at.1);
    let extras = Extras::default().with_covariances(covariances);
    (Splats { rotations, scales, ..given }, extras)
}

#[test]
fn they_stand_for_rotations_and_scales() {
    let (of, pose) = (scene(60), turned());
    let models = [CameraModel::Pinhole, CameraModel::Fisheye, CameraModel::OpenCv, CameraModel::Orthographic];
    for (model, antialias) in models.into_iter().zip([false, true, false, true]) {
        let mut intrinsics = pinhole();
        intrinsics.model = model;
        let options = RenderOptions::exact().with_depth(true).with_antialias(antialias);
        for at in everywhere() {
            let view = camera(intrinsics, &pose, &at);
            let (given, extras) = by_covariances(&of, &covariances(&of), &at);
            let found = pixels(render_view(&given, &view, &extras, &options).expect("valid"));
            let expected = render_view(&splats(&of, &at), &view, &Extras::default(), &options).expect("valid");
            let expected = pixels(expected);
            assert!(expected.iter().filter(|value| **value > 0.3).count() > 1000);
            let error = largest(&found, &expected);
            assert!(error < if at.1 == DType::F64 { 1e-10 } else { 2e-4 }, "{at:?}, {model:?}: {error}");
        }
    }
}

/// Covariances, centres and pose, and the gradients of a loss with respect to them.
type Values = [Vec<f64>; 3];

fn values(of: &[ExactGaussian]) -> Values {
    let means = of.iter().flat_map(|gaussian| gaussian.mean.to_array()).collect();
    [covariances(of), means, pose_rows(&turned())]
}

/// A loss of the picture, and its gradients if the device records them.
fn loss(of: &[ExactGaussian], values: &Values, model: CameraModel, at: &(Device, DType)) -> (f64, Option<Values>) {
    let tracked = at.0.is_autodiff();
    let count = of.len();
    let leaf = |i: usize, columns: usize| -> Tensor<2> {
        let leaf: Tensor<2> = tensor(&values[i], [values[i].len() / columns, columns], &at.0, at.1);
        if tracked { leaf.require_grad() } else { leaf }
    };
    let [covariances, means, pose] = [leaf(0, 9), leaf(1, 3), leaf(2, 4)];
    let extras = Extras::default().with_covariances(covariances.clone().reshape([count, 3, 3]));
    let given = Splats { means: means.clone(), ..splats(of, at) };
    let mut intrinsics = pinhole();
    intrinsics.model = model;
    let view = Camera { intrinsics, cam_from_world: pose.clone() };
    let colour = render_view(&given, &view, &extras, &SMOOTH.with_antialias(true)).expect("valid").colour;
    let weights: Tensor<3> = tensor(&Random::new(5).fill(48 * 32 * 2, -1.0, 1.0), [32, 48, 2], &at.0, at.1);
    let loss = (colour * weights).sum();
    let gradients = tracked.then(|| {
        let gradients = loss.backward();
        [covariances, means, pose].map(|leaf| host(leaf.grad(&gradients).expect("tracked")))
    });
    (host(loss)[0], gradients)
}

fn gradients(of: &[ExactGaussian], values: &Values, model: CameraModel, (device, dtype): &(Device, DType)) -> Values {
    loss(of, values, model, &(device.clone().autodiff(), *dtype)).1.expect("tracked")
}

#[test]
fn their_gradients_agree_with_differences() {
    let of = scene(8);
    let values = values(&of);
    for model in [CameraModel::Pinhole, CameraModel::Fisheye, CameraModel::Orthographic] {
        let expected = gradients(&of, &values, model, &f64s());
        for (input, found) in expected.iter().enumerate() {
            let most = found.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            assert!(most > 1e-2, "input {input} has no gradient");
            for (i, found) in found.iter().enumerate() {
                let step = 1e-4 * if input == 0 { values[0][9 * (i / 9)] } else { values[input][i].abs().max(0.1) };
                let at = |steps: f64| {
                    let mut moved = values.clone();
                    moved[input][i] += steps * step;
                    loss(&of, &moved, model, &f64s()).0
                };
                let expected = (8.0 * (at(1.0) - at(-1.0)) - (at(2.0) - at(-2.0))) / (12.0 * step);
                let what = format!("{model:?}, input {input}, {i}: {found} instead of {expected}");
                assert!((found - expected).abs() <= 2e-6 * most, "{what}");
                // Only lower triangles are read.
                assert!(input > 0 || ![1, 2, 5].contains(&(i % 9)) || *found == 0.0, "{what}");
            }
        }
        for at in everywhere() {
            for (found, expected) in gradients(&of, &values, model, &at).iter().zip(&expected) {
                let most = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
                let error = largest(found, expected) / most;
                assert!(error < if at.1 == DType::F64 { 1e-10 } else { 1e-3 }, "{model:?}, {at:?}: {error}");
            }
        }
    }
}

/// Zero, of ranks one and two, indefinite with a positive diagonal, negative, and not finite.
#[test]
fn those_that_are_not_positive_definite_are_culled() {
    const SQUARE: f64 = 0.0625;
    let outer = |v: [f64; 3]| v.map(|a| v.map(|b| SQUARE * a * b)).concat();
    let bad: [Vec<f64>; 7] = [
        vec![0.0; 9],
        outer([1.0, 2.0, -0.5]),
        outer([1.0, 0.0, 0.0]).iter().zip(outer([0.0, 1.0, 1.0])).map(|(a, b)| a + b).collect(),
        vec![1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        vec![-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        vec![1.0, 0.0, 0.0, f64::NAN, 1.0, 0.0, 0.0, 0.0, 1.0],
        vec![1.0, 0.0, 0.0, 0.0, f64::INFINITY, 0.0, 0.0, 0.0, 1.0],
    ];
    let of = scene(12);
    let mut values = values(&of);
    values[0][..63].copy_from_slice(&bad.concat());
    for at in everywhere() {
        let (given, extras) = by_covariances(&of, &values[0], &at);
        let projected = project(&given, &camera(pinhole(), &turned(), &at), &extras, &SMOOTH).expect("valid");
        let drawn: Vec<bool> = projected.visible().into_data().iter::<bool>().collect();
        assert_eq!(drawn, (0..12).map(|i| i >= 7).collect::<Vec<_>>(), "{at:?}");
        let [covariances, means, pose] = gradients(&of, &values, CameraModel::Pinhole, &at);
        assert!(covariances[..63].iter().chain(&means[..21]).all(|value| *value == 0.0), "{at:?}: {covariances:?}");
        assert!(covariances.iter().chain(&means).chain(&pose).all(|value| value.is_finite()), "{at:?}");
        assert!(covariances[63..].chunks_exact(9).all(|row| row[0] != 0.0), "{at:?}");
    }
}

/// In f32 a covariance holds axes whose lengths differ by a factor of a few hundred.
#[test]
fn thin_ones_are_drawn() {
    let mut of = scene(40);
    of.iter_mut().for_each(|gaussian| gaussian.scale.y *= 3e-3);
    for at in everywhere() {
        let view = camera(pinhole(), &turned(), &at);
        let (given, extras) = by_covariances(&of, &covariances(&of), &at);
        let found = pixels(render_view(&given, &view, &extras, &SMOOTH).expect("valid"));
        let expected = pixels(render_view(&splats(&of, &at), &view, &Extras::default(), &SMOOTH).expect("valid"));
        let error = largest(&found, &expected);
        assert!(error < if at.1 == DType::F64 { 1e-8 } else { 1e-2 }, "{at:?}: {error}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let (of, at) = (scene(3), f64s());
    let view = camera(pinhole(), &turned(), &at);
    let (given, extras) = by_covariances(&of, &covariances(&of), &at);
    let rays = SMOOTH.with_projection(Projection::RayMax);
    let refused = render_view(&given, &view, &extras, &rays).expect_err("rays");
    assert!(matches!(refused, SplatError::Value { field: "projection", .. }), "{refused}");
    let short = Extras::default().with_covariances(extras.covariances.map(|all| all.narrow(0, 0, 2)));
    let refused = render_view(&given, &view, &short, &SMOOTH).expect_err("two for three");
    assert!(matches!(refused, SplatError::Shape { name: "covariances", .. }), "{refused}");
}
