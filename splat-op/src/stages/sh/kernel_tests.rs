//! The kernels of `evaluate_sh` against the twin in f64.

use glam::{DMat3, DVec3};

use super::cpu::{ShCpuInputs, sh_backward_cpu, sh_cpu};
use super::launch::{launch_sh, launch_sh_backward};
use super::{Shading, coefficients_of};
use crate::gpu::{Buffer, Gpu};
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

const ALL: Shading<bool> = Shading { sh: true, means: true, cam_from_world: true };
const NAMES: [&str; 3] = ["sh", "means", "pose"];

// Classes of Gaussians.
const ORDINARY: u8 = 0;
const FAR: u8 = 1;
const CLOSE: u8 = 2;

/// Coefficients, means, pose and gradient, all in f32 precision, and the kind of each Gaussian.
struct StageInputs {
    tensors: Vec<Vec<f64>>,
    kinds: Vec<u8>,
    degree: usize,
}

const POSE: usize = 2;
const GRAD: usize = 3;

fn inputs(tensors: &[Vec<f64>], degree: usize) -> ShCpuInputs<'_, f64> {
    let [sh, means, cam_from_world, ..] = tensors else { unreachable!("three tensors") };
    ShCpuInputs { sh, means, cam_from_world, coefficients: coefficients_of(degree) }
}

impl StageInputs {
    /// Gaussians around the camera, far from it and close to it. Some have no gradient, and some of these are not finite. The
    /// camera is rotated and away from the origin; if `bent`, its matrix is not a rotation.
    fn random(seed: u64, count: usize, degree: usize, bent: bool) -> Self {
        let mut random = Random::new(seed);
        let row = 3 * coefficients_of(degree);
        let mut sh = random.fill(row * count, -0.4, 0.4);
        // The constant terms may exceed the 0.5, so that some channels are clamped at every degree.
        sh.chunks_exact_mut(row).for_each(|sh| sh[..3].iter_mut().for_each(|c| *c *= 8.0));
        let mut grad = random.fill(3 * count, -1.0, 1.0);
        let pose = match bent {
            false => [0.8, 0.0, -0.6, 1.0, -0.36, 0.8, -0.48, -2.0, 0.48, 0.6, 0.64, 0.5],
            true => [0.9, 0.2, -0.3, 0.4, -0.1, 1.1, 0.2, -0.6, 0.3, -0.2, 0.8, 0.5],
        };
        let column = |c: usize| DVec3::new(pose[c], pose[4 + c], pose[8 + c]);
        let matrix = DMat3::from_cols(column(0), column(1), column(2));
        let eye = (matrix.inverse() * -column(3)).to_array();
        let (mut means, mut kinds) = (Vec::new(), Vec::new());
        for i in 0..count {
            let (kind, reach) = match i % 8 {
                3 => (FAR, 1e4),
                5 => (CLOSE, 1e-2),
                _ => (ORDINARY, 3.0),
            };
            kinds.push(kind);
            means.extend(eye.map(|e| e + reach * random.between(-1.0, 1.0)));
            if i % 8 == 1 {
                grad[3 * i..3 * i + 3].fill(0.0);
            }
            if i % 16 == 1 {
                let bad = [f64::NAN, f64::INFINITY][i / 16 % 2];
                sh[row * i + i / 16 % row] = bad;
                means[3 * i + i / 16 % 3] = bad;
            }
        }
        let tensors = [sh, means, pose.to_vec(), grad].iter().map(|tensor| rounded(tensor)).collect();
        Self { tensors, kinds, degree }
    }

    fn upload(&self, gpu: &Gpu) -> (Shading<Buffer<f32>>, Buffer<f32>) {
        let buffer = |i: usize| Buffer::from_slice(gpu, &to_f32(&self.tensors[i]));
        (Shading { sh: buffer(0), means: buffer(1), cam_from_world: buffer(POSE) }, buffer(GRAD))
    }

    /// Class of each Gaussian; `None` for one that is not finite.
    fn classes(&self) -> Vec<Option<u8>> {
        let (means, row) = (&self.tensors[1], 3 * coefficients_of(self.degree));
        let finite = |i: usize| {
            let sh = &self.tensors[0][row * i..row * (i + 1)];
            means[3 * i..3 * i + 3].iter().chain(sh).all(|value| value.is_finite())
        };
        self.kinds.iter().enumerate().map(|(i, kind)| finite(i).then_some(*kind)).collect()
    }

