//! Whole renders with per-ray rasterization: the guarantees of the ray-max projection.

use burn::tensor::{DType, Device};
use glam::DVec3;
use splat_op::{
    CameraModel, Extras, Intrinsics, Projection, RenderOptions, SplatError, colours, intersect, project, rasterize,
    render, render_view,
};
use splat_tests::lenses::lenses;
use splat_tests::perturb::judge;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host};
use splat_tests::tracked::{INPUTS, gradients_of};
use splat_tests::{cpu_devices, devices};

const CAMERA: Intrinsics = Intrinsics::pinhole(41, 27, [33.0, 37.0], [19.0, 14.5]);

fn picture(scene: &Scene, options: &RenderOptions) -> Vec<f64> {
    let SceneTensors { splats, camera, .. } = scene.tensors(&Device::flex(), DType::F64);
    host(render_view(&splats, &camera, &Extras::default(), options).expect("a valid scene").colour)
}

fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Returns the difference between the ray-max and the affine render of a scene whose lateral extent and Gaussians are scaled by
/// `size`, with the focal length divided by `size`: equally large in the picture, and smaller relative to the distance.
fn difference(size: f64) -> f64 {
    let camera = CAMERA.with_focal(CAMERA.fx / size, CAMERA.fy / size);
    let mut scene = Scene::random(&mut Random::new(5), 60, 0, camera);
    scene.scales.iter_mut().for_each(|scale| *scale *= size);
    scene.pose = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let options = RenderOptions::standard().with_alpha_min(0.0).with_transmittance_min(0.0);
    largest_difference(&picture(&scene, &options.with_projection(Projection::RayMax)), &picture(&scene, &options))
}

#[test]
fn small_gaussians_look_as_their_ellipses_do() {
    let by_size = [1.0, 0.1, 0.01].map(difference);
    println!("{by_size:?}");
    assert!(by_size[0] > 0.02, "{by_size:?}: a scene in which both renders are equal");
    // The first term that the affine projection omits is proportional to size / distance.
    assert!(by_size[1] < 0.2 * by_size[0] && by_size[2] < 0.2 * by_size[1], "{by_size:?}");
}

/// Compares tile lists with lists of every Gaussian in every tile (`alpha_min = 0`), where only the pixels apply the cut.
#[test]
fn tiles_lose_nothing() {
    let plain = Intrinsics::centred(200, 150, 90.0);
    for (seed, camera) in (1..).zip([plain].into_iter().chain(lenses(plain))) {
        let mut random = Random::new(seed);
        let mut scene = Scene::random(&mut random, 400, 0, camera);
        for (i, scale) in scene.scales.chunks_exact_mut(3).enumerate() {
            let size = [0.02, 0.15, 1.0, 4.0][i % 4];
            scale.copy_from_slice(&[size * random.between(0.1, 1.0), size * random.between(0.02, 1.0), size]);
        }
        let options = RenderOptions::standard().with_transmittance_min(0.0);
        let options = options.with_projection(Projection::RayMax).with_depth(true);
        let SceneTensors { splats, camera, .. } = scene.tensors(&Device::flex(), DType::F32);
        let projected = project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
        let features = colours(&splats, &camera).expect("a valid scene");
        let picture = |listed: &RenderOptions| {
            let intersections = intersect(&projected, listed).expect("a valid scene");
            let pairs: i64 = intersections.counts.clone().into_data().iter::<i64>().sum();
            let picture =
                rasterize(&projected, &features, &intersections, &Extras::default(), &options).expect("a valid scene");
            (pairs, [host(picture.colour), host(picture.alpha), host(picture.depth.expect("asked for"))])
        };
        let (listed, found) = picture(&options);
        let (all, expected) = picture(&options.with_alpha_min(0.0));
        let model = projected.intrinsics().model;
        assert!(listed < all, "{model:?}: {listed} of {all} pairs are listed");
        assert!(found == expected, "{model:?}: the lists change the picture");
    }
}

