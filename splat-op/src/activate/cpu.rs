//! The CPU twin of `activate`, generic over the float, parallel over chunks of Gaussians.

use rayon::prelude::*;

use super::{LARGEST, LARGEST_LOG_SCALE};
use crate::real::Real;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Borrowed inputs, row-major.
#[derive(Clone, Copy)]
pub(crate) struct Inputs<'a, F> {
    pub means: &'a [F],
    pub rotations: &'a [F],
    pub log_scales: &'a [F],
    pub logit_opacities: &'a [F],
    pub sh: &'a [F],
}

/// Whether all values are finite and not too large to be squared. Without a branch, so that it is vectorised: it passes over
/// every coefficient of a scene.
#[inline(always)]
pub(crate) fn bounded<F: Real>(values: &[F]) -> bool {
    values.iter().fold(true, |all, value| all & (value.abs() <= F::of(LARGEST)))
}

#[inline(always)]
fn usable_log_scale<F: Real>(log_scale: F) -> bool {
    log_scale.finite() & (log_scale <= F::of(LARGEST_LOG_SCALE))
}

/// Whether a Gaussian is usable but for its colour.
#[inline(always)]
pub(crate) fn usable_geometry<F: Real>(mean: &[F], rotation: &[F], log_scale: &[F], logit: F) -> bool {
    let turned = rotation.iter().any(|c| *c != F::ZERO) && rotation.iter().all(|c| c.finite());
    bounded(mean) && turned && log_scale.iter().all(|value| usable_log_scale(*value)) && logit.finite()
}

/// `[N, 3]` standard deviations.
pub(crate) fn scales_cpu<F: Real>(log_scales: &[F]) -> Vec<F> {
    let mut scales = vec![F::ZERO; log_scales.len()];
    scales.par_chunks_mut(3 * CHUNK).zip(log_scales.par_chunks(3 * CHUNK)).for_each(|(scales, logs)| {
        for (scale, log) in scales.iter_mut().zip(logs) {
            *scale = if usable_log_scale(*log) { log.exp() } else { F::ZERO };
        }
    });
    scales
}

#[inline(always)]
fn row_of<F>(values: &[F], row: usize, columns: usize) -> &[F] {
    &values[columns * row..columns * (row + 1)]
}

/// `[N]` opacities.
pub(crate) fn opacities_cpu<F: Real>(inputs: Inputs<F>) -> Vec<F> {
    let count = inputs.logit_opacities.len();
    let row = inputs.sh.len() / count.max(1);
    let mut opacities = vec![F::ZERO; count];
    opacities.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
        for (i, out) in out.iter_mut().enumerate() {
            let i = chunk * CHUNK + i;
            let (mean, rotation, log_scale) =
                (row_of(inputs.means, i, 3), row_of(inputs.rotations, i, 4), row_of(inputs.log_scales, i, 3));
            let logit = inputs.logit_opacities[i];
            if usable_geometry(mean, rotation, log_scale, logit) & bounded(row_of(inputs.sh, i, row)) {
                // The exponent is never positive, so nothing overflows.
                let e = (-logit.abs()).exp();
                *out = if logit < F::ZERO { e } else { F::ONE } / (F::ONE + e);
            }
        }
    });
    opacities
}

/// `[N]`: derivatives of the opacities with respect to their logits; zero where an opacity is, masked or faded to nothing.
pub(crate) fn opacity_slopes_cpu<F: Real>(logit_opacities: &[F], opacities: &[F]) -> Vec<F> {
    let slope = |(logit, opacity): (&F, &F)| {
        if !(*opacity > F::ZERO) {
            return F::ZERO;
        }
        let e = (-logit.abs()).exp();
        let sum = F::ONE + e;
        e / (sum * sum)
    };
    logit_opacities.par_iter().zip(opacities).map(slope).collect()
}

/// Whether all values are finite.
pub(crate) fn all_finite_cpu<F: Real>(values: &[F]) -> bool {
    // Large enough to hide the scheduling, small enough to share out evenly and to stop soon.
    const VALUES: usize = 16_384;
    values.par_chunks(VALUES).all(|chunk| chunk.iter().fold(true, |all, value| all & value.finite()))
}