    /// Sets the gradient to zero in channels that are clamped or not depending on rounding.
    fn mask_band(&mut self) {
        let lifted = |tensors: &[Vec<f64>]| {
            // Large enough that no channel is clamped; added to the coefficient of the constant function.
            let (lift, constant) = (100.0, 0.282_094_791_773_878_14);
            let mut tensors = tensors.to_vec();
            let row = 3 * coefficients_of(self.degree);
            for sh in tensors[0].chunks_exact_mut(row) {
                sh[..3].iter_mut().for_each(|c| *c += lift / constant);
            }
            vec![sh_cpu(inputs(&tensors, self.degree), None).iter().map(|colour| colour - lift).collect()]
        };
        let band = PerturbedReference::new(&self.tensors, lifted).near_zero(0);
        let count = band.iter().filter(|band| **band).count();
        assert!(count <= 1 + band.len() / 100, "{count} of {} channels in the band", band.len());
        self.tensors[GRAD].iter_mut().zip(band).filter(|(_, band)| *band).for_each(|(grad, _)| *grad = 0.0);
    }
}

fn list(g: Shading<Vec<f64>>) -> Vec<Vec<f64>> {
    vec![g.sh, g.means, g.cam_from_world]
}

fn read(gpu: &Gpu, g: &Shading<Option<Buffer<f32>>>) -> [Option<Vec<f32>>; 3] {
    [&g.sh, &g.means, &g.cam_from_world].map(|buffer| buffer.as_ref().map(|buffer| buffer.read(gpu)))
}

fn check_forward(what: &str, scene: &StageInputs) -> f64 {
    let reference =
        PerturbedReference::new(&scene.tensors, |tensors| vec![sh_cpu(inputs(tensors, scene.degree), None)]);
    let clamped = reference.expected[0].iter().filter(|colour| **colour == 0.0).count();
    assert!(scene.kinds.len() < 100 || clamped > 5, "{what}: only {clamped} channels are clamped");
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let found = launch_sh(&gpu, &scene.upload(&gpu).0, None, coefficients_of(scene.degree)).read(&gpu);
        worst = worst.max(reference.check(&format!("colours, {what}, {form}"), 0, &found, &scene.classes()));
    }
    worst
}

fn check_backward(what: &str, mut scene: StageInputs, needs: &[Shading<bool>]) -> f64 {
    scene.mask_band();
    // Gaussians that are not finite have no gradient and are compared too.
    let classes: Vec<_> = scene.kinds.iter().copied().map(Some).collect();
    let reference = PerturbedReference::new(&scene.tensors, |tensors| {
        list(sh_backward_cpu(inputs(tensors, scene.degree), None, &tensors[GRAD], ALL))
    });
    let mut worst = 0.0_f64;
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        for needs in needs {
            let found = launch_sh_backward(&gpu, &inputs, None, coefficients_of(scene.degree), &grad, *needs);
            let needed = [needs.sh, needs.means, needs.cam_from_world];
            for (i, found) in read(&gpu, &found).into_iter().enumerate() {
                let what = format!("gradient of {}, {what}, {form}", NAMES[i]);
                assert_eq!(found.is_some(), needed[i], "{what}");
                let Some(found) = found else { continue };
                let share = match i {
                    // One class and one column: the floor is relative to the largest entry.
                    POSE => reference.check(&what, i, &found, &[Some(ORDINARY); 12]),
                    _ => reference.check_gradient(&what, i, &found, &classes, &[ORDINARY, FAR]),
                };
                worst = worst.max(share);
            }
        }
    }
    worst
}

#[test]
fn both_passes_agree_with_the_twin() {
    for degree in 0..=4 {
        for bent in [false, true] {
            let what = format!("degree {degree}, bent {bent}");
            let forward = check_forward(&what, &StageInputs::random(degree as u64, 1_000, degree, bent));
            let backward = check_backward(&what, StageInputs::random(10 + degree as u64, 1_000, degree, bent), &[ALL]);
            println!("{what}: {forward:.3}, {backward:.3}");
        }
    }
}

#[test]
fn any_number_of_gaussians() {
    for count in [1, 2, 255, 256, 257, 100_000] {
        let what = format!("{count} Gaussians");
        let forward = check_forward(&what, &StageInputs::random(count as u64, count, 3, false));
        let backward = check_backward(&what, StageInputs::random(count as u64, count, 3, false), &[ALL]);
        println!("{what}: {forward:.3}, {backward:.3}");
    }
}

#[test]
fn no_gaussians() {
    for (_, gpu) in gpus() {
        let (inputs, grad) = StageInputs::random(0, 0, 2, false).upload(&gpu);
        assert!(launch_sh(&gpu, &inputs, None, 9).read(&gpu).is_empty());
        let found = read(&gpu, &launch_sh_backward(&gpu, &inputs, None, 9, &grad, ALL));
        assert_eq!(found, [Some(vec![]), Some(vec![]), Some(vec![0.0; 12])]);
    }
}

#[test]
fn gradients_are_computed_where_asked_for() {
    let needs: Vec<_> =
        (0..8).map(|i| Shading { sh: i & 1 != 0, means: i & 2 != 0, cam_from_world: i & 4 != 0 }).collect();
    for degree in [0, 3] {
        check_backward("part", StageInputs::random(7, 300, degree, true), &needs);
    }
}

