//! Compares the CPU operation with the exact renderer, with every numerical dial off.

use burn::tensor::{DType, Device};
use glam::{DMat3, DVec3};
use splat_op::exact::{ExactGaussian, ExactPose, render_exact};
use splat_op::{Extras, Intrinsics, Order, Projection, RenderOptions, evaluate_sh, render};
use splat_tests::compare::relative_error;
use splat_tests::cpu_devices;
use splat_tests::lenses::lenses;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host};

const CAMERA: Intrinsics = Intrinsics { fx: 33.0, fy: 37.0, cx: 19.0, cy: 14.5, ..Intrinsics::centred(41, 27, 33.0) };

/// Both sides compute in f64 with different formulas.
const TOLERANCE: f64 = 1e-10;

fn off() -> RenderOptions {
    let off = RenderOptions { alpha_min: 0.0, transmittance_min: 0.0, alpha_max: 1.0, ..RenderOptions::exact() };
    off.with_depth(true)
}

/// Asserts that the render of every CPU device equals the exact render.
fn check(what: &str, scene: &Scene, options: &RenderOptions, tolerance: f64) {
    let tensors = scene.tensors(&Device::flex(), DType::F64);
    let colours = host(evaluate_sh(&tensors.sh, &tensors.splats.means, &tensors.camera).expect("a valid scene"));
    let gaussians: Vec<ExactGaussian> = (0..scene.count()).map(|i| exact_gaussian(scene, &colours, i)).collect();
    let p = &scene.pose;
    let rows = [[p[0], p[1], p[2]], [p[4], p[5], p[6]], [p[8], p[9], p[10]]];
    let pose = ExactPose {
        rotation: DMat3::from_cols_array_2d(&rows).transpose(),
        translation: DVec3::new(p[3], p[7], p[11]),
    };
    let expected = render_exact(&gaussians, &pose, &scene.intrinsics, &scene.background, options);
    for (name, device) in cpu_devices() {
        let SceneTensors { splats, camera, background, .. } = scene.tensors(&device, DType::F64);
        let extras = Extras { background: Some(background), ..Extras::default() };
        let out = render(&splats, &[camera], &extras, options).expect("a valid scene");
        let colour: Vec<f64> = expected.iter().flat_map(|pixel| pixel.features.clone()).collect();
        let alpha: Vec<f64> = expected.iter().map(|pixel| pixel.alpha).collect();
        let depth: Vec<f64> = expected.iter().map(|pixel| pixel.depth).collect();
        let found = [host(out.colour), host(out.alpha), host(out.depth.expect("asked for"))];
        for (found, expected) in found.iter().zip([colour, alpha, depth]) {
            let error = relative_error(found, &expected);
            assert!(error <= tolerance, "{name}, {what}: {error:.3e}");
        }
    }
}

#[test]
fn the_cpu_operation_agrees_with_the_exact_renderer() {
    let cameras = [CAMERA].into_iter().chain(lenses(CAMERA));
    let cases = cameras.flat_map(|camera| [(camera, 1, false), (camera, 2, true)]);
    for (camera, seed, antialias) in cases {
        let mut scene = Scene::random(&mut Random::new(seed), 80, 1, camera);
        // One Gaussian behind the camera, one beyond the Jacobian's limits, and one far smaller than a pixel.
        scene.means[2] = -1.0;
        scene.means[3] = 9.0;
        scene.scales[6..9].fill(1e-4);
        let what = format!("{:?}, antialias {antialias}", camera.model);
        check(&what, &scene, &off().with_antialias(antialias), TOLERANCE);
    }
}

/// Gaussians as large as their distance, needles and sheets, some around the camera, inside and outside a wide view.
#[test]
fn rays_agree_with_the_exact_renderer() {
    let wide = Intrinsics { fx: 9.0, fy: 11.0, ..CAMERA };
    let choices = [
        (Projection::RayMax, Order::CentreDepth),
        (Projection::Affine, Order::PerPixelSort),
        (Projection::RayMax, Order::PerPixelSort),
    ];
    // The wide cameras include pixels that no ray of the lens reaches.
    let bent = lenses(CAMERA).into_iter().chain(lenses(wide));
    for (seed, camera) in (1..).zip([CAMERA, wide, CAMERA, wide].into_iter().chain(bent)) {
        let mut random = Random::new(seed);
        let mut scene = Scene::random(&mut random, 80, 1, camera);
        for (i, scale) in scene.scales.chunks_exact_mut(3).enumerate() {
            let size = [0.1, 0.5, 2.0, 6.0][i % 4];
            let thin = [1.0, 0.02][i / 4 % 2];
            scale.copy_from_slice(&[size, size * thin, size * random.between(thin, 1.0)]);
        }
        scene.means[2] = -1.0;
        scene.means[3] = 40.0;
        scene.scales[6..9].fill(1e-4);
        for (projection, order) in choices {
            let options = off().with_antialias(seed % 2 == 0).with_projection(projection).with_order(order);
            // The exact renderer inverts covariances, which costs digits for the flattest Gaussians.
            let what = format!("{:?}, {projection:?}, {order:?}, seed {seed}", camera.model);
            check(&what, &scene, &options, 1e-8);
        }
    }
}

fn exact_gaussian(scene: &Scene, colours: &[f64], i: usize) -> ExactGaussian {
    ExactGaussian {
        mean: DVec3::from_slice(&scene.means[3 * i..]),
        rotation: std::array::from_fn(|k| scene.quats[4 * i + k]),
        scale: DVec3::from_slice(&scene.scales[3 * i..]),
        opacity: scene.opacities[i],
        features: colours[3 * i..3 * i + 3].to_vec(),
    }
}
