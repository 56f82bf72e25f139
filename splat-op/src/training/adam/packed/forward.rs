//! The kernel of the step with packed moments: one unit per word.

use cubecl::prelude::*;

use super::Form;
use crate::adam::forward::StepFactors;
use crate::adam::rule::Band;
use crate::gpu::math::clamped;

/// The parts of a launch that are known when the kernel is compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct RowForm {
    pub form: Form,
    /// Numbers of a row.
    pub width: usize,
    pub band: Option<Band>,
}

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
fn second_of(code: u32, #[comptime] form: Form) -> f32 {
    let bits = (code + comptime!(form.base)) << comptime!(form.dropped());
    f32::reinterpret(select(code == 0, 0u32, bits))
}

/// Performs the step of the number `index` in place, and returns the code of its moments.
#[cube]
fn step_code(
    param: &mut [f32],
    gradient: f32,
    index: u32,
    code: u32,
    rate: f32,
    scalars: PackedScalars,
    #[comptime] form: Form,
) -> u32 {
    let factors = scalars.factors;
    let most = comptime!(form.largest_level() as f32);
    let stored = second_of(code & comptime!((1u32 << form.second) - 1), form);
    let share = f32::cast_from((code >> comptime!(form.second)) & comptime!(form.largest_level())) / most;
    let size = share * share * scalars.reach * stored.sqrt();
    let before = select(code >> comptime!(form.code - 1) == 0, size, -size);

    let first = before * factors.beta1 + gradient;
    let second = stored * factors.beta2 + gradient * gradient;
    param[index as usize] -= first / (second.sqrt() + factors.floor) * rate;

    let mixed = index * 0x9e37_79b1u32;
    let mixed = (mixed ^ (mixed >> 15)) * 0x85eb_ca77u32;
    let threshold = (mixed ^ (mixed >> 13)) + scalars.phase;
    let rounded = u32::reinterpret(second) + (threshold >> comptime!(32 - form.dropped()));
    let upper = rounded >> comptime!(form.dropped());
    let above = select(upper > comptime!(form.base), upper - comptime!(form.base), 0u32);
    let kept = min(above, comptime!(form.largest_second()));
    let root = second_of(kept, form).sqrt();
    let ratio = first.abs() / select(kept == 0, 1.0f32, root * scalars.reach);
    let squared = select(kept == 0, 0.0f32, min(ratio, 1.0) * (most * most));
    let low = squared.sqrt().floor();
    let part = f32::cast_from(threshold & 0xfff) / 4096.0;
    let next = select(squared - low * low > part * (2.0 * low + 1.0), low + 1.0, low);
    let level = min(u32::cast_from(next), comptime!(form.largest_level()));
    let sign = select(level == 0, 0u32, u32::reinterpret(first) >> 31);
    kept | (level << comptime!(form.second)) | (sign << comptime!(form.code - 1))
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
    #[comptime] of: RowForm,
) {
    let mut runs = ABSOLUTE_POS < count as usize;
    #[comptime]
    if let ComptimeOption::Some(verdict) = &verdict {
        runs = runs && verdict[0] == 0;
    }
    if runs {
        let factors = scalars.factors;
        let (form, width) = comptime!((of.form, of.width as u32));
        let per_word = comptime!(form.codes_per_word());
        let of_row = comptime!(width.div_ceil(per_word));
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
                if comptime!(of.band.is_some()) {
                    let (period, first) =
                        comptime!(of.band.map_or((1, 0), |band| (band.period as u32, band.width as u32)));
                    rate = select(index % period < first, factors.rate_of_first, factors.rate);
                }
                let shift = comptime!(form.code * i);
                let code = (word >> shift) & comptime!(u32::MAX >> (32 - form.code));
                let gradient = clamped(grad[index as usize], factors.largest);
                packed |= step_code(param, gradient, index, code, rate, scalars, form) << shift;
            }
        }
        words[ABSOLUTE_POS] = packed;
    }
}
