//! Tests of the GPU path alone: whole renders at the limits of the kernels, rejected arguments, buffer limits.

use burn::tensor::{DType, Device, Tensor, TensorData};
use splat_model::optim::{Adam, Moments, Rates};
use splat_op::{
    Accumulation, Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, in_tensor_code, intersect,
    project, render, test_hooks,
};
use splat_tests::data::announce;
use splat_tests::gpu;
use splat_tests::lenses::lenses;
use splat_tests::perturb::judge;
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host, tensor};
use splat_tests::tracked::{INPUTS, gradients_of};

const CAMERA: Intrinsics = Intrinsics::pinhole(75, 50, [61.0, 64.0], [36.0, 26.5]);

/// Options without cuts, at which a pair within rounding error would jump.
const SMOOTH: RenderOptions =
    RenderOptions::standard().with_depth(true).with_alpha_min(0.0).with_transmittance_min(0.0);

type Where = (Device, DType);

/// Computes [`gradients_of`], by name.
fn named_gradients(
    scene: &Scene,
    cameras: usize,
    tracked: [bool; 9],
    options: &RenderOptions,
    place: &Where,
) -> Vec<(&'static str, Vec<f64>)> {
    let gradients = gradients_of(scene, cameras, tracked, options, place);
    let named = INPUTS.into_iter().zip(gradients).zip(tracked);
    named
        .filter_map(|((name, gradient), tracked)| {
            assert_eq!(gradient.is_some(), tracked, "{name} on {:?}", place.0);
            gradient.map(|gradient| (name, gradient))
        })
        .collect()
}

#[test]
fn all_gradients_of_a_render_by_several_cameras() {
    let Some(device) = gpu() else { return };
    for (seed, antialias) in [(1, false), (2, true)] {
        let mut scene = Scene::random(&mut Random::new(seed), 300, 3, CAMERA);
        scene.scales.iter_mut().for_each(|scale| *scale *= 0.4);
        for accumulation in [Accumulation::Atomic, Accumulation::Ordered] {
            let options = SMOOTH.with_antialias(antialias).with_accumulation(accumulation);
            judge(&format!("seed {seed}, {accumulation:?}"), &scene, &device, |scene, place| {
                named_gradients(scene, 3, [true; 9], &options, place)
            });
        }
    }
}

#[test]
fn all_gradients_through_every_lens() {
    let Some(device) = gpu() else { return };
    for (i, camera) in lenses(CAMERA).into_iter().enumerate() {
        let mut scene = Scene::random(&mut Random::new(40 + i as u64), 200, 2, camera);
        scene.scales.iter_mut().for_each(|scale| *scale *= 0.4);
        let options = SMOOTH.with_antialias(i % 2 == 0);
        // With a tracked pose the stages run one by one; without it, one kernel computes `project` and `evaluate_sh`.
        for pose in [true, false] {
            let tracked = std::array::from_fn(|input| pose || INPUTS[input] != "pose");
            judge(&format!("{:?}, pose {pose}", camera.model), &scene, &device, |scene, place| {
                named_gradients(scene, 1, tracked, &options, place)
            });
        }
    }
}

/// Tracks each input alone, and all inputs but one, because kernels are compiled without the gradients that are not requested.
#[test]
fn gradients_do_not_depend_on_what_else_is_tracked() {
    let Some(device) = gpu() else { return };
    let mut scene = Scene::random(&mut Random::new(3), 80, 2, CAMERA);
    scene.scales.iter_mut().for_each(|scale| *scale *= 0.5);
    for accumulation in [Accumulation::Atomic, Accumulation::Ordered] {
        let options = SMOOTH.with_accumulation(accumulation);
        for one in 0..INPUTS.len() {
            for alone in [true, false] {
                let tracked = std::array::from_fn(|i| (i == one) == alone);
                let what = format!("{accumulation:?}, {} {}", if alone { "only" } else { "all but" }, INPUTS[one]);
                judge(&what, &scene, &device, |scene, place| named_gradients(scene, 1, tracked, &options, place));
            }
        }
    }
}

