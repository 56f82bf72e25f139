//! Kernels of `activate`: one unit per number, or per Gaussian if the result depends on whole rows. Finiteness is tested by bits,
//! because shader compilers may assume that NaN does not occur.

use cubecl::prelude::*;

use super::rule::{LARGEST, LARGEST_LOG_SCALE};
use crate::gpu::{finite, own_values_finite};

/// Exponent below which `exp` is less than the smallest subnormal f32.
const SMALLEST_EXPONENT: f32 = -110.0;

/// Bits of [`LARGEST`]. The bits of absolute values of floats sort as the values do, with infinity and NaN above all finite values.
const LARGEST_BITS: u32 = (LARGEST as f32).to_bits();

/// Whether a coordinate or colour coefficient is usable.
#[cube]
pub(crate) fn bounded(value: f32) -> bool {
    (u32::reinterpret(value) & 0x7fff_ffff) <= comptime!(LARGEST_BITS)
}

#[cube]
fn usable_log_scale(log_scale: f32) -> bool {
    finite(log_scale) && log_scale <= comptime!(LARGEST_LOG_SCALE as f32)
}

/// Returns the standard deviation of a logarithm; zero if the logarithm is not usable.
#[cube]
fn scale_of(log_scale: f32, usable: bool) -> f32 {
    // Unusable values are replaced before the computation.
    let scale = max(select(usable, log_scale, 0.0), SMALLEST_EXPONENT).exp();
    select(usable, scale, 0.0)
}

/// Computes standard deviations and opacities. The coefficients, most of a Gaussian's data, are read only where the mark, `[1]`,
/// does not say that all of them are usable.
#[cube(launch_unchecked)]
pub(super) fn activate_kernel(
    means: &[f32],
    rotations: &[Vector<f32, Const<4>>],
    log_scales: &[f32],
    logit_opacities: &[f32],
    sh: &[f32],
    mark: ComptimeOption<Box<[u32]>>,
    scales: &mut [f32],
    opacities: &mut [f32],
    count: u32,
    sh_row: u32,
) {
    let gaussian = ABSOLUTE_POS;
    if gaussian < count as usize {
        let logit = logit_opacities[gaussian];
        let mut usable = finite(logit);
        #[unroll]
        for axis in 0..3 {
            let log_scale = log_scales[3 * gaussian + axis];
            let usable_scale = usable_log_scale(log_scale);
            usable = usable && bounded(means[3 * gaussian + axis]) && usable_scale;
            scales[3 * gaussian + axis] = scale_of(log_scale, usable_scale);
        }
        let rotation = rotations[gaussian];
        let mut turned = 0u32;
        #[unroll]
        for component in 0..4usize {
            let value = rotation.extract(component);
            usable = usable && finite(value);
            turned |= u32::reinterpret(value);
        }
        usable = usable && (turned & 0x7fff_ffff) != 0;
        let mut unread = true;
        #[comptime]
        if let ComptimeOption::Some(mark) = mark {
            unread = mark[0] != 0;
        }
        if unread {
            let row = sh_row as usize;
            for k in 0..row {
                usable = usable && bounded(sh[row * gaussian + k]);
            }
        }
        let x = select(usable, logit, 0.0);
        let e = max(-x.abs(), SMALLEST_EXPONENT).exp();
        let opacity = select(x < 0.0, e, 1.0) / (1.0 + e);
        opacities[gaussian] = select(usable, opacity, 0.0);
    }
}

/// Writes the gradients of the logarithms and of the logits, each if it is asked for: the derivatives times the gradients of scales and
/// opacities. Scales equal their derivatives, and are zero where the logarithm was unusable.
#[cube(launch_unchecked)]
pub(super) fn activate_backward_kernel(
    logit_opacities: &[f32],
    scales: &[f32],
    opacities: &[f32],
    grad_scales: ComptimeOption<Box<[f32]>>,
    grad_opacities: ComptimeOption<Box<[f32]>>,
    mut grad_logs: ComptimeOption<Box<[f32]>>,
    mut grad_logits: ComptimeOption<Box<[f32]>>,
    count: u32,
    #[comptime] _given: u32,
) {
    let gaussian = ABSOLUTE_POS;
    if gaussian < count as usize {
        #[comptime]
        if let (ComptimeOption::Some(grad), ComptimeOption::Some(out)) = (&grad_scales, &mut grad_logs) {
            #[unroll]
            for axis in 0..3 {
                out[3 * gaussian + axis] = scales[3 * gaussian + axis] * grad[3 * gaussian + axis];
            }
        }
        #[comptime]
        if let (ComptimeOption::Some(grad), ComptimeOption::Some(out)) = (&grad_opacities, &mut grad_logits) {
            let shown = opacities[gaussian] > 0.0;
            let e = max(-select(shown, logit_opacities[gaussian], 0.0).abs(), SMALLEST_EXPONENT).exp();
            let sum = 1.0 + e;
            out[gaussian] = select(shown, e / (sum * sum), 0.0) * grad[gaussian];
        }
    }
}

/// Sets the flag if any of this unit's values, `stride` apart, is not finite. If all values are finite, no unit writes.
#[cube(launch_unchecked)]
pub(super) fn non_finite_kernel(values: &[f32], flag: &[Atomic<u32>], count: u32, stride: u32) {
    if !own_values_finite(values, count, stride) {
        flag[0].fetch_or(1u32);
    }
}
