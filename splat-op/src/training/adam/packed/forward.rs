//! The kernel of the step with packed moments: one unit per word.

use cubecl::prelude::*;

use super::{BASE, CODE_BITS, CODES_PER_WORD, DROPPED, LARGEST_LEVEL, LARGEST_SECOND, SECOND_BITS};
use crate::adam::forward::StepFactors;
use crate::adam::rule::Band;
use crate::gpu::clamped;

/// The scalars of one step.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct PackedScalars {
    pub factors: StepFactors,
    pub reach: f32,
    pub phase: u32,
}

/// The stored `v`.
#[cube]
fn second_of(code: u32) -> f32 {
    let bits = (code + comptime!(BASE)) << comptime!(DROPPED);
    f32::reinterpret(select(code == 0, 0u32, bits))
}

/// Performs the step of the number `index` in place, and returns the code of its moments.
#[cube]
fn step_code(param: &mut [f32], gradient: f32, index: u32, code: u32, rate: f32, scalars: PackedScalars) -> u32 {
    let factors = scalars.factors;
    let most = comptime!(LARGEST_LEVEL as f32);
    let stored = second_of(code & comptime!((1u32 << SECOND_BITS) - 1));
    let share = f32::cast_from((code >> comptime!(SECOND_BITS)) & comptime!(LARGEST_LEVEL)) / most;
    let size = share * share * scalars.reach * stored.sqrt();
    let before = select(code >> comptime!(CODE_BITS - 1) == 0, size, -size);

    let first = before * factors.beta1 + gradient;
    let second = stored * factors.beta2 + gradient * gradient;
    param[index as usize] -= first / (second.sqrt() + factors.floor) * rate;

    let mixed = index * 0x9e37_79b1u32;
    let mixed = (mixed ^ (mixed >> 15)) * 0x85eb_ca77u32;
    let threshold = (mixed ^ (mixed >> 13)) + scalars.phase;
    let rounded = u32::reinterpret(second) + (threshold >> comptime!(32 - DROPPED));
    let upper = rounded >> comptime!(DROPPED);
    let above = select(upper > comptime!(BASE), upper - comptime!(BASE), 0u32);
    let kept = min(above, comptime!(LARGEST_SECOND));
    let root = second_of(kept).sqrt();
    let ratio = first.abs() / select(kept == 0, 1.0f32, root * scalars.reach);
    let squared = select(kept == 0, 0.0f32, min(ratio, 1.0) * (most * most));
    let low = squared.sqrt().floor();
    let part = f32::cast_from(threshold & 0xfff) / 4096.0;
    let next = select(squared - low * low > part * (2.0 * low + 1.0), low + 1.0, low);
    let level = min(u32::cast_from(next), comptime!(LARGEST_LEVEL));
    let sign = select(level == 0, 0u32, u32::reinterpret(first) >> 31);
    kept | (level << comptime!(SECOND_BITS)) | (sign << comptime!(CODE_BITS - 1))
}

/// Performs one step of a parameter whose moments are in `count` words, unless the verdict names a step.
#[cube(launch_unchecked)]
pub(super) fn adam_packed_kernel(
    param: &mut [f32],
    grad: &[f32],
    words: &mut [u32],
    verdict: ComptimeOption<Box<[u32]>>,
    scalars: PackedScalars,
    count: u32,
    #[comptime] width: u32,
    #[comptime] band: Option<Band>,
) {
    let mut runs = ABSOLUTE_POS < count as usize;
    #[comptime]
    if let ComptimeOption::Some(verdict) = &verdict {
        runs = runs && verdict[0] == 0;
    }
    if runs {
        let factors = scalars.factors;
        let per_word = comptime!(CODES_PER_WORD);
        let of_row = comptime!(width.div_ceil(CODES_PER_WORD));
        let at = ABSOLUTE_POS as u32;
        let (row, place) = (at / of_row, at % of_row);
        let word = words[ABSOLUTE_POS];
        let mut packed = 0u32;
        #[unroll]
        for i in 0..per_word {
            let column = place * per_word + i;
            if column < width {
                let index = row * width + column;
                let mut rate = factors.rate;
                if comptime!(band.is_some()) {
                    let (period, first) =
                        comptime!(band.map_or((1, 0), |band| (band.period as u32, band.width as u32)));
                    rate = select(index % period < first, factors.rate_of_first, factors.rate);
                }
                let shift = comptime!(CODE_BITS * i);
                let code = (word >> shift) & comptime!(u32::MAX >> (32 - CODE_BITS));
                let gradient = clamped(grad[index as usize], factors.largest);
                packed |= step_code(param, gradient, index, code, rate, scalars) << shift;
            }
        }
        words[ABSOLUTE_POS] = packed;
    }
}
