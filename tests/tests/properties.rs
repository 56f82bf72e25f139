//! Properties that hold for every scene.

use burn::tensor::{DType, Device};
use proptest::prelude::*;
use splat_op::{Accumulation, Camera, Extras, Intrinsics, RenderOptions, Rendered, render};
use splat_tests::compare::relative_error;
use splat_tests::random::Random;
use splat_tests::scene::{LossWeights, RenderOutputs, Scene, SceneTensors, evaluate, host, tensor};
use splat_tests::tracked::gradients_of;
use splat_tests::{cpu_devices, devices, gpu};

const CAMERA: Intrinsics = Intrinsics::pinhole(33, 21, [27.0, 30.0], [15.0, 11.5]);

const OPTIONS: RenderOptions = RenderOptions::standard().with_depth(true);

/// A device and a float type.
type Where = (Device, DType);

const F64: fn() -> Where = || (Device::flex(), DType::F64);

/// Every device with its float types: both on the CPU, f32 on the GPU.
fn everywhere() -> impl Iterator<Item = Where> {
    [(Device::flex(), DType::F32), F64()].into_iter().chain(gpu().map(|device| (device, DType::F32)))
}

fn picture(scene: &Scene, options: &RenderOptions, (device, dtype): Where) -> [Vec<f64>; 3] {
    let SceneTensors { splats, camera, background, .. } = scene.tensors(&device, dtype);
    let extras = Extras::default().with_background(background);
    values(render(&splats, &[camera], &extras, options).expect("a valid scene"))
}

fn values(out: Rendered<4>) -> [Vec<f64>; 3] {
    [host(out.colour), host(out.alpha), host(out.depth.expect("asked for"))]
}

/// Returns the gradient of a loss over some of the pictures of a render with respect to the centres.
fn gradient_through(parts: [bool; 3], depth: bool, scene: &Scene, (device, dtype): Where) -> Vec<f64> {
    let SceneTensors { splats, camera, background, .. } = scene.tensors(&device.autodiff(), dtype);
    let extras = Extras::default().with_background(background);
    let options = RenderOptions::standard().with_depth(depth);
    let out = render(&splats, &[camera], &extras, &options).expect("a valid scene");
    let pictures = [Some(out.colour), Some(out.alpha), out.depth];
    let chosen = pictures.into_iter().zip(parts).filter_map(|(picture, chosen)| picture.filter(|_| chosen));
    let loss = chosen.map(|picture| picture.square().sum()).reduce(|a, b| a + b).expect("one is chosen");
    host(splats.means.grad(&loss.backward()).expect("tracked"))
}

#[test]
fn gradients_through_parts_of_a_picture_add_up() {
    let scene = Scene::random(&mut Random::new(8), 40, 1, CAMERA);
    for at in everywhere() {
        for depth in [false, true] {
            let single = |i: usize| gradient_through(std::array::from_fn(|j| i == j), depth, &scene, at.clone());
            let singles: Vec<Vec<f64>> = (0..2 + usize::from(depth)).map(single).collect();
            assert!(singles.iter().all(|part| part.iter().any(|g| *g != 0.0)), "a part without a gradient");
            for mask in 3..1_usize << singles.len() {
                let parts: [bool; 3] = std::array::from_fn(|i| mask >> i & 1 == 1);
                let found = gradient_through(parts, depth, &scene, at.clone());
                for (i, found) in found.iter().enumerate() {
                    let expected: f64 =
                        singles.iter().zip(parts).filter(|(_, chosen)| *chosen).map(|(g, _)| g[i]).sum();
                    let scale: f64 = singles.iter().map(|g| g[i].abs()).sum();
                    assert!(
                        (found - expected).abs() <= 1e-4 * scale + 1e-5,
                        "{parts:?}: {found} instead of {expected}"
                    );
                }
            }
        }
    }
}

fn reorder(values: &[f64], order: &[usize]) -> Vec<f64> {
    let columns = values.len() / order.len();
    order.iter().flat_map(|&i| values[i * columns..(i + 1) * columns].to_vec()).collect()
}