/// A Gaussian far outside the picture and close to the camera, which the affine projection smears over the picture.
#[test]
fn a_wide_angle_shows_what_is_there() {
    let camera = Intrinsics::centred(64, 48, 20.0);
    let mut scene = Scene::random(&mut Random::new(1), 1, 0, camera);
    scene.pose = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    scene.means = vec![2.4, 0.0, 1.5];
    scene.scales = vec![0.3; 3];
    scene.quats = vec![1.0, 0.0, 0.0, 0.0];
    scene.opacities = vec![1.0];
    let alpha = |projection: Projection| {
        let SceneTensors { splats, camera, .. } = scene.tensors(&Device::flex(), DType::F64);
        let options = RenderOptions::standard().with_alpha_min(0.0).with_blur(0.0);
        let options = options.with_projection(projection);
        host(render_view(&splats, &camera, &Extras::default(), &options).expect("a valid scene").alpha)
    };
    let (exact, affine) = (alpha(Projection::RayMax), alpha(Projection::Affine));
    // A ball with σ = 0.3: the largest value along a ray follows from the ray's distance from the centre.
    let centre = DVec3::new(2.4, 0.0, 1.5);
    let expected: Vec<f64> = (0..48 * 64)
        .map(|pixel| {
            let ray = DVec3::new(f64::from(pixel % 64) - 31.5, f64::from(pixel / 64) - 23.5, 20.0).normalize();
            let distance = (centre - ray.dot(centre) * ray).length();
            if ray.dot(centre) > 0.0 { (-0.5 * (distance / 0.3).powi(2)).exp().min(0.99) } else { 0.0 }
        })
        .collect();
    assert!(largest_difference(&exact, &expected) < 1e-12);
    assert!(largest_difference(&affine, &expected) > 0.05, "a scene that shows no difference");
}

#[test]
fn every_gradient_reaches_its_input() {
    for (name, device) in cpu_devices() {
        let scene = Scene::random(&mut Random::new(8), 40, 1, CAMERA);
        let SceneTensors { splats, sh, camera, background } = scene.tensors(&device.autodiff(), DType::F64);
        let extras = Extras::default().with_background(background.clone());
        let options = RenderOptions::standard().with_projection(Projection::RayMax);
        let out = render(&splats, std::slice::from_ref(&camera), &extras, &options).expect("a valid scene");
        // The loss uses the picture alone, so that alpha and depth have no gradient.
        let gradients = (out.colour.clone() * out.colour).sum().backward();
        let found = [
            host(splats.means.grad(&gradients).expect("tracked")),
            host(splats.rotations.grad(&gradients).expect("tracked")),
            host(splats.scales.grad(&gradients).expect("tracked")),
            host(splats.opacities.grad(&gradients).expect("tracked")),
            host(sh.grad(&gradients).expect("tracked")),
            host(camera.cam_from_world.grad(&gradients).expect("tracked")),
            host(background.grad(&gradients).expect("tracked")),
        ];
        assert!(found.iter().all(|g| g.iter().any(|v| *v != 0.0) && g.iter().all(|v| v.is_finite())), "{name}");
    }
}

/// All gradients of renders by two cameras, in f32 on every device.
#[test]
fn gradients_in_f32_are_those_in_f64() {
    let smooth = RenderOptions::standard().with_alpha_min(0.0).with_transmittance_min(0.0);
    let mut scene = Scene::random(&mut Random::new(11), 120, 1, CAMERA);
    scene.scales.iter_mut().for_each(|scale| *scale *= 0.4);
    let options = smooth.with_projection(Projection::RayMax).with_depth(true).with_antialias(true);
    for (name, device) in devices() {
        for camera in [CAMERA].into_iter().chain(lenses(CAMERA)) {
            let scene = &Scene { intrinsics: camera, ..scene.clone() };
            // Alpha and depth are part of the loss, and every probe is tracked.
            judge(&format!("{name}, {:?}", camera.model), scene, &device, |scene, place| {
                let gradients = gradients_of(scene, 2, [true; 9], &options, place);
                let named = INPUTS.into_iter().zip(gradients);
                named.map(|(name, gradient)| (name, gradient.expect("tracked"))).collect()
            });
        }
    }
}

