//! What a code keeps, and steps with packed moments against the step in f32.

use super::cpu::{decode, encode};
use super::*;
use crate::adam::{Band, Rates};
use crate::testing::random::Random;

const BOTH: [Packing; 2] = [Packing::Sixteen, Packing::Eight];

pub(super) fn factors(packing: Packing, step: u32) -> PackedFactors {
    let rate = Rates { first: 0.06, others: 3e-3, width: 3 };
    let factors = Factors { beta1: 0.9, beta2: 0.999, rate, floor: 1e-15, largest: 1e17 };
    PackedFactors { factors, packing, step }
}

/// A parameter with rows of a width and its moments, as one array.
struct Parameter {
    param: Vec<f32>,
    words: Vec<i32>,
    width: usize,
}

impl Parameter {
    fn new(rows: usize, width: usize, packing: Packing) -> Self {
        Self { param: vec![0.5; rows * width], words: vec![0; rows * packing.words_per_row(width)], width }
    }

    fn step(&mut self, grad: &[f32], of: &PackedFactors, band: Option<Band>) {
        let state = HostState { param: &mut self.param, grad, words: &mut self.words };
        step_on_host(state, self.width, band, of);
    }
}

#[test]
fn moments_come_back_within_a_code() {
    let mut random = Random::new(1);
    for packing in BOTH {
        let (form, reach) = (packing.form(), factors(packing, 1).reach() as f32);
        let (of_v, of_m) = (0.5_f64.powi(form.fraction as i32), 2.0 / f64::from(form.largest_level()));
        for _ in 0..20_000 {
            let v = 2.0_f64.powf(random.between(-89.0, 36.0)) as f32;
            let m = (random.between(-2.29, 2.29) * f64::from(v).sqrt()) as f32;
            let threshold = random.between(0.0, f64::from(u32::MAX)) as u32;
            let (found_m, found_v) = decode(form, encode(form, m, v, reach, threshold), reach);
            let error = f64::from(found_v) / f64::from(v) - 1.0;
            assert!(error.abs() <= of_v, "{packing:?}: {v} became {found_v}");
            // Between two levels, `q²` changes by `2q + 1`.
            let [ratio, found] =
                [m, found_m].map(|m| f64::from(m.abs()) / (f64::from(reach) * f64::from(found_v).sqrt()));
            assert!(
                (ratio - found).abs() <= of_m * ratio.sqrt() + 0.25 * of_m * of_m + 1e-5,
                "{packing:?}: {m} became {found_m}"
            );
            assert!(found_m == 0.0 || found_m.signum() == m.signum());
        }
    }
}

/// A code that is decoded and encoded again stays the same where the threshold is a half, and zero is the code 0.
#[test]
fn a_code_is_a_fixed_point() {
    for packing in BOTH {
        let (form, reach) = (packing.form(), factors(packing, 1).reach() as f32);
        assert_eq!((encode(form, 0.0, 0.0, reach, u32::MAX), decode(form, 0, reach)), (0, (0.0, 0.0)));
        for second in (1..=form.largest_second()).step_by(7) {
            for level in (0..=form.largest_level()).step_by(if packing == Packing::Eight { 1 } else { 97 }) {
                let code = second | level << form.second | u32::from(level % 2 == 1) << (form.code - 1);
                let (m, v) = decode(form, code, reach);
                // Subnormal numbers may count as zero. The lower bits are the threshold of `m`.
                if v >= f32::MIN_POSITIVE {
                    assert_eq!(encode(form, m, v, reach, 0x800), code, "{packing:?}: {m} {v}");
                }
            }
        }
    }
}

#[test]
fn numbers_without_range_are_held_within_it() {
    for packing in BOTH {
        let (form, reach) = (packing.form(), factors(packing, 1).reach() as f32);
        for (m, v) in [(1e18, 1e37), (f32::NAN, f32::NAN), (-f32::INFINITY, f32::INFINITY), (1e-30, 1e-44), (1.0, 0.0)]
        {
            let (m, v) = decode(form, encode(form, m, v, reach, u32::MAX), reach);
            assert!(m.is_finite() && v.is_finite() && v >= 0.0, "{packing:?}: {m} {v}");
        }
    }
}

