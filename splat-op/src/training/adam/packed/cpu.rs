//! The CPU twin of the step with packed moments, parallel over rows.

use super::{
    BASE, CODE_BITS, CODES_PER_WORD, DROPPED, LARGEST_LEVEL, LARGEST_SECOND, PackedFactors, SECOND_BITS, words_per_row,
};
use crate::adam::{Band, Rates};
use crate::simd::{dispatch, f32_in_f64};
use crate::tasks;

/// Numbers whose codes are unpacked at a time: their codes fit into the first-level cache.
const CODE_BLOCK: usize = 1024;

/// Blocks of a task.
const BLOCKS_PER_TASK: usize = 16;

/// A parameter, its gradient and its packed moments in host memory.
pub struct HostState<'a> {
    /// The parameter, row-major.
    pub param: &'a mut [f32],
    /// Its gradient.
    pub grad: &'a [f32],
    /// Its moments, see [`super`].
    pub words: &'a mut [i32],
}

/// The scalars in f32.
#[derive(Clone, Copy)]
struct Scalars {
    beta1: f32,
    beta2: f32,
    floor: f32,
    largest: f32,
    reach: f32,
    phase: u32,
}

/// Performs one step of Adam in place on a parameter with rows of `width` numbers. `band` has the first of the two rates.
///
/// # Panics
/// If the lengths do not fit together.
pub fn step_on_host(state: HostState, width: usize, band: Option<Band>, step: &PackedFactors) {
    let HostState { param, grad, words } = state;
    let row_words = words_per_row(width);
    assert_eq!(param.len(), grad.len(), "a gradient has the shape of its parameter");
    assert_eq!(param.len() * row_words, words.len() * width, "each row has its words");
    if param.is_empty() {
        return;
    }
    let factors = step.factors;
    let scalars = Scalars {
        beta1: factors.beta1 as f32,
        beta2: factors.beta2 as f32,
        floor: factors.floor as f32,
        largest: factors.largest as f32,
        reach: step.reach() as f32,
        phase: step.phase(),
    };
    let rows = (CODE_BLOCK / width).max(1);
    let rates = rates(factors.rate, band, width, rows);
    let (numbers, of_words) = (rows * width, rows * row_words);
    let parts = param.chunks_mut(BLOCKS_PER_TASK * numbers).zip(grad.chunks(BLOCKS_PER_TASK * numbers));
    tasks::for_each(parts.zip(words.chunks_mut(BLOCKS_PER_TASK * of_words)), |task, ((param, grad), words)| {
        let blocks = param.chunks_mut(numbers).zip(grad.chunks(numbers)).zip(words.chunks_mut(of_words));
        let mut codes = vec![0; numbers];
        for (block, ((param, grad), words)) in blocks.enumerate() {
            let codes = &mut codes[..param.len()];
            let first = ((task * BLOCKS_PER_TASK + block) * numbers) as u32;
            let numbers = BlockNumbers { param, grad, codes, rates: &rates, first };
            step_block(scalars, numbers, words, width);
        }
    });
}

/// The rate of each number of a block.
fn rates(rate: Rates, band: Option<Band>, width: usize, rows: usize) -> Vec<f32> {
    let of = |at: usize| match band {
        Some(Band { period, width }) if at % period < width => rate.first,
        _ => rate.others,
    };
    (0..rows * width).map(|at| of(at) as f32).collect()
}

/// Whole rows of a parameter.
struct BlockNumbers<'a> {
    param: &'a mut [f32],
    grad: &'a [f32],
    /// Room for the codes of the moments.
    codes: &'a mut [u32],
    rates: &'a [f32],
    /// Index of the first number.
    first: u32,
}

fn step_block(scalars: Scalars, mut block: BlockNumbers, words: &mut [i32], width: usize) {
    unpack(words, block.codes, width);
    if f32_in_f64() {
        step_codes(scalars, &mut block);
    } else {
        dispatch!(f32, simd => {
            let _ = simd;
            step_codes(scalars, &mut block);
        });
    }
    pack(block.codes, words, width);
}

