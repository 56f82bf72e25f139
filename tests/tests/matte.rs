//! Gaussians in two groups, those whose colour varies with the direction and matte ones, against the same Gaussians in one, whose
//! higher coefficients are zero: the same pictures and gradients, on every backend, whatever is tracked.

use burn::tensor::{DType, Device, Tensor};
use splat_op::{Accumulation, Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, colours, render, shade};
use splat_tests::random::Random;
use splat_tests::scene::{Scene, host, tensor};
use splat_tests::{cpu_devices, gpu};

const CAMERA: Intrinsics = Intrinsics { fx: 61.0, fy: 64.0, cx: 36.0, cy: 26.5, ..Intrinsics::centred(75, 50, 61.0) };
const COUNT: usize = 120;
const DEGREE: usize = 2;
const COEFFICIENTS: usize = (DEGREE + 1) * (DEGREE + 1);

/// What is tracked.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Tracked {
    /// As in training: `project` and `shade` run in one.
    Scene,
    /// The pose too, so that they run one by one.
    ScenePose,
    /// Harmonics and pose, without a shape.
    Colours,
    /// The matte ones alone.
    Matte,
}

const CHOICES: [Tracked; 4] = [Tracked::Scene, Tracked::ScenePose, Tracked::Colours, Tracked::Matte];

/// A scene whose last Gaussians do not vary.
fn scene(matte: usize) -> Scene {
    let mut scene = Scene::random(&mut Random::new(7), COUNT, DEGREE, CAMERA);
    scene.scales.iter_mut().for_each(|scale| *scale *= 0.4);
    let rows = scene.sh.chunks_mut(3 * COEFFICIENTS).skip(COUNT - matte);
    rows.for_each(|row| row[3..].fill(0.0));
    scene
}

/// Pictures and gradients by name. The gradients of harmonics are those of the first Gaussians, and those of degree 0 of the
/// others; none where something else is tracked.
fn outcome(
    scene: &Scene,
    matte: usize,
    parted: bool,
    tracked: Tracked,
    (device, dtype): &(Device, DType),
) -> Vec<(&'static str, Vec<f64>)> {
    let (device, dtype, first) = (device.clone().autodiff(), *dtype, COUNT - matte);
    let shapes = matches!(tracked, Tracked::Scene | Tracked::ScenePose);
    let pose = matches!(tracked, Tracked::ScenePose | Tracked::Colours);
    let leaf2 = |values: &[f64], shape, wanted: bool| {
        let values = tensor::<2>(values, shape, &device, dtype);
        if wanted { values.require_grad() } else { values }
    };
    let leaf3 = |values: &[f64], shape, wanted: bool| {
        let values = tensor::<3>(values, shape, &device, dtype);
        if wanted { values.require_grad() } else { values }
    };
    let (directional, others) = scene.sh.split_at(3 * COEFFICIENTS * first);
    let constant: Vec<f64> = others.chunks_exact(3 * COEFFICIENTS).flat_map(|row| &row[..3]).copied().collect();
    let whole = leaf3(&scene.sh, [COUNT, COEFFICIENTS, 3], true);
    let directional = leaf3(directional, [first, COEFFICIENTS, 3], tracked != Tracked::Matte);
    let constant = leaf3(&constant, [matte, 1, 3], true);
    let colour = match parted {
        false => Colour::SphericalHarmonics(whole.clone()),
        true => Colour::Mixed { directional: directional.clone(), matte: constant.clone() },
    };
    let splats = Splats {
        means: leaf2(&scene.means, [COUNT, 3], shapes),
        rotations: leaf2(&scene.quats, [COUNT, 4], shapes),
        scales: leaf2(&scene.scales, [COUNT, 3], shapes),
        opacities: tensor::<1>(&scene.opacities, [COUNT], &device, dtype),
        colour,
    };
    let cam_from_world = leaf2(&scene.pose, [3, 4], pose);
    let camera = Camera { intrinsics: CAMERA, cam_from_world: cam_from_world.clone() };
    let options = RenderOptions::standard().with_accumulation(Accumulation::Ordered);
    let shown = host(colours(&splats, &camera).expect("a valid scene"));
    let out = render(&splats, &[camera], &Extras::default(), &options).expect("a valid scene");
    let weights = Random::new(5).fill(CAMERA.width * CAMERA.height * 3, -1.0, 1.0);
    let weights: Vec<f64> = weights.into_iter().map(|weight| f64::from(weight as f32)).collect();
    let weights: Tensor<4> = tensor(&weights, out.colour.dims(), &device, dtype);
    let grads = (out.colour.clone() * weights).sum().backward();
    let of_harmonics = |all: Vec<f64>| {
        let (directional, others) = all.split_at(3 * COEFFICIENTS * first);
        let constant = others.chunks_exact(3 * COEFFICIENTS).flat_map(|row| &row[..3]).copied().collect();
        (directional.to_vec(), constant)
    };
    let (of_directional, of_constant) = match parted {
        false => of_harmonics(host(whole.grad(&grads).expect("tracked"))),
        // A group of none takes no part.
        true => (
            directional.grad(&grads).map(host).unwrap_or_default(),
            constant.grad(&grads).map(host).unwrap_or_default(),
        ),
    };
    let mut all = vec![("colours", shown), ("picture", host(out.colour)), ("matte", of_constant)];
    if tracked != Tracked::Matte {
        all.push(("directional", of_directional));
    }
    if shapes {
        all.push(("means", host(splats.means.grad(&grads).expect("tracked"))));
        all.push(("scales", host(splats.scales.grad(&grads).expect("tracked"))));
    }
    if pose {
        all.push(("pose", host(cam_from_world.grad(&grads).expect("tracked"))));
    }
    all
}