/// Without gradients `v` falls nearly as in f32, by a thousandth of it per step, though no code is that close to the next. Thresholds
/// that follow one another are spread evenly, so that a rounding depends on the one before: in 8 bits `v` falls a tenth faster.
#[test]
fn the_second_moment_decays_at_its_rate() {
    for packing in BOTH {
        let mut of = Parameter::new(1_000, 3, packing);
        of.step(&vec![1e-3; 3_000], &factors(packing, 1), None);
        let none = vec![0.0; 3_000];
        (2..=1_001).for_each(|step| of.step(&none, &factors(packing, step), None));
        let (form, per_word) = (packing.form(), packing.form().codes_per_word() as usize);
        let code = |i: usize| {
            let (row, k) = (i / 3, i % 3);
            let word = of.words[row * packing.words_per_row(3) + k / per_word] as u32;
            word >> (form.code * (k % per_word) as u32) & u32::MAX >> (32 - form.code)
        };
        let mean = (0..3_000).map(|i| f64::from(decode(form, code(i), 1.0).1)).sum::<f64>() / 3_000.0;
        let expected = 1e-6 * 0.999_f64.powi(1_000);
        let bound = if packing == Packing::Eight { 0.13 } else { 0.005 };
        assert!((mean / expected - 1.0).abs() < bound, "{packing:?}: {mean} instead of {expected}");
    }
}

/// Returns the parameters after steps by noise around a common slope, in f64 and packed.
fn walk(packing: Packing, steps: u32) -> (Vec<f64>, Vec<f32>) {
    let (count, mut random) = (4_800, Random::new(3));
    let mut of = Parameter::new(count / 48, 48, packing);
    let (mut exact, mut m, mut v) = (vec![0.5_f64; count], vec![0.0; count], vec![0.0; count]);
    for step in 1..=steps {
        let grad: Vec<f32> = (0..count).map(|i| (random.between(-1.0, 1.2) * 1e-4 * (1.0 + i as f64)) as f32).collect();
        let of_step = factors(packing, step);
        of.step(&grad, &of_step, None);
        for i in 0..count {
            let g = f64::from(grad[i]);
            m[i] = 0.9 * m[i] + g;
            v[i] = 0.999 * v[i] + g * g;
            exact[i] -= of_step.factors.rate.others * m[i] / (v[i].sqrt() + 1e-15);
        }
    }
    (exact, of.param)
}

#[test]
fn steps_follow_those_in_f32() {
    for (packing, bound) in [(Packing::Sixteen, 0.02), (Packing::Eight, 0.2)] {
        let (exact, found) = walk(packing, 600);
        let way = exact.iter().map(|x| (x - 0.5).powi(2)).sum::<f64>().sqrt();
        let apart = exact.iter().zip(&found).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>().sqrt();
        assert!(apart <= bound * way, "{packing:?}: {} of the way", apart / way);
    }
}

#[test]
fn nothing_moves_without_gradients_and_huge_ones_take_bounded_steps() {
    for packing in BOTH {
        let mut of = Parameter::new(5, 3, packing);
        of.step(&[0.0; 15], &factors(packing, 1), None);
        assert_eq!((of.param, of.words.iter().all(|word| *word == 0)), (vec![0.5; 15], true));
        let mut of = Parameter::new(5, 3, packing);
        for step in 1..=50 {
            let before = of.param.clone();
            of.step(&[f32::INFINITY; 15], &factors(packing, step), None);
            assert!(of.param.iter().zip(before).all(|(a, b)| (a - b).abs() <= 3e-3 * 2.9), "{packing:?}");
        }
    }
}

/// Rows of any width, in any number of tasks, take the steps that their numbers take alone, with the rate of their column.
#[test]
fn rows_are_independent_of_their_width_and_of_tasks() {
    let band = Some(Band { period: 9, width: 3 });
    for packing in BOTH {
        let (mut wide, mut random) = (Parameter::new(4_000, 9, packing), Random::new(5));
        let grad: Vec<f32> = (0..36_000).map(|_| random.between(-1.0, 1.0) as f32).collect();
        wide.step(&grad, &factors(packing, 1), band);
        // The first step has the length of its rate.
        for (i, (after, grad)) in wide.param.iter().zip(&grad).enumerate() {
            let rate = if i % 9 < 3 { 0.06 } else { 3e-3 };
            assert!((after - (0.5 - rate * grad.signum())).abs() < 1e-6, "{packing:?}, {i}");
        }
        let (mut wide, mut flat) = (Parameter::new(4_000, 9, packing), Parameter::new(36_000, 1, packing));
        (1..5).for_each(|step| {
            wide.step(&grad, &factors(packing, step), None);
            flat.step(&grad, &factors(packing, step), None);
        });
        assert!(wide.param == flat.param, "{packing:?}");
    }
}
