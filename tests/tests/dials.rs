//! The dials of a render through the public functions, on every device: what each changes, and that it changes nothing else.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{
    Accumulation, Camera, Colour, Culling, Exponential, Extras, Intrinsics, MAX_UNCUT_HITS, RenderOptions, Splats,
    Storage, project, render, tile,
};
use splat_tests::random::Random;
use splat_tests::scene::{Scene, Tensors, host, tensor};
use splat_tests::tracked::gradients_of;
use splat_tests::{cpu_devices, gpu};

const CAMERA: Intrinsics = Intrinsics { fx: 61.0, fy: 64.0, cx: 36.0, cy: 26.5, ..Intrinsics::centred(75, 50, 61.0) };

const OPTIONS: RenderOptions = RenderOptions::standard().with_depth(true).with_accumulation(Accumulation::Ordered);

type Where = (&'static str, Device, DType);

/// Both float types on the CPU, and the GPU's.
fn everywhere() -> Vec<Where> {
    let cpus = cpu_devices()
        .into_iter()
        .flat_map(|(name, device)| [DType::F32, DType::F64].map(|dtype| (name, device.clone(), dtype)));
    cpus.chain(gpu().map(|device| ("gpu", device, DType::F32))).collect()
}

/// Needles in and around the picture, few enough for a bucket of `blend` to hold each tile's list.
fn needles(count: usize) -> Scene {
    let mut scene = Scene::random(&mut Random::new(11), count, 1, CAMERA);
    for scales in scene.scales.chunks_exact_mut(3) {
        scales.copy_from_slice(&[0.9 * scales[0] + 0.1, 0.01, 0.01]);
    }
    scene
}

/// `colour alpha depth`, and how many Gaussians all tiles list.
fn picture(scene: &Scene, options: &RenderOptions, (_, device, dtype): &Where) -> ([Vec<f64>; 3], f64) {
    let Tensors { splats, camera, background, .. } = scene.tensors(device, *dtype);
    let extras = Extras { background: Some(background), ..Extras::default() };
    let out = render(&splats, std::slice::from_ref(&camera), &extras, options).expect("a valid scene");
    let projected = project(&splats, &camera, None, options).expect("a valid scene");
    let hits = tile(&projected, options).expect("a valid scene").counts.sum().into_scalar::<i32>();
    ([host(out.colour), host(out.alpha), host(out.depth.expect("asked for"))], f64::from(hits))
}

#[test]
fn culling_changes_time_alone() {
    let scene = needles(28);
    for place in everywhere() {
        let at = (place.1.clone(), place.2);
        let gradients = |options| gradients_of(&scene, 1, [true; 9], &options, &at);
        let (expected, fewest) = picture(&scene, &OPTIONS, &place);
        let expected_gradients = gradients(OPTIONS);
        let mut before = fewest;
        for culling in [Culling::OpacityBox, Culling::BoundingBox] {
            let (found, hits) = picture(&scene, &OPTIONS.with_culling(culling), &place);
            assert!(hits > before, "{}: {culling:?} lists {hits}, a finer one {before}", place.0);
            before = hits;
            assert!(found == expected, "{} {:?}: {culling:?} changes the picture", place.0, place.2);
            let found = gradients(OPTIONS.with_culling(culling));
            assert!(found == expected_gradients, "{} {:?}: {culling:?} changes a gradient", place.0, place.2);
        }
    }
}

/// Pictures and the gradients of the harmonics.
fn with_harmonics(
    scene: &Scene,
    matte: usize,
    options: &RenderOptions,
    (_, device, dtype): &Where,
) -> (Vec<f64>, Vec<f64>, Option<Vec<f64>>) {
    let device = device.clone().autodiff();
    let (count, coefficients) = (scene.count(), scene.coefficients());
    let (directional, others) = scene.sh.split_at(3 * coefficients * (count - matte));
    let sh = |values: &[f64], rows, coefficients| {
        tensor::<3>(values, [rows, coefficients, 3], &device, *dtype).require_grad()
    };
    let directional = sh(directional, count - matte, coefficients);
    let others: Vec<f64> = others.chunks_exact(3 * coefficients).flat_map(|row| &row[..3]).copied().collect();
    let others = (matte > 0).then(|| sh(&others, matte, 1));
    let Tensors { splats, camera, .. } = scene.tensors(&device, *dtype);
    let colour = match &others {
        None => Colour::SphericalHarmonics(directional.clone()),
        Some(others) => Colour::Mixed { directional: directional.clone(), matte: others.clone() },
    };
    let splats = Splats { colour, ..splats };
    let out = render(&splats, &[camera], &Extras::default(), options).expect("a valid scene");
    let weights = Random::new(5).fill(CAMERA.width * CAMERA.height * 3, -1.0, 1.0);
    let weights = tensor::<4>(&weights, [1, CAMERA.height, CAMERA.width, 3], &device, *dtype);
    let gradients = (out.colour.clone() * weights).sum().backward();
    let gradient = |leaf: &Tensor<3>| host(leaf.grad(&gradients).expect("tracked"));
    (host(out.colour), gradient(&directional), others.as_ref().map(gradient))
}

#[test]
fn harmonics_above_the_degree_are_as_if_they_were_not_there() {
    let scene = Scene::random(&mut Random::new(12), 60, 3, CAMERA);
    for place in everywhere() {
        for matte in [0, 20] {
            let all = with_harmonics(&scene, matte, &OPTIONS, &place);
            for degree in [0, 1, 2, 3, 4] {
                let used = 3 * (degree + 1) * (degree + 1);
                let found = with_harmonics(&scene, matte, &OPTIONS.with_sh_degree(Some(degree)), &place);
                let what = format!("{} {:?}, {matte} matte, degree {degree}", place.0, place.2);
                if degree >= 3 {
                    assert!(found == all, "{what}: there are none above it");
                    continue;
                }
                assert!(found.0 != all.0, "{what}: the dial changes nothing");
                let lower = Scene {
                    sh: scene.sh.chunks_exact(48).flat_map(|row| &row[..used]).copied().collect(),
                    ..scene.clone()
                };
                let expected = with_harmonics(&lower, matte, &OPTIONS, &place);
                assert!(found.0 == expected.0, "{what}: not the picture of these coefficients");
                assert!(found.2 == expected.2, "{what}: not the gradient of the matte ones");
                let rows = || found.1.chunks_exact(48);
                assert!(rows().flat_map(|row| &row[..used]).eq(&expected.1), "{what}: not the gradient of those used");
                assert!(rows().flat_map(|row| &row[used..]).all(|g| *g == 0.0), "{what}: a gradient of one not used");
            }
        }
    }
}

#[test]
fn a_degree_that_no_harmonics_have_is_refused() {
    let Tensors { splats, camera, .. } = needles(3).tensors(&Device::flex(), DType::F32);
    let options = OPTIONS.with_sh_degree(Some(5));
    let message = render(&splats, &[camera], &Extras::default(), &options).expect_err("refused").to_string();
    assert!(message.contains("`sh_degree` is 5") && message.contains("0 to 4"), "{message}");
}

#[test]
fn without_a_cut_a_large_picture_of_many_gaussians_is_refused() {
    let wide = Intrinsics::centred(32_768, 32_768, 30_000.0);
    let Tensors { splats, camera, .. } = needles(17).tensors(&Device::flex(), DType::F32);
    let camera = Camera { intrinsics: wide, ..camera };
    let uncut = RenderOptions { alpha_min: 0.0, ..OPTIONS };
    let projected = project(&splats, &camera, None, &uncut).expect("a valid scene");
    let message = tile(&projected, &uncut).expect_err("refused").to_string();
    for part in ["`alpha_min` is 0 for 17 Gaussians", &MAX_UNCUT_HITS.to_string(), "smaller picture"] {
        assert!(message.contains(part), "`{part}` is missing: {message}");
    }
}

#[test]
fn exponentials_and_storage_change_no_more_than_they_say() {
    let scene = Scene::random(&mut Random::new(13), 60, 1, CAMERA);
    // Without cuts, beside which a pair within rounding would jump.
    let smooth = RenderOptions { alpha_min: 1e-12, transmittance_min: 0.0, ..OPTIONS };
    for place in everywhere() {
        let (expected, _) = picture(&scene, &smooth, &place);
        let largest = expected[0].iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        let difference = |options: RenderOptions| {
            let (found, _) = picture(&scene, &options, &place);
            found[0].iter().zip(&expected[0]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest
        };
        let exponentials =
            [Exponential::Library, Exponential::Polynomial].map(|e| difference(smooth.with_exponential(e)));
        let half = difference(smooth.with_features(Storage::Half));
        println!("{} {:?}: exponentials {exponentials:?}, half precision {half:.1e}", place.0, place.2);
        // One of them is the standard one; in f64 both are.
        assert!(exponentials.contains(&0.0) && exponentials.iter().all(|d| *d <= 2e-6), "{exponentials:?}");
        assert_eq!(exponentials.iter().all(|d| *d == 0.0), place.2 == DType::F64, "{} {exponentials:?}", place.0);
        assert!(half > 0.0 && half <= 2.0_f64.powi(-11), "{}: {half:.1e}", place.0);
    }
}
