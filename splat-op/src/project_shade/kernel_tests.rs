//! The kernels of both stages in one against those of the stages alone, which are proven against the twins.

use super::launch::{DeviceInputs, launch_project_shade, launch_project_shade_backward};
use super::tests::{COEFFICIENTS, PARTED, Parted, Scene, check_colours, constant_of, spec};
use super::{ProjectShadeNeeds, cpu};
use crate::gpu::{Buffer, Gpu};
use crate::project::launch::{DeviceInputs as ProjectInputs, launch_project, launch_project_backward};
use crate::project::{COLUMNS, ProjectNeeds};
use crate::shade::ShadeNeeds;
use crate::shade::launch::{DeviceInputs as ShadeInputs, launch_shade, launch_shade_backward};
use crate::testing::ceiling::to_f32;
use crate::testing::gpu::gpus;

/// The inputs of all three, and the two gradients.
fn upload(scene: &Scene, gpu: &Gpu) -> (DeviceInputs, ShadeInputs, [Buffer<f32>; 2]) {
    let [means, rotations, scales, opacities, sh, cam_from_world, ellipses, colours] =
        std::array::from_fn(|i| Buffer::from_slice(gpu, &to_f32(&scene.0[i])));
    let of_shade = ShadeInputs { sh: sh.clone().into(), means: means.clone(), cam_from_world: cam_from_world.clone() };
    let geometry = ProjectInputs { means, rotations, scales, opacities, cam_from_world };
    (DeviceInputs { geometry, sh: sh.into(), matte: None }, of_shade, [ellipses, colours])
}

/// One compiler may contract what another does not.
fn close(found: f32, expected: f32, scale: f32) -> bool {
    (found - expected).abs() <= 1e-5 * (expected.abs() + scale)
}

fn assert_close(what: &str, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let scale = expected.iter().map(|value| value.abs()).sum::<f32>() / expected.len().max(1) as f32;
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!(close(*found, *expected, scale), "{what}, {i}: {found} instead of {expected}");
    }
}

#[test]
fn forwards_they_are_the_stages_but_for_colours_that_cannot_show() {
    for (count, alpha_min) in [(1, 0.0), (255, 0.05), (256, 1.0 / 255.0), (2_000, 1.0 / 255.0), (300, 0.0)] {
        let (scene, spec) = (Scene::random(count as u64, count), spec(alpha_min));
        for (form, gpu) in gpus() {
            let (inputs, of_shade, _) = upload(&scene, &gpu);
            let (packed, colours) = launch_project_shade(&gpu, &inputs, COEFFICIENTS, &spec);
            let (packed, colours) = (packed.read(&gpu), colours.read(&gpu));
            let what = format!("{count} Gaussians, {form}");
            assert_close(&what, &packed, &launch_project(&gpu, &inputs.geometry, &spec).read(&gpu));
            let expected = launch_shade(&gpu, &of_shade, COEFFICIENTS).read(&gpu);
            let same = |i: usize| (3 * i..3 * i + 3).all(|at| close(colours[at], expected[at], 0.1));
            let skipped = check_colours(&packed, &colours, &spec, same);
            let by_twin = cpu::project_shade_cpu(scene.inputs(), &spec).1;
            let twin_zero = |i: usize| by_twin[3 * i..3 * i + 3] == [0.0; 3];
            let twin = (0..count).filter(|i| twin_zero(*i) && packed[COLUMNS * i + 5] > 0.0 && !same(*i)).count();
            // Rounding may move one across the border of its box.
            assert!(skipped.abs_diff(twin) <= 2, "{what}: {skipped} left out, by the twin {twin}");
        }
    }
}

#[test]
fn backwards_they_are_the_sum_of_the_stages_for_any_choice_of_gradients() {
    let spec = spec(1.0 / 255.0);
    for (count, choices) in [(700, (0..64).collect()), (256, vec![63]), (1, vec![63])] as [(usize, Vec<u32>); 3] {
        let scene = Scene::random(10 + count as u64, count);
        for ((form, gpu), choice) in gpus().iter().flat_map(|gpu| choices.iter().map(move |choice| (gpu, choice))) {
            let (inputs, of_shade, [ellipses, colours]) = upload(&scene, gpu);
            let [means, rotations, scales, opacities, mean2d, sh] = std::array::from_fn(|i| choice >> i & 1 != 0);
            let geometry = ProjectNeeds { means, rotations, scales, opacities, mean2d, cam_from_world: false };
            let (needs, grads) = (ProjectShadeNeeds { geometry, sh, matte: false }, (&ellipses, &colours));
            let found = launch_project_shade_backward(gpu, &inputs, COEFFICIENTS, grads, &spec, needs);
            let one = launch_project_backward(gpu, &inputs.geometry, &ellipses, &spec, geometry);
            let shade_needs = ShadeNeeds { sh, means, cam_from_world: false };
            let other = launch_shade_backward(gpu, &of_shade, COEFFICIENTS, &colours, shade_needs);
            let read = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(|buffer| buffer.read(gpu));
            let sum = read(&one.means).zip(read(&other.means));
            let sum = sum.map(|(one, other)| one.iter().zip(other).map(|(a, b)| a + b).collect::<Vec<f32>>());
            let g = &found.geometry;
            assert!(g.cam_from_world.is_none());
            for (name, found, expected) in [
                ("means", read(&g.means), sum),
                ("rotations", read(&g.rotations), read(&one.rotations)),
                ("scales", read(&g.scales), read(&one.scales)),
                ("opacities", read(&g.opacities), read(&one.opacities)),
                ("mean2d", read(&g.mean2d), read(&one.mean2d)),
                ("sh", read(&found.sh), read(&other.sh)),
            ] {
                let what = format!("{name} of {count}, choice {choice:#b}, {form}");
                assert_eq!(found.is_some(), expected.is_some(), "{what}");
                assert_close(&what, &found.unwrap_or_default(), &expected.unwrap_or_default());
            }
        }
    }
}