/// Returns the rotation matrix of a unit quaternion wxyz, row by row.
fn rotation([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn quaternion_product(a: [f64; 4], b: &[f64]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Moves world and camera together by a rotation (unit quaternion) and a translation.
fn moved(scene: &Scene, turn: [f64; 4], shift: [f64; 3]) -> Scene {
    let r = rotation(turn);
    let mut out = scene.clone();
    for mean in out.means.chunks_exact_mut(3) {
        let turned = r.map(|row| row[0] * mean[0] + row[1] * mean[1] + row[2] * mean[2]);
        (0..3).for_each(|i| mean[i] = turned[i] + shift[i]);
    }
    for quat in out.quats.chunks_exact_mut(4) {
        quat.copy_from_slice(&quaternion_product(turn, quat));
    }
    // cam_from_world · world_from_moved, with x = Rᵀ (x' − shift)
    for (row, old) in out.pose.chunks_exact_mut(4).zip(scene.pose.chunks_exact(4)) {
        let turned = [0, 1, 2].map(|j| (0..3).map(|i| old[i] * r[j][i]).sum::<f64>());
        row[..3].copy_from_slice(&turned);
        row[3] = old[3] - (0..3).map(|j| turned[j] * shift[j]).sum::<f64>();
    }
    out
}

fn close(found: &[Vec<f64>; 3], expected: &[Vec<f64>; 3], tolerance: f64) -> Result<(), TestCaseError> {
    for (found, expected) in found.iter().zip(expected) {
        let error = relative_error(found, expected);
        prop_assert!(error <= tolerance, "relative error {error:.3e}");
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_order_of_splats_changes_no_bit(seed: u64, count in 1_usize..60) {
        let mut random = Random::new(seed);
        let scene = Scene::random(&mut random, count, 1, CAMERA);
        let mut order: Vec<usize> = (0..count).collect();
        (1..count).rev().for_each(|i| order.swap(i, random.between(0.0, i as f64 + 1.0) as usize));
        let shuffled = Scene {
            means: reorder(&scene.means, &order),
            quats: reorder(&scene.quats, &order),
            scales: reorder(&scene.scales, &order),
            opacities: reorder(&scene.opacities, &order),
            sh: reorder(&scene.sh, &order),
            ..scene.clone()
        };
        for place in everywhere() {
            prop_assert_eq!(picture(&scene, &OPTIONS, place.clone()), picture(&shuffled, &OPTIONS, place));
        }
    }

    #[test]
    fn moving_world_and_camera_together_changes_nothing(
        seed: u64, turn in prop::array::uniform4(-1.0_f64..1.0), shift in prop::array::uniform3(-5.0_f64..5.0),
    ) {
        let length = turn.iter().map(|c| c * c).sum::<f64>().sqrt();
        prop_assume!(length > 0.1);
        let scene = Scene::random(&mut Random::new(seed), 30, 0, CAMERA);
        // Without cuts, at which a pair within rounding error would jump.
        let smooth = OPTIONS.with_alpha_min(0.0).with_transmittance_min(0.0);
        let other = moved(&scene, turn.map(|c| c / length), shift);
        close(&picture(&other, &smooth, F64()), &picture(&scene, &smooth, F64()), 1e-10)?;
    }

    #[test]
    fn zero_opacity_shows_exactly_the_background(seed: u64) {
        let mut scene = Scene::random(&mut Random::new(seed), 20, 1, CAMERA);
        scene.opacities.fill(0.0);
        for (device, dtype) in everywhere() {
            let background = host(tensor::<1>(&scene.background, [3], &device, dtype));
            let [colour, alpha, depth] = picture(&scene, &OPTIONS, (device, dtype));
            prop_assert!(colour.chunks_exact(3).all(|pixel| pixel == background));
            prop_assert!(alpha.iter().chain(&depth).all(|v| *v == 0.0));
        }
    }

    #[test]
    fn the_length_of_a_quaternion_does_not_matter(seed: u64, power in -60_i32..60, factor in 0.01_f64..100.0) {
        let scene = Scene::random(&mut Random::new(seed), 20, 1, CAMERA);
        let scaled = |by: f64| Scene { quats: scene.quats.iter().map(|q| q * by).collect(), ..scene.clone() };
        let exact = scaled(2.0_f64.powi(power));
        for place in everywhere() {
            prop_assert_eq!(picture(&exact, &OPTIONS, place.clone()), picture(&scene, &OPTIONS, place));
        }
        let smooth = OPTIONS.with_alpha_min(0.0).with_transmittance_min(0.0);
        let original = picture(&scene, &smooth, F64());
        close(&picture(&scaled(factor), &smooth, F64()), &original, 1e-12)?;
        // The opposite quaternion is the same rotation.
        prop_assert_eq!(picture(&scaled(-1.0), &smooth, F64()), original);
    }
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    // The scene is large enough for several tasks in every stage.
    let camera = Intrinsics::pinhole(90, 70, [27.0, 30.0], [15.0, 11.5]);
    let mut random = Random::new(1);
    let mut scene = Scene::random(&mut random, 5000, 2, camera);
    scene.scales.iter_mut().for_each(|s| *s *= 0.2);
    let weights = LossWeights::random(&mut random, &camera);
    for (name, device) in cpu_devices() {
        for dtype in [DType::F32, DType::F64] {
            let with = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
                pool.install(|| evaluate(&scene, &weights, &OPTIONS, &device, dtype))
            };
            let (one, two) = (with(1), with(2));
            let all = |e: RenderOutputs| [e.stages, e.pictures, e.gradients].concat();
            for (one, two) in all(one).iter().zip(all(two)) {
                assert!(one.values == two.values, "{} differs on {name} in {dtype:?}", one.name);
            }
        }
    }
}

#[test]
fn untracked_inputs_have_no_gradient_and_do_not_change_the_others() {
    let scene = Scene::random(&mut Random::new(3), 40, 2, CAMERA);
    let all = gradients_of(&scene, 1, [true; 9], &OPTIONS, &F64());
    assert!(all.iter().all(|g| g.as_ref().is_some_and(|g| g.iter().any(|v| *v != 0.0))), "every input matters");
    for one in 0..9 {
        for alone in [true, false] {
            let tracked = std::array::from_fn(|i| (i == one) == alone);
            let some = gradients_of(&scene, 1, tracked, &OPTIONS, &F64());
            for i in 0..9 {
                let expected = if tracked[i] { all[i].as_ref() } else { None };
                assert!(some[i].as_ref() == expected, "input {i}, tracked {tracked:?}");
            }
        }
    }
}

#[test]
fn several_cameras_in_one_call_are_separate_calls() {
    let scene = Scene::random(&mut Random::new(4), 50, 2, CAMERA);
    let options = OPTIONS.with_accumulation(Accumulation::Ordered);
    for (_, device) in devices() {
        let device = device.autodiff();
        let cameras = |first: &Camera| -> Vec<Camera> {
            let other = |shift: f64| {
                let mut pose = scene.pose.clone();
                pose[3] += shift;
                let cam_from_world = tensor(&pose, [3, 4], &device, DType::F32);
                Camera { intrinsics: CAMERA.with_focal(CAMERA.fx * (1.0 + shift), CAMERA.fy), cam_from_world }
            };
            vec![first.clone(), other(0.2), other(-0.3)]
        };
        let together = scene.tensors(&device, DType::F32);
        let views = cameras(&together.camera);
        let out = render(&together.splats, &views, &Extras::default(), &options).expect("valid");
        assert_eq!(out.colour.dims(), [3, CAMERA.height, CAMERA.width, 3]);
        let grads = (out.colour.clone().sum() + out.alpha.clone().sum()).backward();
        let gradient = host(together.splats.means.grad(&grads).expect("tracked"));

        let mut sum = vec![0.0; gradient.len()];
        let mut parts = [Vec::new(), Vec::new(), Vec::new()];
        for view in 0..3 {
            let alone = scene.tensors(&device, DType::F32);
            let camera = cameras(&alone.camera).swap_remove(view);
            let out = render(&alone.splats, &[camera], &Extras::default(), &options).expect("valid");
            let grads = (out.colour.clone().sum() + out.alpha.clone().sum()).backward();
            let gradient = host(alone.splats.means.grad(&grads).expect("tracked"));
            sum.iter_mut().zip(gradient).for_each(|(sum, g)| *sum += g);
            parts.iter_mut().zip(values(out)).for_each(|(all, part)| all.extend(part));
        }
        assert!(values(out) == parts, "the pictures differ");
        let error = relative_error(&gradient, &sum);
        assert!(error <= 1e-6, "gradients add up to {error:.3e}");
    }
}
