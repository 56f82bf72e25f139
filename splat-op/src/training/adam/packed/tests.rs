//! What a code keeps, and steps with packed moments against the step in f32.

use super::cpu::{decode, encode};
use super::*;
use crate::adam::{Band, Rates};
use crate::testing::random::Random;

pub(super) fn factors(step: u32) -> PackedFactors {
    let rate = Rates { first: 0.06, others: 3e-3, width: 3 };
    let factors = Factors { beta1: 0.9, beta2: 0.999, rate, floor: 1e-15, largest: 1e17 };
    PackedFactors { factors, step }
}

/// A parameter with rows of a width and its moments, as one array.
struct Parameter {
    param: Vec<f32>,
    words: Vec<i32>,
    width: usize,
}

impl Parameter {
    fn new(rows: usize, width: usize) -> Self {
        Self { param: vec![0.5; rows * width], words: vec![0; rows * words_per_row(width)], width }
    }

    fn step(&mut self, grad: &[f32], of: &PackedFactors, band: Option<Band>) {
        let state = HostState { param: &mut self.param, grad, words: &mut self.words };
        step_on_host(state, self.width, band, of);
    }
}

#[test]
fn moments_come_back_within_a_code() {
    let mut random = Random::new(1);
    let reach = factors(1).reach() as f32;
    let (of_v, of_m) = (0.5_f64.powi(FRACTION_BITS as i32), 2.0 / f64::from(LARGEST_LEVEL));
    for _ in 0..20_000 {
        let v = 2.0_f64.powf(random.between(-89.0, 36.0)) as f32;
        let m = (random.between(-2.29, 2.29) * f64::from(v).sqrt()) as f32;
        let threshold = random.between(0.0, f64::from(u32::MAX)) as u32;
        let (found_m, found_v) = decode(encode(m, v, reach, threshold), reach);
        let error = f64::from(found_v) / f64::from(v) - 1.0;
        assert!(error.abs() <= of_v, "{v} became {found_v}");
        // Between two levels, `q²` changes by `2q + 1`.
        let [ratio, found] = [m, found_m].map(|m| f64::from(m.abs()) / (f64::from(reach) * f64::from(found_v).sqrt()));
        assert!((ratio - found).abs() <= of_m * ratio.sqrt() + 0.25 * of_m * of_m + 1e-5, "{m} became {found_m}");
        assert!(found_m == 0.0 || found_m.signum() == m.signum());
    }
}

/// A code that is decoded and encoded again stays the same where the threshold is a half, and zero is the code 0.
#[test]
fn a_code_is_a_fixed_point() {
    let reach = factors(1).reach() as f32;
    assert_eq!((encode(0.0, 0.0, reach, u32::MAX), decode(0, reach)), (0, (0.0, 0.0)));
    for second in (1..=LARGEST_SECOND).step_by(7) {
        for level in 0..=LARGEST_LEVEL {
            let code = second | level << SECOND_BITS | u32::from(level % 2 == 1) << (CODE_BITS - 1);
            let (m, v) = decode(code, reach);
            // Subnormal numbers may count as zero. The lower bits are the threshold of `m`.
            if v >= f32::MIN_POSITIVE {
                assert_eq!(encode(m, v, reach, 0x800), code, "{m} {v}");
            }
        }
    }
}

#[test]
fn numbers_without_range_are_held_within_it() {
    let reach = factors(1).reach() as f32;
    for (m, v) in [(1e18, 1e37), (f32::NAN, f32::NAN), (-f32::INFINITY, f32::INFINITY), (1e-30, 1e-44), (1.0, 0.0)] {
        let (m, v) = decode(encode(m, v, reach, u32::MAX), reach);
        assert!(m.is_finite() && v.is_finite() && v >= 0.0, "{m} {v}");
    }
}

/// Without gradients `v` falls nearly as in f32, by a thousandth of it per step, though no code is that close to the next. Thresholds
/// that follow one another are spread evenly, so that a rounding depends on the one before: `v` falls a tenth faster.
#[test]
fn the_second_moment_decays_at_its_rate() {
    let mut of = Parameter::new(1_000, 3);
    of.step(&vec![1e-3; 3_000], &factors(1), None);
    let none = vec![0.0; 3_000];
    (2..=1_001).for_each(|step| of.step(&none, &factors(step), None));
    let per_word = CODES_PER_WORD as usize;
    let code = |i: usize| {
        let (row, k) = (i / 3, i % 3);
        let word = of.words[row * words_per_row(3) + k / per_word] as u32;
        word >> (CODE_BITS * (k % per_word) as u32) & u32::MAX >> (32 - CODE_BITS)
    };
    let mean = (0..3_000).map(|i| f64::from(decode(code(i), 1.0).1)).sum::<f64>() / 3_000.0;
    let expected = 1e-6 * 0.999_f64.powi(1_000);
    assert!((mean / expected - 1.0).abs() < 0.13, "{mean} instead of {expected}");
}

/// Returns the parameters after steps by noise around a common slope, in f64 and packed.
fn walk(steps: u32) -> (Vec<f64>, Vec<f32>) {
    let (count, mut random) = (4_800, Random::new(3));
    let mut of = Parameter::new(count / 48, 48);
    let (mut exact, mut m, mut v) = (vec![0.5_f64; count], vec![0.0; count], vec![0.0; count]);
    for step in 1..=steps {
        let grad: Vec<f32> = (0..count).map(|i| (random.between(-1.0, 1.2) * 1e-4 * (1.0 + i as f64)) as f32).collect();
        let of_step = factors(step);
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
    let (exact, found) = walk(600);
    let way = exact.iter().map(|x| (x - 0.5).powi(2)).sum::<f64>().sqrt();
    let apart = exact.iter().zip(&found).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>().sqrt();
    assert!(apart <= 0.2 * way, "{} of the way", apart / way);
}

#[test]
fn nothing_moves_without_gradients_and_huge_ones_take_bounded_steps() {
    let mut of = Parameter::new(5, 3);
    of.step(&[0.0; 15], &factors(1), None);
    assert_eq!((of.param, of.words.iter().all(|word| *word == 0)), (vec![0.5; 15], true));
    let mut of = Parameter::new(5, 3);
    for step in 1..=50 {
        let before = of.param.clone();
        of.step(&[f32::INFINITY; 15], &factors(step), None);
        assert!(of.param.iter().zip(before).all(|(a, b)| (a - b).abs() <= 3e-3 * 2.9));
    }
}

/// Rows of any width, in any number of tasks, take the steps that their numbers take alone, with the rate of their column.
#[test]
fn rows_are_independent_of_their_width_and_of_tasks() {
    let band = Some(Band { period: 9, width: 3 });
    let (mut wide, mut random) = (Parameter::new(4_000, 9), Random::new(5));
    let grad: Vec<f32> = (0..36_000).map(|_| random.between(-1.0, 1.0) as f32).collect();
    wide.step(&grad, &factors(1), band);
    // The first step has the length of its rate.
    for (i, (after, grad)) in wide.param.iter().zip(&grad).enumerate() {
        let rate = if i % 9 < 3 { 0.06 } else { 3e-3 };
        assert!((after - (0.5 - rate * grad.signum())).abs() < 1e-6, "{i}");
    }
    let (mut wide, mut flat) = (Parameter::new(4_000, 9), Parameter::new(36_000, 1));
    (1..5).for_each(|step| {
        wide.step(&grad, &factors(step), None);
        flat.step(&grad, &factors(step), None);
    });
    assert!(wide.param == flat.param);
}