/// Compares the gradient with the slope of the loss along a line through all geometry and the pose.
fn check_slope(camera: Intrinsics) {
    let options = RenderOptions::standard().with_alpha_min(0.0).with_transmittance_min(0.0).with_alpha_max(1.0);
    let options = options.with_projection(Projection::RayMax).with_depth(true).with_antialias(true);
    let scene = Scene::random(&mut Random::new(9), 30, 0, camera);
    let mut random = Random::new(10);
    let parts = [&scene.means, &scene.quats, &scene.scales, &scene.opacities, &scene.pose];
    let directions = parts.map(|part| random.fill(part.len(), -1.0, 1.0));
    let weights = random.fill(5 * CAMERA.width * CAMERA.height, -1.0, 1.0);
    let moved = |by: f64| {
        let mut scene = scene.clone();
        let parts = [&mut scene.means, &mut scene.quats, &mut scene.scales, &mut scene.opacities, &mut scene.pose];
        for (part, direction) in parts.into_iter().zip(&directions) {
            part.iter_mut().zip(direction).for_each(|(value, d)| *value += by * d);
        }
        scene
    };
    let loss = |tensors: &SceneTensors| {
        let picture = render_view(&tensors.splats, &tensors.camera, &Extras::default(), &options).expect("valid");
        let planes =
            [picture.colour, picture.alpha, picture.depth.expect("asked for")].map(|plane| plane.reshape([-1]));
        let planes = burn::tensor::Tensor::<1>::cat(planes.to_vec(), 0);
        let weights = splat_tests::scene::tensor(&weights, [weights.len()], &planes.device(), DType::F64);
        (planes * weights).sum()
    };
    let value = |by: f64| host(loss(&moved(by).tensors(&Device::flex(), DType::F64)))[0];
    let step = 1e-4;
    let slope = (8.0 * (value(step) - value(-step)) - (value(2.0 * step) - value(-2.0 * step))) / (12.0 * step);
    let tensors = scene.tensors(&Device::flex().autodiff(), DType::F64);
    let gradients = loss(&tensors).backward();
    let found = [
        host(tensors.splats.means.grad(&gradients).expect("tracked")),
        host(tensors.splats.rotations.grad(&gradients).expect("tracked")),
        host(tensors.splats.scales.grad(&gradients).expect("tracked")),
        host(tensors.splats.opacities.grad(&gradients).expect("tracked")),
        host(tensors.camera.cam_from_world.grad(&gradients).expect("tracked")),
    ];
    let along: f64 = found.iter().flatten().zip(directions.iter().flatten()).map(|(g, d)| g * d).sum();
    assert!((along - slope).abs() <= 1e-6 * slope.abs(), "{camera:?}: gradient {along}, slope {slope}");
}

#[test]
fn the_slope_of_a_render_is_that_of_its_gradient() {
    [CAMERA].into_iter().chain(lenses(CAMERA)).for_each(check_slope);
}

/// A lens without distortion is a pinhole under another name.
#[test]
fn a_lens_without_distortion_shows_what_a_pinhole_shows() {
    let smooth = RenderOptions::standard().with_alpha_min(0.0).with_transmittance_min(0.0);
    let options = smooth.with_projection(Projection::RayMax);
    let scene = Scene::random(&mut Random::new(1), 60, 0, CAMERA);
    let mut bent = scene.clone();
    bent.intrinsics.model = CameraModel::OpenCv;
    let difference = largest_difference(&picture(&scene, &options), &picture(&bent, &options));
    assert!(difference < 1e-11, "{difference}");
}

#[test]
fn what_cannot_be_is_refused() {
    let scene = Scene::random(&mut Random::new(1), 5, 0, CAMERA);
    let SceneTensors { splats, camera, .. } = scene.tensors(&Device::flex(), DType::F32);
    let plain = RenderOptions::standard();
    let options = plain.with_projection(Projection::RayMax);
    let projected = project(&splats, &camera, &Extras::default(), &options).expect("a valid scene");
    let refused = |result: Result<splat_op::Intersections, SplatError>, part: &str| {
        let message = result.expect_err("refused").to_string();
        assert!(message.contains("`projection`") && message.contains(part), "{message}");
    };
    refused(intersect(&projected, &plain), "projected with");
    let packed = projected.ellipses().pack(&CAMERA).expect("columns of one render");
    refused(intersect(&packed, &options), "packed");
    let intersections = intersect(&packed, &plain).expect("ellipses as they are");
    let features = colours(&splats, &camera).expect("a valid scene");
    let refused =
        rasterize(&packed, &features, &intersections, &Extras::default(), &options).expect_err("no depth slope");
    assert!(refused.to_string().contains("packed"), "{refused}");
}
