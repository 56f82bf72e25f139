//! The kernels of `activate` against the twin in f64.

use super::cpu::{opacities_cpu, opacity_slopes_cpu, scales_cpu};
use super::launch::{ActivatedGrads, launch_activate, launch_activate_backward, launch_non_finite};
use super::rule::Raw;
use crate::gpu::{Buffer, Gpu};
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::{gpu, gpus};
use crate::testing::random::Random;

/// Means, rotations, logarithms of scales, logits and coefficients, in f32 precision.
fn tensors(seed: u64, count: usize, coefficients: usize) -> Vec<Vec<f64>> {
    let mut random = Random::new(seed);
    let all = [
        random.fill(3 * count, -5.0, 5.0),
        random.fill(4 * count, -1.0, 1.0),
        random.fill(3 * count, -60.0, 60.0),
        random.fill(count, -60.0, 60.0),
        random.fill(3 * coefficients * count, -1.0, 1.0),
    ];
    all.iter().map(|tensor| rounded(tensor)).collect()
}

/// Sets slots of each tensor in turn to each value that the rule distinguishes.
fn poison(tensors: &mut [Vec<f64>]) {
    let values = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::from(f32::MAX),
        f64::from(f32::MIN),
        1e18_f32.into(),
        -2e18,
        88.0,
        88.5,
        -0.0,
    ];
    let count = tensors[3].len();
    for row in (0..count).step_by(3) {
        let (tensor, value) = (row / 3 % 5, values[row / 15 % values.len()]);
        let columns = tensors[tensor].len() / count;
        if columns > 0 {
            tensors[tensor][columns * row + row / 7 % columns] = value;
        }
    }
    for row in (1..count).step_by(50) {
        tensors[1][4 * row..4 * row + 4].fill(if row % 4 == 1 { 0.0 } else { -0.0 });
    }
}

fn inputs(t: &[Vec<f64>]) -> Raw<&'_ [f64]> {
    Raw { means: &t[0], rotations: &t[1], log_scales: &t[2], logit_opacities: &t[3], sh: &t[4] }
}

#[test]
fn activations_and_slopes_agree_with_the_twin() {
    for (count, coefficients) in [(1, 1), (255, 4), (256, 16), (2_000, 16), (2_000, 25), (300, 0)] {
        let mut tensors = tensors(count as u64, count, coefficients);
        poison(&mut tensors);
        // Each tensor is perturbed separately, because an ulp would mask an input that is at a limit.
        let plain = opacities_cpu(inputs(&tensors));
        let masked: Vec<bool> = plain.iter().map(|opacity| *opacity == 0.0).collect();
        assert!(count < 100 || (masked.iter().any(|m| *m) && masked.iter().any(|m| !*m)));
        let logits = PerturbedReference::new(&tensors[3..4], |moved| {
            let sigmoid = |x: &f64| if *x < 0.0 { x.exp() / (1.0 + x.exp()) } else { 1.0 / (1.0 + (-x).exp()) };
            let opacities = moved[0].iter().zip(&masked).map(|(x, masked)| if *masked { 0.0 } else { sigmoid(x) });
            let opacities: Vec<f64> = opacities.collect();
            let slopes = opacity_slopes_cpu(&moved[0], &opacities);
            vec![opacities, slopes]
        });
        // The twin is the reference; the closure above repeats it so that logits can move.
        assert_eq!(logits.expected[0], plain);
        let scales = PerturbedReference::new(&[rounded(&tensors[2])], |moved| vec![scales_cpu(&moved[0])]);
        let at_limit: Vec<Option<u8>> =
            tensors[2].iter().map(|log| (*log != 88.0).then_some(scale_class(*log))).collect();
        // Opacities have one class, because all lie between 0 and 1; slopes one per power of e.
        let one = vec![Some(0); count];
        let by_size: Vec<Option<u8>> = tensors[3].iter().map(|logit| Some(scale_class(-logit.abs()))).collect();
        for (form, gpu) in gpus() {
            let what = format!("{count} Gaussians of {coefficients} coefficients, {form}");
            let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&tensors[i]));
            let device = Raw {
                means: buffer(0),
                rotations: buffer(1),
                log_scales: buffer(2),
                logit_opacities: buffer(3),
                sh: buffer(4),
            };
            let (together, opacities) = launch_activate(&gpu, &device, None);
            let grads = |of_scales: bool, of_opacities: bool| {
                let ones = |wanted: bool, len: usize| wanted.then(|| Buffer::from_slice(&gpu, &vec![1.0; len]));
                let inputs = ActivatedGrads {
                    logit_opacities: device.logit_opacities.clone(),
                    scales: together.clone(),
                    opacities: opacities.clone(),
                    grad_scales: ones(of_scales, 3 * count),
                    grad_opacities: ones(of_opacities, count),
                };
                launch_activate_backward(&gpu, &inputs).map(|grad| grad.map(|grad| grad.read(&gpu)))
            };
            let [Some(of_logs), Some(slopes)] = grads(true, true) else { panic!("{what}: both are asked for") };
            assert!(of_logs == together.read(&gpu), "{what}: scales are their derivatives");
            assert!(grads(true, false) == [Some(of_logs), None], "{what}: of the scales alone");
            assert!(grads(false, true) == [None, Some(slopes.clone())], "{what}: of the opacities alone");
            let opacities = opacities.read(&gpu);
            for (i, (opacity, masked)) in opacities.iter().zip(&masked).enumerate() {
                assert_eq!(opacity.to_bits() == 0, *masked, "{what}: Gaussian {i} is {opacity}");
            }
            logits.check(&what, 0, &opacities, &one);
            logits.check(&what, 1, &slopes, &by_size);
            let found = together.read(&gpu);
            scales.check(&what, 0, &found, &at_limit);
            for (found, expected) in found.iter().zip(&scales.expected[0]) {
                assert!(
                    found.is_finite() && (*found == 0.0) == (*expected as f32 == 0.0),
                    "{what}: {found}, {expected}"
                );
            }
        }
    }
}