#[test]
fn two_groups_render_as_one_on_a_cpu_to_the_last_bit() {
    for (_, device) in cpu_devices() {
        for dtype in [DType::F32, DType::F64] {
            let place = (device.clone(), dtype);
            for matte in [0, 1, 50, COUNT] {
                for tracked in CHOICES {
                    if matte == 0 && tracked == Tracked::Matte {
                        continue;
                    }
                    let scene = scene(matte);
                    let expected = outcome(&scene, matte, false, tracked, &place);
                    let found = outcome(&scene, matte, true, tracked, &place);
                    for ((name, found), (_, expected)) in found.iter().zip(&expected) {
                        assert_eq!(found.len(), expected.len(), "{name}");
                        // The sum over all centres that the pose gets is taken group by group.
                        let largest = expected.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                        let tolerance = if *name == "pose" { 1e-6 * largest } else { 0.0 };
                        let same = found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= tolerance);
                        assert!(same, "{name}, {matte} matte, {tracked:?}, {place:?}");
                        // A single one may be hidden, or too dark for a gradient.
                        assert!(found.len() <= 3 || largest > 1e-3, "{name} shows nothing");
                    }
                }
            }
        }
    }
}

#[test]
fn two_groups_render_as_one_on_a_gpu() {
    let Some(device) = gpu() else { return };
    let place = (device, DType::F32);
    for (matte, choices) in [(50, &CHOICES[..]), (0, &CHOICES[..1]), (1, &CHOICES[..1]), (COUNT, &CHOICES[..2])] {
        for &tracked in choices {
            let scene = scene(matte);
            let expected = outcome(&scene, matte, false, tracked, &place);
            let found = outcome(&scene, matte, true, tracked, &place);
            for ((name, found), (_, expected)) in found.iter().zip(&expected) {
                assert_eq!(found.len(), expected.len(), "{name}");
                let largest = expected.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                let error = found.iter().zip(expected).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
                assert!(error <= 1e-5 * largest, "{name}, {matte} matte, {tracked:?}: {error} of {largest}");
            }
        }
    }
}

/// That the colours which both ways agree on are those of [`shade`].
#[test]
fn colours_are_shaded() {
    let scene = scene(50);
    let tensors = scene.tensors(&Device::flex(), DType::F32);
    let expected = host(shade(&tensors.sh, &tensors.splats.means, &tensors.camera).expect("a valid scene"));
    assert_eq!(host(colours(&tensors.splats, &tensors.camera).expect("a valid scene")), expected);
    let directional = tensors.sh.clone().narrow(0, 0, COUNT - 50);
    let matte = tensors.sh.narrow(0, COUNT - 50, 50).narrow(1, 0, 1);
    let parted = Splats { colour: Colour::Mixed { directional, matte }, ..tensors.splats };
    assert_eq!(host(colours(&parted, &tensors.camera).expect("a valid scene")), expected);
}
