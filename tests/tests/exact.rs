//! Compares the CPU operation with the exact renderer, with every numerical dial off.

use burn::tensor::{DType, Device};
use glam::{DMat3, DVec3};
use splat_hard_cases::exact::{ExactGaussian, ExactPose, ExactView, render_exact};
use splat_op::{Extras, Intrinsics, Projection, RenderOptions, evaluate_sh, render};
use splat_tests::compare::relative_error;
use splat_tests::cpu_devices;
use splat_tests::lenses::lenses;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host};

const CAMERA: Intrinsics = Intrinsics::pinhole(41, 27, [33.0, 37.0], [19.0, 14.5]);

/// Both sides compute in f64 with different formulas.
const TOLERANCE: f64 = 1e-10;

fn off() -> RenderOptions {
    let off = RenderOptions::exact().with_alpha_min(0.0).with_transmittance_min(0.0).with_alpha_max(1.0);
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
        let extras = Extras::default().with_background(background);
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
    let wide = CAMERA.with_focal(9.0, 11.0);
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
        let options = off().with_antialias(seed % 2 == 0).with_projection(Projection::RayMax);
        // The exact renderer inverts covariances, which costs digits for the flattest Gaussians.
        check(&format!("{:?}, seed {seed}", camera.model), &scene, &options, 1e-8);
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

/// Pictures of two crossing sheets while the camera turns around the line where they cross, by an order of each pixel's own or of
/// the centres. Returns the largest change of a pixel in one small step.
fn largest_step(options: &RenderOptions, by_pixel: bool) -> f64 {
    let sheet = |x: f64, lean: f64, features: [f64; 3]| ExactGaussian {
        mean: DVec3::new(x, 0.0, 3.0),
        rotation: [lean.cos(), 0.0, lean.sin(), 0.0],
        scale: DVec3::new(0.8, 0.8, 0.05),
        opacity: 0.9,
        features: features.to_vec(),
    };
    let sheets = [sheet(0.3, 0.35, [0.9, 0.1, 0.5]), sheet(-0.3, -0.35, [0.1, 0.9, 0.5])];
    let camera = Intrinsics::centred(32, 32, 40.0);
    let picture = |step: i32| {
        let turned = DMat3::from_rotation_y(1e-3 * (f64::from(step) + 0.5));
        let middle = DVec3::new(0.0, 0.0, 3.0);
        let pose = ExactPose { rotation: turned, translation: middle - turned * middle };
        let view = ExactView::new(&sheets, &pose, &camera, options);
        let view = if by_pixel { view.sorted_per_pixel() } else { view };
        let pixels = (0..32).flat_map(|y| (0..32).map(move |x| [x, y]));
        pixels.flat_map(|pixel| view.pixel(pixel, &[0.0; 3]).features).collect::<Vec<f64>>()
    };
    let pictures: Vec<Vec<f64>> = (-20..20).map(picture).collect();
    let steps = pictures.windows(2).flat_map(|pair| pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()));
    steps.fold(0.0, f64::max)
}

#[test]
fn an_order_of_each_pixels_own_does_not_pop() {
    for projection in [Projection::Affine, Projection::RayMax] {
        let options = off().with_projection(projection);
        let (by_centres, by_pixel) = (largest_step(&options, false), largest_step(&options, true));
        assert!(by_centres > 0.2, "{projection:?}, by centres: {by_centres}");
        assert!(by_pixel < 0.05, "{projection:?}, by pixel: {by_pixel}");
    }
}

/// The maximum of a ball along a ray is the point of the ray next to its centre.
#[test]
fn the_order_of_a_pixel_is_that_of_the_maxima_along_its_ray() {
    let camera = Intrinsics::centred(64, 48, 20.0);
    let ball = |mean: DVec3, features: [f64; 2]| ExactGaussian {
        mean,
        rotation: [1.0, 0.0, 0.0, 0.0],
        scale: DVec3::splat(0.5),
        opacity: 0.8,
        features: features.to_vec(),
    };
    let balls = [ball(DVec3::new(-0.2, 0.0, 2.0), [1.0, 0.0]), ball(DVec3::new(1.6, 0.0, 1.9), [0.0, 1.0])];
    let pose = ExactPose { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    let options = off().with_blur(0.0).with_projection(Projection::RayMax);
    let (by_centres, by_pixel) = (
        ExactView::new(&balls, &pose, &camera, &options),
        ExactView::new(&balls, &pose, &camera, &options).sorted_per_pixel(),
    );
    let mut swapped = 0;
    for x in 0..64 {
        let ray = DVec3::new((x as f64 + 0.5 - camera.cx) / camera.fx, (24.5 - camera.cy) / camera.fy, 1.0);
        let met = |ball: &ExactGaussian| {
            let at = ray.dot(ball.mean) / ray.length_squared();
            let alpha = ball.opacity * (-0.5 * (at * ray - ball.mean).length_squared() / 0.25).exp();
            (at, if at > 0.0 { alpha } else { 0.0 })
        };
        let [(first, a), (second, b)] = [met(&balls[0]), met(&balls[1])];
        let expected = if first <= second { [a, (1.0 - a) * b] } else { [(1.0 - b) * a, b] };
        let found = by_pixel.pixel([x, 24], &[0.0; 2]).features;
        assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-12), "column {x}: {found:?}, {expected:?}");
        let other = by_centres.pixel([x, 24], &[0.0; 2]).features;
        swapped += usize::from((0..2).any(|k| (found[k] - other[k]).abs() > 1e-3));
    }
    assert!((5..59).contains(&swapped), "the orders differ in {swapped} of 64 columns");
}
