//! The CPU twin of `activate`, generic over the float, parallel over chunks of Gaussians.

use fearless_simd::prelude::*;

use super::rule::{LARGEST, LARGEST_LOG_SCALE, Raw};
use crate::simd::{ROW_BLOCK, Real, dispatch, each, map_lanes};
use crate::tasks;

/// Number of Gaussians per task.
const CHUNK: usize = 1024;

/// Whether all values are finite and their squares are too. It has no branch, so that it is vectorised: it reads every
/// coefficient of a scene.
#[inline(always)]
pub(crate) fn bounded<F: Real>(values: &[F]) -> bool {
    values.iter().fold(true, |all, value| all & (value.abs() <= F::of(LARGEST)))
}

#[inline(always)]
fn usable_log_scale<F: Real>(log_scale: F) -> bool {
    log_scale.finite() & (log_scale <= F::of(LARGEST_LOG_SCALE))
}

/// Whether all parameters of a Gaussian except its colour are usable.
#[inline(always)]
pub(crate) fn usable_geometry<F: Real>(mean: &[F], rotation: &[F], log_scale: &[F], logit: F) -> bool {
    let turned = rotation.iter().any(|c| *c != F::ZERO) && rotation.iter().all(|c| c.finite());
    bounded(mean) && turned && log_scale.iter().all(|value| usable_log_scale(*value)) && logit.finite()
}

/// `[N, 3]` standard deviations.
pub(crate) fn scales_cpu<F: Real>(log_scales: &[F]) -> Vec<F> {
    let mut scales = vec![F::ZERO; log_scales.len()];
    tasks::for_each(scales.chunks_mut(3 * CHUNK).zip(log_scales.chunks(3 * CHUNK)), |_, (scales, logs)| {
        dispatch!(F, simd => scales_chunk(simd, logs, scales));
    });
    scales
}

#[inline(always)]
fn scales_chunk<S: Simd, F: Real>(simd: S, logs: &[F], scales: &mut [F]) {
    let [zero, least, largest] = each!([F::ZERO, -F::MAX, F::of(LARGEST_LOG_SCALE)], |v| F::Lanes::<S>::splat(simd, v));
    map_lanes(
        simd,
        [logs],
        scales,
        #[inline(always)]
        |[log]| {
            let usable = log.simd_ge(least) & log.simd_le(largest);
            usable.select(F::exp_lanes(log), zero)
        },
    );
}

#[inline(always)]
fn rows_of<F>(values: &[F], first: usize, count: usize, columns: usize) -> &[F] {
    &values[columns * first..columns * (first + count)]
}

/// `[N]` opacities.
pub(crate) fn opacities_cpu<F: Real>(inputs: Raw<&[F]>) -> Vec<F> {
    let mut opacities = vec![F::ZERO; inputs.logit_opacities.len()];
    tasks::for_each(opacities.chunks_mut(CHUNK), |chunk, out| {
        dispatch!(F, simd => opacities_chunk(simd, &inputs, chunk * CHUNK, out));
    });
    opacities
}

#[inline(always)]
fn opacities_chunk<S: Simd, F: Real>(simd: S, inputs: &Raw<&[F]>, first: usize, out: &mut [F]) {
    let count = inputs.logit_opacities.len();
    let coefficients = inputs.sh.len() / count.max(1);
    let [zero, one] = each!([F::ZERO, F::ONE], |value| F::Lanes::<S>::splat(simd, value));
    map_lanes(
        simd,
        [rows_of(inputs.logit_opacities, first, out.len(), 1)],
        out,
        #[inline(always)]
        |[logit]| {
            // The exponent is never positive, so nothing overflows.
            let e = F::exp_lanes(-logit.abs());
            logit.simd_lt(zero).select(e, one) / (e + one)
        },
    );
    for (block, out) in out.chunks_mut(ROW_BLOCK).enumerate() {
        let (first, count) = (first + block * ROW_BLOCK, out.len());
        let turned = |rotation: &[F]| rotation.iter().any(|c| *c != F::ZERO);
        let (means, rotations) = (rows_of(inputs.means, first, count, 3), rows_of(inputs.rotations, first, count, 4));
        let log_scales = rows_of(inputs.log_scales, first, count, 3);
        let logits = rows_of(inputs.logit_opacities, first, count, 1);
        let sh = rows_of(inputs.sh, first, count, coefficients);
        // Almost always all Gaussians are usable, and none needs a check of its own.
        let all = bounded(sh)
            & bounded(means)
            & log_scales.iter().fold(true, |all, value| all & usable_log_scale(*value))
            & rotations.iter().chain(logits).fold(true, |all, value| all & value.finite())
            & rotations.chunks_exact(4).all(turned);
        if all {
            continue;
        }
        for (i, out) in out.iter_mut().enumerate() {
            let one = |values, columns| rows_of(values, i, 1, columns);
            let geometry = usable_geometry(one(means, 3), one(rotations, 4), one(log_scales, 3), logits[i]);
            if !(geometry & bounded(one(sh, coefficients))) {
                *out = F::ZERO;
            }
        }
    }
}

/// `[N]` derivatives of the opacities with respect to their logits; zero for an opacity of zero, whether masked or underflowed.
pub(crate) fn opacity_slopes_cpu<F: Real>(logit_opacities: &[F], opacities: &[F]) -> Vec<F> {
    let mut slopes = vec![F::ZERO; opacities.len()];
    let chunks = slopes.chunks_mut(CHUNK).zip(logit_opacities.chunks(CHUNK)).zip(opacities.chunks(CHUNK));
    tasks::for_each(chunks, |_, ((slopes, logits), opacities)| {
        dispatch!(F, simd => slopes_chunk(simd, [logits, opacities], slopes));
    });
    slopes
}

#[inline(always)]
fn slopes_chunk<S: Simd, F: Real>(simd: S, inputs: [&[F]; 2], slopes: &mut [F]) {
    let [zero, one] = each!([F::ZERO, F::ONE], |value| F::Lanes::<S>::splat(simd, value));
    map_lanes(
        simd,
        inputs,
        slopes,
        #[inline(always)]
        |[logit, opacity]| {
            let e = F::exp_lanes(-logit.abs());
            let sum = e + one;
            opacity.simd_gt(zero).select(e / (sum * sum), zero)
        },
    );
}

/// Whether all values are finite.
pub(crate) fn all_finite_cpu<F: Real>(values: &[F]) -> bool {
    // Large enough to hide the cost of scheduling, small enough to balance the load.
    const VALUES: usize = 16_384;
    let finite =
        tasks::map(values.chunks(VALUES), |_, chunk| chunk.iter().fold(true, |all, value| all & value.finite()));
    finite.into_iter().all(|all| all)
}
