//! Compares the step with its equations in f64, and the verdict with its rules.

use std::panic::{AssertUnwindSafe, catch_unwind};

use burn::tensor::{DType, Int, Tensor};

use super::launch::{DeviceStep, launch_adam, launch_watch};
use super::packed::{PackedFactors, PackedStep, step_packed};
use super::{Band, Factors, Rates, Stepped, VERDICT};
use crate::gpu::{Buffer, Gpu};
use crate::testing::ceiling::{PerturbedReference, rounded, to_f32};
use crate::testing::gpu::{device, gpus};
use crate::testing::random::Random;

const RATES: Rates = Rates { first: 0.06, others: 3e-3, width: 3 };
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

fn on_device(gpu: &Gpu, tensors: &[Vec<f64>], band: Option<Band>) -> DeviceStep {
    let [param, grad, m, v] = [0, 1, 2, 3].map(|i| Buffer::from_slice(gpu, &to_f32(&tensors[i])));
    DeviceStep { param, m, v, grad, factors: FACTORS, band }
}

fn read(gpu: &Gpu, step: &DeviceStep) -> [Vec<f32>; 3] {
    [&step.param, &step.m, &step.v].map(|buffer| buffer.read(gpu))
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
                let state = on_device(&gpu, &tensors, *band);
                launch_adam(&gpu, &[&state], *verdict, None);
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
        let state = on_device(&gpu, &tensors, None);
        launch_adam(&gpu, &[&state], None, None);
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
        let state = on_device(&gpu, &tensors, None);
        let before = read(&gpu, &state);
        let verdict = Buffer::from_slice(&gpu, &[7_u32, 1]);
        let mark = Buffer::from_slice(&gpu, &[0_u32]);
        launch_adam(&gpu, &[&state, &state], Some(&verdict), Some(&mark));
        assert!(read(&gpu, &state) == before, "{form}: a step that was to be held back changed something");
        assert_eq!(mark.read(&gpu), [1], "{form}: nobody looked at the coefficients");
    }
}

#[test]
fn steps_together_are_the_steps_alone() {
    let (counts, band) = ([300, 1, 4_001], Some(Band { period: 12, width: 3 }));
    let mut tensors = counts.map(tensors);
    // The borders of the parameters move too.
    tensors.iter_mut().for_each(|tensors| tensors[1][0] = 0.01);
    for (form, gpu) in gpus() {
        let steps = || [0, 1, 2].map(|i| on_device(&gpu, &tensors[i], if i == 1 { None } else { band }));
        let alone = steps();
        alone.iter().for_each(|step| launch_adam(&gpu, &[step], None, None));
        for together in 2..=3 {
            let steps = steps();
            let refs: Vec<&DeviceStep> = steps[..together].iter().collect();
            launch_adam(&gpu, &refs, None, None);
            for (i, (step, alone)) in refs.iter().zip(&alone).enumerate() {
                assert!(read(&gpu, step) == read(&gpu, alone), "{form}: parameter {i} of {together}");
            }
        }
    }
}

#[test]
fn the_mark_is_set_by_an_unusable_number_of_the_second_parameter() {
    let (plain, count) = (tensors(300), 700);
    for (form, gpu) in gpus() {
        let marked = |first: f64, second: f64, at: usize| {
            let mut tensors = [plain.clone(), tensors(count)];
            tensors[0][0][5] = first;
            tensors[1][0][at] = second;
            let [one, two] = tensors.map(|tensors| on_device(&gpu, &tensors, None));
            let mark = Buffer::from_slice(&gpu, &[0_u32]);
            launch_adam(&gpu, &[&one, &two], None, Some(&mark));
            mark.read(&gpu)[0]
        };
        assert_eq!(marked(1.0, 1.0, 0), 0, "{form}");
        assert_eq!(marked(f64::NAN, 1e18, 0), 0, "{form}");
        for (at, bad) in [(0, f64::NAN), (count - 1, f64::INFINITY), (300, f64::NEG_INFINITY), (255, -2e18)] {
            assert_eq!(marked(1.0, bad, at), 1, "{form}: {bad} at {at}");
        }
    }
}

#[test]
fn a_verdict_names_the_first_step_and_all_that_was_wrong_in_it() {
    for count in [1, 256, 70_000, 1_200_001] {
        let sound = vec![1.5_f32; count];
        let bad = |value: f32, at: usize| {
            let mut values = sound.clone();
            values[at] = value;
            values
        };
        // The step, the place of the values among those that are looked at, the values, and the verdict.
        let looks = [
            (1, 0, sound.clone(), [0, 0]),
            (2, 3, bad(f32::MAX, 0), [0, 0]),
            (2, 1, bad(f32::NAN, count - 1), [2, 0b10]),
            (2, 2, sound.clone(), [2, 0b10]),
            (2, 4, bad(f32::NEG_INFINITY, count / 2), [2, 0b1_0010]),
            (2, 5, bad(f32::INFINITY, count / 3), [2, 0b11_0010]),
            (3, 0, bad(f32::INFINITY, 0), [2, 0b11_0010]),
        ];
        for (form, gpu) in gpus() {
            let verdict = Buffer::from_slice(&gpu, &[0_u32; VERDICT]);
            let one = Buffer::from_slice(&gpu, &[1.5_f32]);
            for (at_step, place, values, expected) in &looks {
                let values = Buffer::from_slice(&gpu, values);
                let loss = if *place == 0 { &values } else { &one };
                let gradients = std::array::from_fn(|i| match i + 1 {
                    here if here == *place => Some(values.clone()),
                    // An absent gradient, and an empty one.
                    2 => None,
                    3 => Some(Buffer::new(&gpu, 0)),
                    _ => Some(one.clone()),
                });
                launch_watch(&gpu, loss, &gradients, &verdict, *at_step, 0);
                assert_eq!(verdict.read(&gpu), expected, "{count}, {form}, step {at_step}, place {place}");
            }
        }
    }
}

/// Kernels read the tensors of a parameter by one length, unchecked.
#[test]
fn tensors_of_another_parameter_are_refused() {
    let Some(device) = device() else { return };
    let zeros = |rows: usize| Tensor::<2>::zeros([rows, 3], &device);
    let plain = |[grad, m, v]: [usize; 3]| {
        let from = Stepped { param: zeros(4), m: zeros(m), v: zeros(v) };
        drop(super::step(from, &zeros(grad), None, FACTORS));
    };
    let packed = |grad: usize, shape: [usize; 2]| {
        let words: Tensor<2, Int> = Tensor::zeros(shape, (&device, DType::I32));
        let factors = PackedFactors { factors: FACTORS, step: 1 };
        drop(step_packed(PackedStep { param: zeros(4), words }, &zeros(grad), None, factors));
    };
    let refused = |work: &dyn Fn()| catch_unwind(AssertUnwindSafe(work)).is_err();
    assert!(!refused(&|| plain([4, 4, 4])) && !refused(&|| packed(4, [4, 2])));
    for other in [[3, 4, 4], [4, 5, 4], [4, 4, 1]] {
        assert!(refused(&|| plain(other)), "{other:?}");
    }
    for (grad, words) in [(5, [4, 2]), (4, [3, 2]), (4, [4, 3])] {
        assert!(refused(&|| packed(grad, words)), "{grad}, {words:?}");
    }
}