/// The codes of whole rows.
fn unpack(words: &[i32], codes: &mut [u32], width: usize) {
    let per_word = CODES_PER_WORD as usize;
    let mask = u32::MAX >> (32 - CODE_BITS);
    for (codes, words) in codes.chunks_mut(width).zip(words.chunks(words_per_row(width))) {
        for (codes, word) in codes.chunks_mut(per_word).zip(words) {
            codes.iter_mut().enumerate().for_each(|(i, code)| *code = *word as u32 >> (CODE_BITS * i as u32) & mask);
        }
    }
}

/// The inverse of [`unpack`].
fn pack(codes: &[u32], words: &mut [i32], width: usize) {
    let per_word = CODES_PER_WORD as usize;
    for (codes, words) in codes.chunks(width).zip(words.chunks_mut(words_per_row(width))) {
        for (codes, word) in codes.chunks(per_word).zip(words) {
            *word = codes.iter().rev().fold(0, |word, code| word << CODE_BITS | code) as i32;
        }
    }
}

/// Performs the steps of a block of numbers.
#[inline(always)]
fn step_codes(scalars: Scalars, block: &mut BlockNumbers) {
    let BlockNumbers { param, grad, codes, rates, first } = block;
    let Scalars { beta1, beta2, floor, largest, reach, phase } = scalars;
    let count = param.len();
    let (grad, codes, rates) = (&grad[..count], &mut codes[..count], &rates[..count]);
    for i in 0..count {
        let grad = if grad[i].abs() > largest { largest.copysign(grad[i]) } else { grad[i] };
        let (m, v) = decode(codes[i], reach);
        let m = m * beta1 + grad;
        let v = v * beta2 + grad * grad;
        param[i] -= m / (v.sqrt() + floor) * rates[i];
        codes[i] = encode(m, v, reach, threshold(first.wrapping_add(i as u32), phase));
    }
}

/// The threshold of rounding of the number `index`, in units of 2⁻³². The upper bits serve `v`, the lower ones `m`.
#[inline(always)]
fn threshold(index: u32, phase: u32) -> u32 {
    let mixed = index.wrapping_mul(0x9e37_79b1);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x85eb_ca77);
    (mixed ^ (mixed >> 13)).wrapping_add(phase)
}

/// The stored `v`.
#[inline(always)]
fn second_of(code: u32) -> f32 {
    let bits = (code + BASE) << DROPPED;
    f32::from_bits(if code == 0 { 0 } else { bits })
}

#[inline(always)]
pub(super) fn decode(code: u32, reach: f32) -> (f32, f32) {
    let v = second_of(code & ((1 << SECOND_BITS) - 1));
    let level = (code >> SECOND_BITS & LARGEST_LEVEL) as i32 as f32 * (1.0 / LARGEST_LEVEL as f32);
    let m = level * level * reach * v.sqrt();
    (if code >> (CODE_BITS - 1) == 0 { m } else { -m }, v)
}

#[inline(always)]
pub(super) fn encode(m: f32, v: f32, reach: f32, threshold: u32) -> u32 {
    let bits = (v.to_bits() + (threshold >> (32 - DROPPED))) >> DROPPED;
    let second = bits.saturating_sub(BASE).min(LARGEST_SECOND);
    let share = (threshold & 0xfff) as i32 as f32 * (1.0 / 4096.0);
    let most = LARGEST_LEVEL as f32;
    let unit = reach * second_of(second).sqrt();
    let squared = if second == 0 { 0.0 } else { (m.abs() / unit * (most * most)).min(most * most) };
    let low = squared.sqrt().floor();
    let up = squared - low * low > share * (2.0 * low + 1.0);
    let level = (low + if up { 1.0 } else { 0.0 }).min(most) as i32 as u32;
    let sign = if level == 0 { 0 } else { m.to_bits() >> 31 };
    second | level << SECOND_BITS | sign << (CODE_BITS - 1)
}
