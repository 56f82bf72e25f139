//! Compares the step with its equations in f64, and the verdict with its rules.

use super::launch::{DeviceState, launch_adam, launch_watch};
use super::{Band, Factors, Rates, VERDICT};
use crate::gpu::{Buffer, Gpu};
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::gpus;
use crate::testing::random::Random;

const RATES: Rates = Rates { first: 0.06, others: 3e-3 };
const FACTORS: Factors = Factors { beta1: 0.9, beta2: 0.999, rate: RATES, floor: 1e-15, largest: 1e17 };

/// Parameter, gradient and moments after some steps, in f32 precision; every seventh row has zero moments and gradient.
fn tensors(count: usize) -> Vec<Vec<f64>> {
    let mut random = Random::new(count as u64);
    let mut all: Vec<Vec<f64>> =
        [(-2.0, 2.0), (-1e-2, 1e-2), (-3e-2, 3e-2), (1e-6, 1e-3)].map(|(a, b)| random.fill(count, a, b)).to_vec();
    for row in (0..count).step_by(7) {
        (1..4).for_each(|tensor| all[tensor][row] = 0.0);
    }
    all.iter().map(|tensor| rounded(tensor)).collect()
}

/// Returns the parameter and moments by the equations.
fn step(inputs: &[Vec<f64>], band: Option<Band>) -> Vec<Vec<f64>> {
    let rows = 0..inputs[0].len();
    let gradient = |i: usize| inputs[1][i].clamp(-FACTORS.largest, FACTORS.largest);
    let rate = |i: usize| match band {
        Some(Band { period, width }) if i % period < width => RATES.first,
        _ => RATES.others,
    };
    let m: Vec<f64> = rows.clone().map(|i| FACTORS.beta1 * inputs[2][i] + gradient(i)).collect();
    let v: Vec<f64> = rows.clone().map(|i| FACTORS.beta2 * inputs[3][i] + gradient(i).powi(2)).collect();
    let param = rows.map(|i| inputs[0][i] - rate(i) * m[i] / (v[i].sqrt() + FACTORS.floor)).collect();
    vec![param, m, v]
}

fn on_device(gpu: &Gpu, tensors: &[Vec<f64>]) -> (DeviceState, Buffer<f32>) {
    let [param, grad, m, v] = [0, 1, 2, 3].map(|i| Buffer::from_slice(gpu, &to_f32(&tensors[i])));
    (DeviceState { param, m, v }, grad)
}

fn read(gpu: &Gpu, state: &DeviceState) -> [Vec<f32>; 3] {
    [&state.param, &state.m, &state.v].map(|buffer| buffer.read(gpu))
}

#[test]
fn a_step_is_that_of_the_equations() {
    for count in [1, 255, 256, 5_000] {
        let tensors = tensors(count);
        let band = Some(Band { period: 12, width: 3 });
        let references =
            [None, band].map(|band| (band, PerturbedReference::new(&tensors, |inputs| step(inputs, band))));
        for (form, gpu) in gpus() {
            let sound = Buffer::from_slice(&gpu, &[0_u32; VERDICT]);
            let guards = [("without a verdict", None), ("with one", Some(&sound))];
            for ((guard, verdict), (band, reference)) in
                guards.iter().flat_map(|g| references.iter().map(move |y| (g, y)))
            {
                let (state, grad) = on_device(&gpu, &tensors);
                launch_adam(&gpu, &state, &grad, *verdict, &FACTORS, *band);
                for (i, found) in read(&gpu, &state).iter().enumerate() {
                    reference.check(
                        &format!("{count}, {form}, {guard}, {band:?}: {i}"),
                        i,
                        found,
                        &vec![Some(0); count],
                    );
                }
                assert_eq!(read(&gpu, &state)[0][0], tensors[0][0] as f32, "no gradient and no history, yet a step");
            }
        }
    }
}

#[test]
fn gradients_are_held_within_the_largest_and_nan_is_passed_on() {
    let mut tensors = tensors(8);
    for (row, value) in [f64::INFINITY, f64::NEG_INFINITY, 3e17, -3e17, f64::NAN].into_iter().enumerate() {
        tensors[1][row] = value;
    }
    let expected = step(&tensors, None);
    for (form, gpu) in gpus() {
        let (state, grad) = on_device(&gpu, &tensors);
        launch_adam(&gpu, &state, &grad, None, &FACTORS, None);
        for (tensor, found) in read(&gpu, &state).iter().enumerate() {
            for row in 0..4 {
                let (found, expected) = (f64::from(found[row]), expected[tensor][row]);
                assert!(
                    (found - expected).abs() <= 1e-5 * expected.abs(),
                    "{form}: {tensor}, {row}: {found} {expected}"
                );
            }
            assert!(found[4].is_nan(), "{form}: {tensor}: NaN became {}", found[4]);
        }
    }
}

#[test]
fn a_verdict_holds_a_step_back() {
    let tensors = tensors(300);
    for (form, gpu) in gpus() {
        let (state, grad) = on_device(&gpu, &tensors);
        let before = read(&gpu, &state);
        let verdict = Buffer::from_slice(&gpu, &[7_u32, 1]);
        launch_adam(&gpu, &state, &grad, Some(&verdict), &FACTORS, None);
        assert!(read(&gpu, &state) == before, "{form}: a step that was to be held back changed something");
    }
}

#[test]
fn a_verdict_names_the_first_step_and_all_that_was_wrong_in_it() {
    for count in [1, 256, 70_000] {
        let sound = vec![1.5_f32; count];
        let bad = |value: f32, at: usize| {
            let mut values = sound.clone();
            values[at] = value;
            values
        };
        let looks = [
            (1, 0, sound.clone(), [0, 0]),
            (2, 3, bad(f32::MAX, 0), [0, 0]),
            (2, 1, bad(f32::NAN, count - 1), [2, 0b10]),
            (2, 2, sound.clone(), [2, 0b10]),
            (2, 4, bad(f32::NEG_INFINITY, count / 2), [2, 0b1_0010]),
            (3, 0, bad(f32::INFINITY, 0), [2, 0b1_0010]),
        ];
        for (form, gpu) in gpus() {
            let verdict = Buffer::from_slice(&gpu, &[0_u32; VERDICT]);
            for (at_step, bit, values, expected) in &looks {
                launch_watch(&gpu, &Buffer::from_slice(&gpu, values), &verdict, *at_step, *bit);
                assert_eq!(verdict.read(&gpu), expected, "{count}, {form}, step {at_step}, bit {bit}");
            }
        }
    }
}
