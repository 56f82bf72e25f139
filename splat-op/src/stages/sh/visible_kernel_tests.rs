//! Visibility in the kernels against colours of all Gaussians, and against the twin.

use super::Shading;
use super::cpu::{Visible, sh_cpu};
use super::launch::{launch_sh, launch_sh_backward};
use super::visible_tests::{COEFFICIENTS, StageInputs, check_colours, spec};
use crate::gpu::{Buffer, Gpu};
use crate::project::cpu::project_cpu;
use crate::project::{COLUMNS, ProjectSpec};
use crate::testing::ceiling::to_f32;
use crate::testing::gpu::gpus;

/// Inputs, packed ellipses and gradient of the colours.
fn upload(scene: &StageInputs, spec: &ProjectSpec, gpu: &Gpu) -> (Shading<Buffer<f32>>, Buffer<f32>, Buffer<f32>) {
    let buffer = |values: &[f64]| Buffer::from_slice(gpu, &to_f32(values));
    let inputs = Shading { sh: buffer(&scene.0[4]), means: buffer(&scene.0[0]), cam_from_world: buffer(&scene.0[5]) };
    (inputs, buffer(&project_cpu(scene.geometry(), spec)), buffer(scene.grad()))
}

/// Tolerance, because compilers differ in which multiplications and additions they contract.
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
fn colours_are_those_of_all_or_zero_where_nothing_can_show() {
    for (count, alpha_min) in [(1, 0.0), (255, 0.05), (256, 1.0 / 255.0), (2_000, 1.0 / 255.0), (300, 0.0)] {
        let (scene, spec) = (StageInputs::random(count as u64, count), spec(alpha_min));
        let packed = project_cpu(scene.geometry(), &spec);
        let by_twin = sh_cpu(scene.inputs(), Some(&Visible::new(&packed, &spec)));
        for (form, gpu) in gpus() {
            let (inputs, ellipses, _) = upload(&scene, &spec, &gpu);
            let colours = launch_sh(&gpu, &inputs, Some((&ellipses, &spec)), COEFFICIENTS).read(&gpu);
            let expected = launch_sh(&gpu, &inputs, None, COEFFICIENTS).read(&gpu);
            let same = |i: usize| (3 * i..3 * i + 3).all(|at| close(colours[at], expected[at], 0.1));
            let skipped = check_colours(&to_f32(&packed), &colours, &spec, same);
            let twin_zero = |i: usize| by_twin[3 * i..3 * i + 3] == [0.0; 3];
            let twin = (0..count).filter(|i| twin_zero(*i) && packed[COLUMNS * i + 5] > 0.0 && !same(*i)).count();
            // Rounding may move a Gaussian across the border of its box.
            assert!(skipped.abs_diff(twin) <= 2, "{count} Gaussians, {form}: {skipped} left out, by the twin {twin}");
        }
    }
}

#[test]
fn gradients_are_those_of_all_without_the_colours_that_cannot_show() {
    let spec = spec(1.0 / 255.0);
    for (count, choices) in [(700, (0..8).collect()), (256, vec![7]), (1, vec![7])] as [(usize, Vec<u32>); 3] {
        let scene = StageInputs::random(10 + count as u64, count);
        for ((form, gpu), choice) in gpus().iter().flat_map(|gpu| choices.iter().map(move |choice| (gpu, choice))) {
            let (inputs, ellipses, grad) = upload(&scene, &spec, gpu);
            let visible = Some((&ellipses, &spec));
            let colours = launch_sh(gpu, &inputs, visible, COEFFICIENTS).read(gpu);
            let all = launch_sh(gpu, &inputs, None, COEFFICIENTS).read(gpu);
            let mut shown = grad.read(gpu);
            for (i, grad) in shown.chunks_exact_mut(3).enumerate() {
                if (3 * i..3 * i + 3).any(|at| colours[at] == 0.0 && all[at] != 0.0) {
                    grad.fill(0.0);
                }
            }
            let [sh, means, cam_from_world] = std::array::from_fn(|i| choice >> i & 1 != 0);
            let needs = Shading { sh, means, cam_from_world };
            let found = launch_sh_backward(gpu, &inputs, visible, COEFFICIENTS, &grad, needs);
            let shown = Buffer::from_slice(gpu, &shown);
            let expected = launch_sh_backward(gpu, &inputs, None, COEFFICIENTS, &shown, needs);
            let read = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(|buffer| buffer.read(gpu));
            for (name, found, expected) in [
                ("sh", read(&found.sh), read(&expected.sh)),
                ("means", read(&found.means), read(&expected.means)),
                ("pose", read(&found.cam_from_world), read(&expected.cam_from_world)),
            ] {
                let what = format!("{name} of {count}, choice {choice:#b}, {form}");
                assert_eq!(found.is_some(), expected.is_some(), "{what}");
                assert_close(&what, &found.unwrap_or_default(), &expected.unwrap_or_default());
            }
        }
    }
}

#[test]
fn no_gaussians() {
    let spec = spec(0.01);
    for (_, gpu) in gpus() {
        let (inputs, ellipses, grad) = upload(&StageInputs::random(0, 0), &spec, &gpu);
        let visible = Some((&ellipses, &spec));
        assert!(launch_sh(&gpu, &inputs, visible, COEFFICIENTS).read(&gpu).is_empty());
        let needs = Shading { sh: true, means: true, cam_from_world: true };
        let found = launch_sh_backward(&gpu, &inputs, visible, COEFFICIENTS, &grad, needs);
        assert!(found.sh.expect("asked for").read(&gpu).is_empty());
        assert_eq!(found.cam_from_world.expect("asked for").read(&gpu), [0.0; 12]);
    }
}