#[test]
fn a_centre_on_the_camera_has_a_colour_and_no_direction() {
    let mut scene = StageInputs::random(8, 10, 2, false);
    scene.tensors[POSE] = vec![1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    scene.tensors[1][..3].fill(0.0);
    scene.tensors[GRAD].fill(1.0);
    let expected = sh_cpu(inputs(&scene.tensors, 2), None);
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let colours = launch_sh(&gpu, &inputs, None, 9).read(&gpu);
        for (found, expected) in colours[..3].iter().zip(&expected) {
            assert!((f64::from(*found) - expected).abs() <= 1e-6 * (1.0 + expected));
        }
        let found = read(&gpu, &launch_sh_backward(&gpu, &inputs, None, 9, &grad, ALL));
        assert_eq!(found[1].as_ref().expect("asked for")[..3], [0.0; 3]);
    }
}

#[test]
#[ignore = "large: half a GB of buffers"]
fn more_cubes_than_fit_along_one_axis() {
    let (few, count) = (1_000, 32_768 * 256 + 1_500);
    let scene = StageInputs::random(9, few, 0, false);
    let repeated = |i: usize| to_f32(&scene.tensors[i]).into_iter().cycle().take(3 * count).collect::<Vec<f32>>();
    for (_, gpu) in gpus() {
        let (small, small_grad) = scene.upload(&gpu);
        let [sh, means, grad] = [0, 1, GRAD].map(|i| Buffer::from_slice(&gpu, &repeated(i)));
        let large = Shading { sh, means, cam_from_world: small.cam_from_world.clone() };
        let run = |inputs: &Shading<Buffer<f32>>, grad: &Buffer<f32>| {
            let found = launch_sh_backward(&gpu, inputs, None, 1, grad, Shading { means: false, ..ALL });
            [launch_sh(&gpu, inputs, None, 1).read(&gpu), found.sh.expect("asked for").read(&gpu)]
        };
        for (found, expected) in run(&large, &grad).iter().zip(run(&small, &small_grad)) {
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            assert!(found.chunks(3 * few).all(|chunk| bits(chunk) == bits(&expected[..chunk.len()])));
        }
    }
}

#[test]
fn a_second_run_gives_the_same_bits() {
    let scene = StageInputs::random(9, 20_000, 3, true);
    let bits = |values: Option<Vec<f32>>| values.expect("asked for").into_iter().map(f32::to_bits).collect::<Vec<_>>();
    for (_, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let run = || read(&gpu, &launch_sh_backward(&gpu, &inputs, None, 16, &grad, ALL)).map(bits);
        assert!(run() == run());
    }
}

#[test]
fn what_is_not_finite_is_told_by_bits() {
    let mut scene = StageInputs::random(3, 4, 0, false);
    let sh = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.0, -9.0, -f64::NAN, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    scene.tensors[0] = sh.to_vec();
    scene.tensors[GRAD] = vec![1.0; 12];
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let colours = launch_sh(&gpu, &inputs, None, 1).read(&gpu);
        let grads = read(&gpu, &launch_sh_backward(&gpu, &inputs, None, 1, &grad, ALL));
        let grads = grads[0].as_ref().expect("asked for");
        for (i, c) in sh.iter().enumerate().take(6) {
            let (found, expected) = (colours[i], (0.5 + 0.282_094_79 * c) as f32);
            let same = match expected.is_nan() {
                true => found.is_nan(),
                false => found == expected.max(0.0) || (found - expected).abs() < 1e-6,
            };
            assert!(same, "{form}: the colour of {c} is {found}");
            assert_eq!(grads[i] != 0.0, expected > 0.0, "{form}: the gradient of {c} is {}", grads[i]);
        }
    }
}

#[test]
fn a_centre_that_is_nowhere_spoils_no_sum() {
    let mut scene = StageInputs::random(4, 300, 2, false);
    scene.tensors[0].iter_mut().filter(|c| !c.is_finite()).for_each(|c| *c = 0.1);
    scene.tensors[1].iter_mut().filter(|c| !c.is_finite()).for_each(|c| *c = 0.1);
    scene.tensors[1][3 * 7] = f64::NAN;
    scene.tensors[GRAD].fill(1.0);
    for (form, gpu) in gpus() {
        let (inputs, grad) = scene.upload(&gpu);
        let found = read(&gpu, &launch_sh_backward(&gpu, &inputs, None, 9, &grad, ALL));
        for (name, found) in NAMES.iter().zip(&found).skip(1) {
            let found = found.as_ref().expect("asked for");
            assert!(found.iter().all(|value| value.is_finite()), "{form}: the gradient of {name}");
        }
    }
}
