//! The kernels of `project` against the twin in f64.

use cubecl::prelude::{ComptimeOptionArgs, CubeCount, CubeDim};

use super::backward::{GeometryOutputsLaunch, project_backward_kernel};
use super::cpu::{project_backward_cpu, project_cpu};
use super::launch::{geometry_arg, launch_project, launch_project_backward, project_camera};
use super::testing::*;
use super::{COLUMNS, Geometry};
use crate::gpu::{Buffer, UNITS};
use crate::testing::ceiling::{PerturbedReference, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::lenses::{ORTHOGRAPHIC, lenses};

fn check_forward(what: &str, scene: &StageInputs, view: &TestCamera) -> f64 {
    let classes = scene.classes(view, false);
    let forward = |tensors: &[Vec<f64>]| vec![project_cpu(inputs(tensors), &view.spec(&tensors[LENS]))];
    let reference = PerturbedReference::new(&scene.tensors, forward);
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let found = launch_project(&gpu, &scene.upload(&gpu).0, &view.spec(&view.lens)).read(&gpu);
        worst = worst.max(reference.check(&format!("projected, {what}, {form}"), 0, &found, &classes));
    }
    worst
}

/// A scene whose Gaussians in the band have no gradient, its classes, and the twin's results.
fn backward_reference(mut scene: StageInputs, view: &TestCamera) -> (StageInputs, Vec<Option<u8>>, PerturbedReference) {
    let classes = scene.classes(view, true);
    for (i, _) in classes.iter().enumerate().filter(|(_, class)| class.is_none()) {
        scene.tensors[GRAD][COLUMNS * i..COLUMNS * (i + 1)].fill(0.0);
    }
    let reference = PerturbedReference::new(&scene.tensors, |tensors| {
        let mut spec = view.spec(&tensors[LENS]);
        // Without blur the compensation is one and its gradient zero, which the twin computes as a difference.
        spec.options.antialias &= spec.options.blur > 0.0;
        list(project_backward_cpu(inputs(tensors), &tensors[GRAD], &spec, ALL))
    });
    (scene, classes, reference)
}

fn check_backward(what: &str, scene: StageInputs, view: &TestCamera, needs: &[Geometry<bool>]) -> f64 {
    let (scene, classes, reference) = backward_reference(scene, view);
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        for needs in needs {
            let found = launch_project_backward(&gpu, &inputs, &grad, &view.spec(&view.lens), *needs);
            let Geometry { means, rotations, scales, opacities, cam_from_world, mean2d } = *needs;
            let needed = [means, rotations, scales, opacities, cam_from_world, mean2d];
            for (i, found) in read(&gpu, &found).into_iter().enumerate() {
                let what = format!("gradient of {}, {what}, {form}", NAMES[i]);
                assert_eq!(found.is_some(), needed[i], "{what}");
                let Some(found) = found else { continue };
                let share = match i {
                    // One class and one column: the floor is relative to the largest entry.
                    POSE => reference.check(&what, i, &found, &[Some(ORDINARY); 12]),
                    _ => reference.check_gradient(&what, i, &found, &classes, &[CULLED, ORDINARY]),
                };
                worst = worst.max(share);
            }
        }
    }
    worst
}

/// Combinations of views, blurs and anti-aliasing.
fn views() -> impl Iterator<Item = (String, TestCamera)> {
    (0..12).map(|i| {
        let (which, blur, antialias) = (i % 3, [0.3, 0.0][i / 3 % 2], i >= 6);
        (format!("view {which}, blur {blur}, antialias {antialias}"), TestCamera::new(which, blur, antialias))
    })
}

#[test]
fn forward_agrees_with_the_twin() {
    for (i, (what, view)) in views().enumerate() {
        let scene = StageInputs::random(i as u64, 1_500, &view, true);
        println!("{what}: {:.3}", check_forward(&what, &scene, &view));
    }
}

#[test]
fn backward_agrees_with_the_twin() {
    for (i, (what, view)) in views().enumerate() {
        for wild in [false, true] {
            let scene = StageInputs::random(100 + i as u64, 1_500, &view, wild);
            let what = format!("{what}, wild {wild}");
            println!("{what}: {:.3}", check_backward(&what, scene, &view, &[ALL]));
        }
    }
}

#[test]
fn every_lens_agrees_with_the_twin() {
    for (i, lens) in lenses().into_iter().chain([ORTHOGRAPHIC]).enumerate() {
        let view = TestCamera::new(1, 0.3, i % 2 == 1).with_lens(lens);
        for wild in [false, true] {
            let (seed, what) = (200 + 2 * i as u64, format!("{lens:?}, wild {wild}"));
            let forward = check_forward(&what, &StageInputs::random(seed, 1_500, &view, wild), &view);
            let backward = check_backward(&what, StageInputs::random(seed + 1, 1_500, &view, wild), &view, &[ALL]);
            println!("{what}: {forward:.3}, {backward:.3}");
        }
    }
}

/// The polynomials of a fisheye differ between the float types.
#[test]
fn the_twin_in_f32_agrees_with_itself_in_f64_for_every_lens() {
    for (i, lens) in lenses().into_iter().chain([ORTHOGRAPHIC]).enumerate() {
        let view = TestCamera::new(1, 0.3, i % 2 == 1).with_lens(lens);
        let scene = StageInputs::random(300 + i as u64, 1_500, &view, false);
        let classes = scene.classes(&view, false);
        let spec = |tensors: &[Vec<f64>]| view.spec(&tensors[LENS]);
        let reference =
            PerturbedReference::new(&scene.tensors, |tensors| vec![project_cpu(inputs(tensors), &spec(tensors))]);
        let in_f32 = |scene: &StageInputs| scene.tensors.iter().map(|tensor| to_f32(tensor)).collect::<Vec<_>>();
        let found = project_cpu(inputs(&in_f32(&scene)), &spec(&scene.tensors));
        let forward = reference.check(&format!("{lens:?} in f32"), 0, &found, &classes);

        let (scene, classes, reference) = backward_reference(scene, &view);
        let tensors = in_f32(&scene);
        let found = project_backward_cpu(inputs(&tensors), &tensors[GRAD], &spec(&scene.tensors), ALL);
        let what = format!("gradient of means, {lens:?} in f32");
        let backward = reference.check_gradient(&what, 0, &found.means, &classes, &[CULLED, ORDINARY]);
        println!("{lens:?}: {forward:.3}, {backward:.3}");
    }
}