#[test]
fn matte_gaussians_are_those_without_higher_harmonics() {
    let spec = spec(1.0 / 255.0);
    for (count, matte) in PARTED {
        let parted = Parted::new(Scene::random(count as u64, count), matte);
        for (form, gpu) in gpus() {
            let (flat, _, [ellipses, colours]) = upload(&parted.flat, &gpu);
            let [sh, constant] = [&parted.sh, &parted.matte].map(|sh| Buffer::from_slice(&gpu, &to_f32(sh)).into());
            let inputs = DeviceInputs { sh, matte: Some(constant), ..flat.clone() };
            let (packed, shown) = launch_project_shade(&gpu, &inputs, COEFFICIENTS, &spec);
            let (expected_packed, expected_shown) = launch_project_shade(&gpu, &flat, COEFFICIENTS, &spec);
            let what = format!("{matte} of {count}, {form}");
            assert_close(&what, &packed.read(&gpu), &expected_packed.read(&gpu));
            assert_close(&what, &shown.read(&gpu), &expected_shown.read(&gpu));
            for choice in 0..8_u32 {
                let [means, sh, matte] = std::array::from_fn(|i| choice >> i & 1 != 0);
                let geometry = ProjectNeeds {
                    means,
                    rotations: true,
                    scales: true,
                    opacities: true,
                    mean2d: true,
                    cam_from_world: false,
                };
                let (needs, grads) = (ProjectShadeNeeds { geometry, sh, matte }, (&ellipses, &colours));
                let found = launch_project_shade_backward(&gpu, &inputs, COEFFICIENTS, grads, &spec, needs);
                let all = ProjectShadeNeeds { sh: true, matte: false, ..needs };
                let expected = launch_project_shade_backward(&gpu, &flat, COEFFICIENTS, grads, &spec, all);
                let read = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(|buffer| buffer.read(&gpu));
                let harmonics = read(&expected.sh).expect("asked for");
                let (first, last) = harmonics.split_at(parted.sh.len());
                let (g, e) = (&found.geometry, &expected.geometry);
                for (name, found, expected) in [
                    ("means", read(&g.means), read(&e.means)),
                    ("rotations", read(&g.rotations), read(&e.rotations)),
                    ("opacities", read(&g.opacities), read(&e.opacities)),
                    ("sh", read(&found.sh), sh.then(|| first.to_vec())),
                    ("matte", read(&found.matte), matte.then(|| constant_of(last))),
                ] {
                    let what = format!("{name}, {what}, choice {choice:#b}");
                    assert_eq!(found.is_some(), expected.is_some(), "{what}");
                    assert_close(&what, &found.unwrap_or_default(), &expected.unwrap_or_default());
                }
            }
        }
    }
}

#[test]
fn no_gaussians() {
    let geometry = ProjectNeeds {
        means: true,
        rotations: true,
        scales: true,
        opacities: true,
        mean2d: true,
        cam_from_world: false,
    };
    for (_, gpu) in gpus() {
        let (inputs, _, [ellipses, colours]) = upload(&Scene::random(0, 0), &gpu);
        let (packed, shown) = launch_project_shade(&gpu, &inputs, COEFFICIENTS, &spec(0.01));
        assert!(packed.read(&gpu).is_empty() && shown.read(&gpu).is_empty());
        let needs = ProjectShadeNeeds { geometry, sh: true, matte: false };
        let grads = (&ellipses, &colours);
        let found = launch_project_shade_backward(&gpu, &inputs, COEFFICIENTS, grads, &spec(0.01), needs);
        assert!(found.geometry.means.expect("asked for").read(&gpu).is_empty());
        assert!(found.sh.expect("asked for").read(&gpu).is_empty());
    }
}