/// Renders features and returns `colour alpha` and the gradients of `means features background`.
fn features_of(scene: &Scene, channels: usize, (device, dtype): &Where) -> Vec<(&'static str, Vec<f64>)> {
    let device = device.clone().autodiff();
    let plain = Scene { sh: vec![0.0; 3 * scene.count()], ..scene.clone() };
    let SceneTensors { mut splats, camera, background, .. } = plain.tensors(&device, *dtype);
    let features: Tensor<2> = tensor(&scene.sh, [scene.count(), channels], &device, *dtype).require_grad();
    splats.colour = Colour::Features(features.clone());
    let extras = Extras::default().with_background(background.clone());
    let out = render(&splats, &[camera], &extras, &SMOOTH).expect("a valid scene");
    let shape = out.colour.dims();
    let weights = Random::new(9).fill(shape.iter().product(), -1.0, 1.0);
    let weights: Vec<f64> = weights.into_iter().map(|weight| f64::from(weight as f32)).collect();
    let grads = (out.colour.clone() * tensor(&weights, shape, &device, *dtype)).sum().backward();
    vec![
        ("colour", host(out.colour)),
        ("alpha", host(out.alpha)),
        ("gradient of means", host(splats.means.grad(&grads).expect("tracked"))),
        ("gradient of features", host(features.grad(&grads).expect("tracked"))),
        ("gradient of background", host(background.grad(&grads).expect("tracked"))),
    ]
}

#[test]
fn any_number_of_channels() {
    let Some(device) = gpu() else { return };
    for channels in [1, 3, 16, 64] {
        let mut random = Random::new(channels as u64);
        let mut scene = Scene::random(&mut random, 60, 0, CAMERA);
        scene.sh = random.fill(60 * channels, -1.0, 1.0);
        scene.background = random.fill(channels, -1.0, 1.0);
        let what = format!("{channels} channels");
        judge(&what, &scene, &device, |scene, place| features_of(scene, channels, place));
    }
}

#[test]
fn a_picture_over_4096_px_wide_or_high() {
    let Some(device) = gpu() else { return };
    for (width, height) in [(5000, 40), (40, 5000)] {
        let camera = Intrinsics::centred(width, height, 3000.0);
        let mut random = Random::new(6);
        let mut scene = Scene::random(&mut random, 60, 1, camera);
        for mean in scene.means.chunks_exact_mut(3) {
            mean[0] = random.between(-0.5, 0.5) * width as f64 / camera.fx * mean[2];
            mean[1] = random.between(-0.5, 0.5) * height as f64 / camera.fy * mean[2];
        }
        judge(&format!("{width} × {height} px"), &scene, &device, |scene, place| {
            named_gradients(scene, 1, [true; 9], &SMOOTH, place)
        });
    }
}

#[test]
fn no_splats_and_none_visible_show_the_background_and_have_no_gradient() {
    let Some(device) = gpu() else { return };
    let tracked = device.autodiff();
    for count in [0, 40] {
        for accumulation in [Accumulation::Atomic, Accumulation::Ordered] {
            let options = RenderOptions::standard().with_accumulation(accumulation);
            let mut scene = Scene::random(&mut Random::new(7), 40, 1, CAMERA);
            // Behind the camera.
            scene.means.chunks_exact_mut(3).for_each(|mean| mean[2] = -3.0);
            let SceneTensors { camera, background, .. } = scene.tensors(&tracked, DType::F32);
            // Burn does not track a slice without rows, so these tensors are leaves.
            let rows = |values: &[f64], columns| {
                tensor::<2>(&values[..columns * count], [count, columns], &tracked, DType::F32).require_grad()
            };
            let sh = tensor::<3>(&scene.sh[..12 * count], [count, 4, 3], &tracked, DType::F32).require_grad();
            let splats = Splats {
                means: rows(&scene.means, 3),
                rotations: rows(&scene.quats, 4),
                scales: rows(&scene.scales, 3),
                opacities: tensor::<1>(&scene.opacities[..count], [count], &tracked, DType::F32).require_grad(),
                colour: Colour::SphericalHarmonics(sh.clone()),
            };
            let probe = Tensor::<2>::zeros([count, 2], &tracked).require_grad();
            let extras = Extras::default().with_background(background.clone()).with_mean2d_probe(probe.clone());
            let out = render(&splats, std::slice::from_ref(&camera), &extras, &options).expect("a valid scene");
            let expected: Vec<f64> = scene.background.iter().map(|v| f64::from(*v as f32)).collect();
            let grads = (out.colour.clone().sum() + out.alpha.clone().sum()).backward();
            assert!(host(out.colour).chunks_exact(3).all(|pixel| pixel == expected), "{count} splats");
            assert!(host(out.alpha).iter().all(|alpha| *alpha == 0.0), "{count} splats");

            let pixels = (CAMERA.width * CAMERA.height) as f64;
            assert_eq!(host(background.grad(&grads).expect("tracked")), [pixels; 3]);
            let means = host(splats.means.grad(&grads).expect("tracked"));
            let pose = host(camera.cam_from_world.grad(&grads).expect("tracked"));
            let others = [means, pose, host(sh.grad(&grads).expect("tracked"))];
            assert!(others.iter().flatten().all(|gradient| *gradient == 0.0), "{count} splats");
            let probed = host(probe.grad(&grads).expect("tracked"));
            assert!(probed.len() == 2 * count && probed.iter().all(|gradient| *gradient == 0.0), "{count} splats");
        }
    }
}