#[test]
fn any_number_of_gaussians() {
    let view = TestCamera::new(1, 0.3, true);
    for count in [1, 2, 255, 256, 257, 100_000] {
        let what = format!("{count} Gaussians");
        let forward = check_forward(&what, &StageInputs::random(count as u64, count, &view, true), &view);
        let backward = check_backward(&what, StageInputs::random(count as u64, count, &view, false), &view, &[ALL]);
        println!("{what}: {forward:.3}, {backward:.3}");
    }
}

#[test]
fn no_gaussians() {
    let view = TestCamera::new(1, 0.3, true);
    let scene = StageInputs::random(0, 0, &view, false);
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let spec = view.spec(&view.lens);
        assert!(launch_project(&gpu, &inputs, &spec).read(&gpu).is_empty());
        let found = read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &spec, ALL));
        for (i, found) in found.into_iter().enumerate() {
            assert_eq!(found, Some(vec![0.0; if i == POSE { 12 } else { 0 }]));
        }
    }
}

#[test]
fn gradients_are_computed_where_asked_for() {
    let flags = |on: [bool; 6]| {
        let [means, rotations, scales, opacities, cam_from_world, mean2d] = on;
        Geometry { means, rotations, scales, opacities, cam_from_world, mean2d }
    };
    let mut needs = vec![flags([false; 6])];
    for i in 0..6 {
        needs.push(flags(std::array::from_fn(|j| i == j)));
        needs.push(flags(std::array::from_fn(|j| i != j)));
    }
    let view = TestCamera::new(1, 0.3, true);
    check_backward("part", StageInputs::random(7, 300, &view, true), &view, &needs);
}

/// A dispatch along two axes has more cubes than the Gaussians need; the surplus cubes write nothing.
#[test]
fn surplus_cubes_write_nothing() {
    let (view, count) = (TestCamera::new(1, 0.3, true), 300);
    let scene = StageInputs::random(9, count, &view, false);
    let nothing = || ComptimeOptionArgs::None;
    let needs = Geometry { opacities: true, cam_from_world: true, ..Geometry::default() };
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let rows = Buffer::<f32>::new(&gpu, 6 * 12);
        let opacities = Buffer::<f32>::new(&gpu, 6 * UNITS);
        // SAFETY: the outputs have room for every cube, and the kernel guards the inputs.
        unsafe {
            project_backward_kernel::launch_unchecked(
                &gpu.client,
                CubeCount::Static(3, 2, 1),
                CubeDim::new_1d(UNITS as u32),
                geometry_arg(&inputs),
                grad.arg(),
                GeometryOutputsLaunch::new(
                    nothing(),
                    ComptimeOptionArgs::None,
                    nothing(),
                    ComptimeOptionArgs::Some(opacities.arg()),
                    nothing(),
                    ComptimeOptionArgs::Some(rows.arg()),
                ),
                project_camera(&view.spec(&view.lens)),
                count as u32,
                needs,
            );
        }
        // In tests, slots that no kernel wrote are NaN.
        let written = |values: Vec<f32>| values.into_iter().map(|value| !value.is_nan()).collect::<Vec<_>>();
        let expected = |len: usize, first: usize| (0..len).map(|i| i < first).collect::<Vec<_>>();
        assert_eq!(written(rows.read(&gpu)), expected(6 * 12, 2 * 12));
        assert_eq!(written(opacities.read(&gpu)), expected(6 * UNITS, count));
    }
}

#[test]
fn a_second_run_gives_the_same_bits() {
    let view = TestCamera::new(2, 0.3, true);
    let scene = StageInputs::random(8, 20_000, &view, true);
    let bits = |values: Option<Vec<f32>>| values.expect("asked for").into_iter().map(f32::to_bits).collect::<Vec<_>>();
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let run = || read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &view.spec(&view.lens), ALL)).map(bits);
        assert!(run() == run());
    }
}

/// A gradient that is NaN must reach every parameter, for the guard to see.
#[test]
fn nan_passes_the_limit_of_a_quaternions_gradient() {
    let view = TestCamera::new(1, 0.3, false);
    let mut scene = StageInputs::random(5, 100, &view, false);
    let spec = view.spec(&view.lens);
    let seen = project_cpu(inputs(&scene.tensors), &spec);
    let row = seen.chunks_exact(COLUMNS).position(|row| row[5] > 0.0).expect("some are in view");
    scene.tensors[GRAD][COLUMNS * row..COLUMNS * (row + 1)].fill(f64::NAN);
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let found = read(&gpu, &launch_project_backward(&gpu, &inputs, &grad, &spec, ALL));
        let rotations = found[1].as_ref().expect("asked for");
        assert!(rotations[4 * row..4 * (row + 1)].iter().all(|value| value.is_nan()), "{form}: {rotations:?}");
        let others = rotations[..4 * row].iter().chain(&rotations[4 * (row + 1)..]);
        assert!(others.into_iter().all(|value| value.is_finite()), "{form}");
    }
}
