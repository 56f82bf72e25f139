//! The dials of a render through the public functions, on every device: each dial changes its own part of the result and no other.

use burn::tensor::{DType, Device, f16};
use splat_op::{
    Accumulation, Camera, Colour, Extras, Intrinsics, MAX_UNCULLED_INTERSECTIONS, Projection, RenderOptions, Splats,
    Storage, intersect, project, render,
};
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host, tensor};
use splat_tests::tracked::{INPUTS, gradients_of};
use splat_tests::{cpu_devices, gpu, ndarray};

const CAMERA: Intrinsics = Intrinsics { fx: 61.0, fy: 64.0, cx: 36.0, cy: 26.5, ..Intrinsics::centred(75, 50, 61.0) };

const OPTIONS: RenderOptions = RenderOptions::standard().with_depth(true).with_accumulation(Accumulation::Ordered);

type Where = (&'static str, Device, DType);

/// Every device with its float types: both on the CPU, f32 on the GPU.
fn everywhere() -> Vec<Where> {
    let cpus = cpu_devices()
        .into_iter()
        .flat_map(|(name, device)| [DType::F32, DType::F64].map(|dtype| (name, device.clone(), dtype)));
    cpus.chain(gpu().map(|device| ("gpu", device, DType::F32))).collect()
}

/// Needles in and around the picture.
fn needles(count: usize) -> Scene {
    let mut scene = Scene::random(&mut Random::new(11), count, 1, CAMERA);
    for scales in scene.scales.chunks_exact_mut(3) {
        scales.copy_from_slice(&[0.9 * scales[0] + 0.1, 0.01, 0.01]);
    }
    scene
}

/// Returns the pictures and the gradients of the harmonics.
fn with_harmonics(scene: &Scene, options: &RenderOptions, (_, device, dtype): &Where) -> (Vec<f64>, Vec<f64>) {
    let device = device.clone().autodiff();
    let sh = tensor::<3>(&scene.sh, [scene.count(), scene.coefficients(), 3], &device, *dtype).require_grad();
    let SceneTensors { splats, camera, .. } = scene.tensors(&device, *dtype);
    let splats = Splats { colour: Colour::SphericalHarmonics(sh.clone()), ..splats };
    let out = render(&splats, &[camera], &Extras::default(), options).expect("a valid scene");
    let weights = Random::new(5).fill(CAMERA.width * CAMERA.height * 3, -1.0, 1.0);
    let weights = tensor::<4>(&weights, [1, CAMERA.height, CAMERA.width, 3], &device, *dtype);
    let gradients = (out.colour.clone() * weights).sum().backward();
    (host(out.colour), host(sh.grad(&gradients).expect("tracked")))
}

#[test]
fn harmonics_above_the_degree_are_as_if_they_were_not_there() {
    let scene = Scene::random(&mut Random::new(12), 60, 3, CAMERA);
    for place in everywhere() {
        let all = with_harmonics(&scene, &OPTIONS, &place);
        for degree in [0, 1, 2, 3, 4] {
            let used = 3 * (degree + 1) * (degree + 1);
            let found = with_harmonics(&scene, &OPTIONS.with_sh_degree(Some(degree)), &place);
            let what = format!("{} {:?}, degree {degree}", place.0, place.2);
            if degree >= 3 {
                assert!(found == all, "{what}: there are no harmonics above this degree");
                continue;
            }
            assert!(found.0 != all.0, "{what}: the dial changes nothing");
            let lower = Scene {
                sh: scene.sh.chunks_exact(48).flat_map(|row| &row[..used]).copied().collect(),
                ..scene.clone()
            };
            let expected = with_harmonics(&lower, &OPTIONS, &place);
            assert!(found.0 == expected.0, "{what}: the picture differs from that of the lower coefficients");
            let rows = || found.1.chunks_exact(48);
            assert!(rows().flat_map(|row| &row[..used]).eq(&expected.1), "{what}: a used coefficient's gradient");
            assert!(rows().flat_map(|row| &row[used..]).all(|g| *g == 0.0), "{what}: an unused gradient");
        }
    }
}

#[test]
fn a_degree_that_no_harmonics_have_is_refused() {
    let SceneTensors { splats, camera, .. } = needles(3).tensors(&Device::flex(), DType::F32);
    let options = OPTIONS.with_sh_degree(Some(5));
    let message = render(&splats, &[camera], &Extras::default(), &options).expect_err("refused").to_string();
    assert!(message.contains("`sh_degree` is 5") && message.contains("0 to 4"), "{message}");
}

#[test]
fn without_a_cut_a_large_picture_of_many_gaussians_is_refused() {
    let wide = Intrinsics::centred(32_768, 32_768, 30_000.0);
    let SceneTensors { splats, camera, .. } = needles(17).tensors(&Device::flex(), DType::F32);
    let camera = Camera { intrinsics: wide, ..camera };
    let uncut = RenderOptions { alpha_min: 0.0, ..OPTIONS };
    let projected = project(&splats, &camera, &Extras::default(), &uncut).expect("a valid scene");
    let message = intersect(&projected, &uncut).expect_err("refused").to_string();
    for part in ["`alpha_min` is 0 for 17 Gaussians", &MAX_UNCULLED_INTERSECTIONS.to_string(), "smaller picture"] {
        assert!(message.contains(part), "`{part}` is missing: {message}");
    }
}

/// The scene with its harmonics rounded to half precision.
fn rounded(scene: &Scene) -> Scene {
    Scene { sh: scene.sh.iter().map(|value| f16::from_f64(*value).to_f64()).collect(), ..scene.clone() }
}

/// The devices that support tensors of half precision.
fn with_halves() -> Vec<Where> {
    let all = everywhere().into_iter();
    all.filter(|(_, device, _)| device.supports_dtype(DType::F16)).collect()
}

#[track_caller]
fn assert_same(what: &str, exactly: bool, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let most = expected.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    assert!(most > 0.0, "{what}: all zero, which proves nothing");
    // Different kernels may contract different sums.
    let slack = if exactly { 0.0 } else { 1e-5 * most };
    let worst = found.iter().zip(expected).fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()));
    assert!(worst <= slack, "{what}: {worst:e} of {most:e}");
}