/// Class of an exponential by its size: each is compared with those of similar size.
fn scale_class(log: f64) -> u8 {
    if log.is_finite() { (log.clamp(-100.0, 100.0) / 4.0 + 30.0) as u8 } else { 0 }
}

#[test]
fn a_number_that_is_not_finite_is_found_wherever_it_is() {
    let Some(gpu) = gpu() else { return };
    for len in [1, 255, 257, 65_535, 65_536, 65_537, 200_001] {
        let mut values = vec![1.0_f32; len];
        values[len / 3] = f32::MAX;
        let found = |values: &[f32]| launch_non_finite(&gpu, &Buffer::from_slice(&gpu, values)).read(&gpu)[0];
        assert_eq!(found(&values), 0, "{len}");
        for (at, bad) in [(0, f32::NAN), (len / 2, f32::INFINITY), (len - 1, f32::NEG_INFINITY)] {
            let kept = std::mem::replace(&mut values[at], bad);
            assert_eq!(found(&values), 1, "{bad} at {at} of {len}");
            values[at] = kept;
        }
    }
}

#[test]
fn a_mark_of_zero_keeps_the_coefficients_unread() {
    let count = 300;
    let mut tensors = tensors(1, count, 4);
    tensors[4][12 * 7 + 5] = f64::NAN;
    for (form, gpu) in gpus() {
        let buffer = |i: usize| Buffer::from_slice(&gpu, &to_f32(&tensors[i]));
        let device = Raw {
            means: buffer(0),
            rotations: buffer(1),
            log_scales: buffer(2),
            logit_opacities: buffer(3),
            sh: buffer(4),
        };
        let opacity = |mark: Option<u32>| {
            let mark = mark.map(|mark| Buffer::from_slice(&gpu, &[mark]));
            launch_activate(&gpu, &device, mark.as_ref()).1.read(&gpu)[7]
        };
        assert!(opacity(Some(0)) > 0.0, "{form}: the coefficients were read");
        assert_eq!([opacity(Some(1)), opacity(None)], [0.0; 2], "{form}: an unusable coefficient was not found");
    }
}

/// The gradients of logits, of which opacities and their gradients are given.
fn of_opacities(gpu: &Gpu, [logits, opacities, grad]: [&[f32]; 3]) -> Vec<f32> {
    let buffer = |values: &[f32]| Buffer::from_slice(gpu, values);
    let inputs = ActivatedGrads {
        logit_opacities: buffer(logits),
        scales: Buffer::new(gpu, 3 * logits.len()),
        opacities: buffer(opacities),
        grad_scales: None,
        grad_opacities: Some(buffer(grad)),
    };
    launch_activate_backward(gpu, &inputs)[1].as_ref().expect("it is asked for").read(gpu)
}

#[test]
fn the_gradient_of_a_logit_is_the_slope_times_the_gradient() {
    let (logits, opacities) = ([0.0_f32, 2.0, -3.0, f32::NAN, 1.0], [0.5_f32, 0.88, 0.047, 0.0, 0.0]);
    let grad = [2.0_f32, -1.0, f32::NAN, f32::INFINITY, 3.0];
    let slope = |x: f64| x.exp() / (1.0 + x.exp()).powi(2);
    for (form, gpu) in gpus() {
        let found = of_opacities(&gpu, [&logits, &opacities, &grad]);
        for (found, expected) in found.iter().zip([2.0 * slope(0.0), -slope(2.0)]) {
            assert!((f64::from(*found) - expected).abs() <= 1e-6, "{form}: {found} instead of {expected}");
        }
        // A gradient that is not finite passes, for the guard to see.
        assert!(found[2].is_nan() && found[3].is_nan() && found[4] == 0.0, "{form}: {found:?}");
    }
}

#[test]
fn nothing_is_activated() {
    let Some(gpu) = gpu() else { return };
    let empty = || Buffer::from_slice(&gpu, &[] as &[f32]);
    let device = Raw { means: empty(), rotations: empty(), log_scales: empty(), logit_opacities: empty(), sh: empty() };
    let (scales, opacities) = launch_activate(&gpu, &device, None);
    assert!(scales.read(&gpu).is_empty() && opacities.read(&gpu).is_empty());
    assert!(of_opacities(&gpu, [&[]; 3]).is_empty());
    assert_eq!(launch_non_finite(&gpu, &empty()).read(&gpu), [0]);
}