#[test]
fn a_render_leaves_what_its_caller_computes_alone() {
    let Some(device) = gpu() else { return };
    let scene = Scene::random(&mut Random::new(5), 20, 0, CAMERA);
    let SceneTensors { splats, camera, .. } = scene.tensors(&device, DType::F32);
    let [a, b] = [3.0, 4.0].map(|value| tensor::<2>(&[value], [1, 1], &device, DType::F32));
    // Burn runs it later, together with what the render computes.
    let sum = a * 2.0 + b;
    let picture = render(&splats, &[camera], &Extras::default(), &RenderOptions::standard()).expect("a valid scene");
    assert!(host(picture.alpha).iter().any(|alpha| *alpha > 0.0));
    assert_eq!(host(sum), [10.0]);
}

#[test]
fn ordered_accumulation_gives_the_same_bits_in_every_run() {
    let Some(device) = gpu() else { return };
    let camera = Intrinsics::centred(190, 130, 150.0);
    let mut scene = Scene::random(&mut Random::new(8), 3000, 2, camera);
    scene.scales.iter_mut().for_each(|scale| *scale *= 0.3);
    let options = RenderOptions::standard().with_depth(true).with_accumulation(Accumulation::Ordered);
    let run = || named_gradients(&scene, 2, [true; 9], &options, &(device.clone(), DType::F32));
    let first = run();
    for again in 0..3 {
        for ((name, first), (_, second)) in first.iter().zip(run()) {
            let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            assert!(bits(first) == bits(&second), "{name} differs in run {again}");
        }
    }
}

#[test]
fn f64_and_tensors_elsewhere_are_refused() {
    let Some(device) = gpu() else { return };
    let scene = Scene::random(&mut Random::new(1), 5, 1, CAMERA);
    // Burn may create an f64 tensor on a GPU. The operation must never read its elements.
    let SceneTensors { splats, camera, .. } = scene.tensors(&device, DType::F32);
    let double = Splats { means: splats.means.clone().cast(DType::F64), ..splats.clone() };
    let refusal = project(&double, &camera, &Extras::default(), &SMOOTH).expect_err("refused").to_string();
    for part in ["`means`", "F64", "F32", "Tensor::cast", "CPU"] {
        assert!(refusal.contains(part), "`{part}` is missing: {refusal}");
    }
    let elsewhere = Splats { scales: Tensor::zeros([5, 3], (&Device::flex(), DType::F32)), ..splats };
    let refusal = render(&elsewhere, &[camera], &Extras::default(), &SMOOTH).expect_err("refused").to_string();
    assert!(refusal.contains("`scales`") && refusal.contains("Tensor::to_device"), "{refusal}");
}

/// Returns the size of a device's largest buffer if a test can exceed it. Otherwise prints why not.
fn small_limit(device: &Device) -> Option<usize> {
    let limit = test_hooks::buffer_limit(device).expect("a GPU") as usize;
    if limit > 1 << 28 {
        announce(&format!("SKIPPED: a buffer of this adapter holds {limit} bytes, too many to exceed in a test"));
        return None;
    }
    Some(limit)
}

/// One Gaussian in the middle of the picture, repeated `count` times by tensor views that take no memory.
fn repeated(count: usize, device: &Device) -> (Splats, Camera) {
    let row = |values: &[f64], columns| tensor::<2>(values, [1, columns], device, DType::F32).expand([count, columns]);
    let splats = Splats {
        means: row(&[0.0, 0.0, 2.0], 3),
        rotations: row(&[1.0, 0.0, 0.0, 0.0], 4),
        scales: row(&[20.0, 20.0, 0.1], 3),
        opacities: tensor::<1>(&[0.9], [1], device, DType::F32).expand([count]),
        colour: Colour::Features(row(&[0.2, 0.4, 0.6], 3)),
    };
    let camera = Camera::new(Intrinsics::centred(960, 540, 700.0), &glam::DAffine3::IDENTITY, device);
    (splats, camera)
}