#[test]
fn coefficients_of_half_precision_are_rounded_ones() {
    let half = OPTIONS.with_coefficients(Storage::Half);
    let places = with_halves();
    assert!(places.iter().any(|place| place.0 == "flex"), "no device has half precision");
    for degree in 0..=4 {
        // The number of Gaussians is odd, so that the last word of an odd number of coefficients is half empty.
        let scene = Scene::random(&mut Random::new(14 + degree as u64), 61, degree, CAMERA);
        for place in &places {
            let what = format!("{} {:?}, degree {degree}", place.0, place.2);
            let full = with_harmonics(&scene, &OPTIONS, place);
            let found = with_harmonics(&scene, &half, place);
            let expected = with_harmonics(&rounded(&scene), &OPTIONS, place);
            let exactly = place.0 != "gpu";
            assert!(found.0 != full.0, "{what}: the dial changes nothing");
            assert_same(&what, exactly, &found.0, &expected.0);
            assert_same(&what, exactly, &found.1, &expected.1);
        }
    }
}

#[test]
fn coefficients_of_half_precision_have_gradients_in_a_step_that_trains_all() {
    let scene = Scene::random(&mut Random::new(19), 61, 3, CAMERA);
    // With the pose, without it, and with per-ray rasterization. One camera, because another graph may change the order of a sum
    // over several cameras.
    let poses = [[true; 9], [true, true, true, true, true, false, true, true, true]];
    for place in with_halves() {
        for tracked in poses {
            for options in [OPTIONS, OPTIONS.with_projection(Projection::RayMax)] {
                let at = (place.1.clone(), place.2);
                let what = format!("{} {:?}, {tracked:?}, {:?}", place.0, place.2, options.projection);
                let half = options.with_coefficients(Storage::Half);
                let found = gradients_of(&scene, 1, tracked, &half, &at);
                let expected = gradients_of(&rounded(&scene), 1, tracked, &options, &at);
                for ((found, expected), name) in found.iter().zip(&expected).zip(INPUTS) {
                    let (Some(found), Some(expected)) = (found, expected) else {
                        assert_eq!(found.is_some(), expected.is_some(), "{what}, {name}");
                        continue;
                    };
                    assert_same(&format!("{what}, {name}"), place.0 != "gpu", found, expected);
                }
            }
        }
    }
}

#[test]
fn a_scene_can_be_stored_in_half_precision_once() {
    let mut scene = Scene::random(&mut Random::new(20), 61, 2, CAMERA);
    // A value above the largest half is clamped to it and does not become infinite.
    scene.sh[5] = 1e6;
    for (name, device, dtype) in with_halves() {
        let SceneTensors { splats, camera, .. } = scene.tensors(&device, dtype);
        let colour = |splats: &Splats, options: &RenderOptions| {
            host(render(splats, std::slice::from_ref(&camera), &Extras::default(), options).expect("valid").colour)
        };
        let half = OPTIONS.with_coefficients(Storage::Half);
        let stored = splats.stored(&half).expect("there is half precision");
        let Colour::SphericalHarmonics(sh) = &stored.colour else { panic!("still harmonics") };
        assert_eq!((sh.dtype(), sh.dims()), (DType::F16, [61, 9, 3]), "{name}");
        let expected = colour(&splats, &half);
        assert!(expected.iter().all(|value| value.is_finite()), "{name}");
        for options in [half, OPTIONS] {
            assert!(colour(&stored, &options) == expected, "{name} {dtype:?}: differs from what each render stores");
        }
        let lower = half.with_sh_degree(Some(1));
        assert!(colour(&stored, &lower) == colour(&splats, &lower), "{name} {dtype:?}: of a lower degree");
    }
}

#[test]
fn half_precision_is_refused_where_there_is_none() {
    let scene = Scene::random(&mut Random::new(21), 10, 1, CAMERA);
    let half = OPTIONS.with_coefficients(Storage::Half);
    let SceneTensors { splats, camera, .. } = scene.tensors(&ndarray(), DType::F32);
    let message = render(&splats, &[camera], &Extras::default(), &half).expect_err("refused").to_string();
    assert!(message.contains("`coefficients` is Storage::Half") && message.contains("Storage::Full"), "{message}");
}
