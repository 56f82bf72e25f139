//! Activations: unconstrained parameters → scales and opacities for [`crate::render`], with unusable Gaussians masked before
//! anything is computed from them. Differentiable. [`non_finite`] searches for values that are not finite.
//!
//! `scale = exp(log_scale)`, `opacity = 1 / (1 + exp(−logit))` (Kerbl et al. 2023, section 5.1). Tensor code can compute that, but
//! it cannot isolate a Gaussian with invalid values: `exp` of an infinity is infinity, its derivative times a gradient of exactly
//! zero is NaN, and a NaN among the colour coefficients goes unnoticed until it is in the picture.
//!
//! A Gaussian is **usable** if
//!
//! - every parameter is finite,
//! - centre and colour coefficients are at most [`LARGEST`] in absolute value, so that their squares are finite too,
//! - logarithms of standard deviations are at most [`LARGEST_LOG_SCALE`], so that their exponentials are finite,
//! - its quaternion is not zero (any other length is normalised).
//!
//! An unusable Gaussian gets opacity 0: `intersect` then lists it nowhere, and it has no effect. Its gradients are exactly zero, including
//! those through `exp` and the sigmoid. An unusable logarithm of a standard deviation gives 0 for that standard deviation.
//!
//! Derivatives: `d scale = scale · d log_scale`; `d opacity = e / (1 + e)² · d logit` with `e = exp(−|logit|)`, which stays accurate
//! where `opacity (1 − opacity)` loses digits.
//!
//! Shapes: centres `[N, 3]`, quaternions `[N, 4]`, logarithms of standard deviations `[N, 3]`, logits `[N]`, coefficients
//! `[N, K, 3]` → standard deviations `[N, 3]`, opacities `[N]`.

pub(crate) mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
pub(crate) mod rule;
mod tensors;
#[cfg(test)]
mod tests;

use burn::tensor::{Int, Tensor};

pub use rule::{LARGEST, LARGEST_LOG_SCALE};

use crate::backend::apply;
use crate::check::Reference;
use crate::{Result, is_tensor_code};

/// Gaussians with unconstrained parameters, one row each, all of one float type and on one device.
#[derive(Clone, Debug)]
pub struct RawSplats {
    /// `[N, 3]`: centres, world frame, scene units.
    pub means: Tensor<2>,
    /// `[N, 4]`: quaternions wxyz, world-from-Gaussian.
    pub rotations: Tensor<2>,
    /// `[N, 3]`: natural logarithms of the standard deviations along the rotated axes, scene units.
    pub log_scales: Tensor<2>,
    /// `[N]`: logits of the opacities.
    pub logit_opacities: Tensor<1>,
    /// `[N, K, 3]`: colour coefficients. Here they are only checked for usability.
    pub sh: Tensor<3>,
}

/// Computes standard deviations `[N, 3]`, scene units, and opacities `[N]`, 0 to 1 (Kerbl et al. 2023, section 5.1). An unusable logarithm
/// of a standard deviation gives 0 with a gradient of 0, and a Gaussian with an unusable parameter an opacity of exactly 0. Differentiable
/// in the logarithms and the logits. `mark`, `[1]`, may come from [`crate::adam::step_groups`]: if it is zero, all coefficients are known
/// to be usable, and a GPU does not read them.
///
/// # Errors
/// If a tensor's shape, type or device does not fit.
pub fn activated(raw: &RawSplats, mark: Option<&Tensor<1, Int>>) -> Result<(Tensor<2>, Tensor<1>)> {
    let reference = Reference::new("means", &raw.means)?;
    let count = raw.means.dims()[0];
    reference.check("means", &raw.means, [None, Some(3)], "[N, 3]")?;
    reference.check("rotations", &raw.rotations, [Some(count), Some(4)], "[N, 4]")?;
    reference.check("log_scales", &raw.log_scales, [Some(count), Some(3)], "[N, 3]")?;
    reference.check("logit_opacities", &raw.logit_opacities, [Some(count)], "[N]")?;
    reference.check("sh", &raw.sh, [Some(count), None, Some(3)], "[N, K, 3]")?;
    if is_tensor_code() {
        return Ok(tensors::activated(raw));
    }
    let RawSplats { means, rotations, log_scales, logit_opacities, sh } = raw;
    let inputs = [means.into(), rotations.into(), log_scales.into(), logit_opacities.into(), sh.into(), mark.into()];
    let mut found = apply(operation::Activated, inputs);
    Ok((found.float(0), found.float(1)))
}

/// Searches for values that are not finite: returns `[1]`, 1 if any of `values` is not finite, else 0. Not differentiable.
///
/// Reading the result waits for the device; tensor code on it does not.
pub fn non_finite<const D: usize>(values: &Tensor<D>) -> Tensor<1, Int> {
    let values = values.clone().inner();
    if is_tensor_code() { tensors::non_finite(values) } else { apply(operation::NonFinite, [values.into()]).int(0) }
}

/// Returns whether a Gaussian is usable by the rule of [this module](self), from its parameters on the host. `sh` holds all its
/// colour coefficients, in any order.
pub fn is_usable<'a>(
    mean: &[f32; 3],
    rotation: &[f32; 4],
    log_scale: &[f32; 3],
    logit_opacity: f32,
    sh: impl IntoIterator<Item = &'a [f32]>,
) -> bool {
    let geometry = cpu::usable_geometry(mean, rotation, log_scale, logit_opacity);
    geometry && sh.into_iter().all(cpu::bounded)
}