#[test]
fn inputs_and_pictures_beyond_the_largest_buffer_are_refused() {
    let Some(device) = gpu() else { return };
    let limit = test_hooks::buffer_limit(&device).expect("a GPU");
    let refused = |splats: &Splats, cameras: &[Camera], names: &str, hint: &str| {
        let error = render(splats, cameras, &Extras::default(), &RenderOptions::standard()).expect_err(names);
        let SplatError::TooLarge { what, needed_bytes, limit_bytes, .. } = &error else { panic!("{error}") };
        assert!(*what == names && *needed_bytes > limit && *limit_bytes == limit, "{error}");
        assert!(error.to_string().contains(hint), "{error}");
    };
    let beyond = |bytes_per_row: usize| limit as usize / bytes_per_row + 1;
    let coefficients = |count: usize| {
        let sh = tensor::<3>(&[0.5; 75], [1, 25, 3], &device, DType::F32).expand([count, 25, 3]);
        let (splats, camera) = repeated(count, &device);
        (Splats { colour: Colour::SphericalHarmonics(sh), ..splats }, camera)
    };
    let (splats, camera) = coefficients(beyond(300));
    refused(&splats, &[camera], "sh", "lower degree");
    let (splats, camera) = repeated(beyond(28), &device);
    refused(&splats, &[camera], "projected", "fewer Gaussians");
    let channels = beyond(4 * 960 * 540) - 1;
    let (splats, camera) = repeated(1, &device);
    let features = Tensor::zeros([1, channels], (&device, DType::F32));
    let many = Splats { colour: Colour::Features(features), ..splats.clone() };
    refused(&many, std::slice::from_ref(&camera), "the picture", "smaller picture");
    refused(&splats, &vec![camera.clone(); beyond(12 * 960 * 540)], "the pictures of all cameras", "fewer cameras");
    // A rejected call has no effect on later calls.
    let out = render(&splats, &[camera], &Extras::default(), &RenderOptions::standard()).expect("it fits");
    assert!(host(out.alpha).iter().all(|alpha| *alpha > 0.5));
}

/// The number of intersections is known only inside the operation, which cannot return an error.
#[test]
fn too_many_intersections_fail_where_the_result_is_read_and_nowhere_else() {
    let Some(device) = gpu() else { return };
    let Some(limit) = small_limit(&device) else { return };
    let tiles = 60 * 34;
    let (splats, camera) = repeated(limit / 4 / tiles + 2, &device);
    let read = std::panic::catch_unwind(|| {
        let options = RenderOptions::standard();
        let projected = project(&splats, &camera, &Extras::default(), &options).expect("it fits");
        let intersections = intersect(&projected, &options).expect("it fits");
        intersections.counts.try_into_data().map(|_| ()).map_err(|error| format!("{error:?}"))
    });
    // Without fusion the operation runs immediately, and the panic reaches the caller.
    let failure = match read {
        Ok(result) => result.expect_err("too many intersections"),
        Err(panic) => panic.downcast_ref::<String>().expect("a message").clone(),
    };
    for part in ["the list of intersections", "bytes", &limit.to_string(), "alpha_min", "smaller picture"] {
        assert!(failure.contains(part), "`{part}` is missing: {failure}");
    }

    let (splats, camera) = repeated(3, &device);
    let out = render(&splats, &[camera], &Extras::default(), &RenderOptions::standard()).expect("it fits");
    assert!(host(out.alpha).iter().all(|alpha| *alpha > 0.9), "later calls are not harmed");
}

/// A step updates tensors in place if nothing else holds them, and must not change tensors that something else holds.
#[test]
fn adam_in_one_operation_is_adam_in_tensors_and_leaves_what_others_hold() {
    let Some(device) = gpu() else { return };
    let mut random = Random::new(21);
    let mut draw = |low: f64, high: f64| {
        let values: Vec<f32> = (0..700 * 3).map(|_| random.between(low, high) as f32).collect();
        Tensor::<2>::from_data(TensorData::new(values, [700, 3]), &device)
    };
    let start = draw(-1.0, 1.0);
    let (mut one, mut other) = (start.clone(), start.clone());
    let (mut moments, mut theirs) = (Moments::new(&start), Moments::new(&start));
    let before = host(start.clone());
    let adam = Adam::default();
    // Rates of the first column and of the other columns.
    let rates = Rates { first: 0.05, others: 0.01, width: 1 };
    for step in 1..=6 {
        let gradient = draw(-1e-3, 1e-3);
        other = in_tensor_code(|| adam.step(other, gradient.clone(), rates, &mut theirs, step));
        let held = (step == 3).then(|| one.clone());
        let known = held.clone().map(host);
        one = adam.step(one, gradient, rates, &mut moments, step);
        assert_eq!(held.map(host), known, "a step changed a tensor that is still held");
    }
    assert_eq!(host(start), before, "a step changed a tensor that is still held");
    let (one, other) = (host(one), host(other));
    assert!(one.iter().zip(&before).all(|(after, before)| after != before), "the step changes nothing");
    for (one, other) in one.iter().zip(other) {
        assert!((one - other).abs() <= 1e-6, "{one} instead of {other}");
    }
}
