//! The dials of a render through the public functions, on every device: each dial changes its own part of the result and no other.

use burn::tensor::{DType, Device};
use splat_op::{
    Accumulation, Camera, Colour, Extras, Intrinsics, MAX_UNCULLED_INTERSECTIONS, RenderOptions, Splats, intersect,
    project, render,
};
use splat_tests::random::Random;
use splat_tests::scene::{Scene, SceneTensors, host, tensor};
use splat_tests::{cpu_devices, gpu};

const CAMERA: Intrinsics = Intrinsics::pinhole(75, 50, [61.0, 64.0], [36.0, 26.5]);

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
    let uncut = OPTIONS.with_alpha_min(0.0);
    let projected = project(&splats, &camera, &Extras::default(), &uncut).expect("a valid scene");
    let message = intersect(&projected, &uncut).expect_err("refused").to_string();
    for part in ["`alpha_min` is 0 for 17 Gaussians", &MAX_UNCULLED_INTERSECTIONS.to_string(), "smaller picture"] {
        assert!(message.contains(part), "`{part}` is missing: {message}");
    }
}
