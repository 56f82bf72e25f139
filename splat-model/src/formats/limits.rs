//! Values at the limits of their ranges, which converters write: the logits of opacities 0 and 1 are infinite, and so is the logarithm of a
//! thickness of 0. They count as finite numbers with the same effect in f32. Other values, NaN among them, stay as they are.

use super::opacity::logit_of;

/// A logit of an opacity in a file.
pub(crate) fn logit(logit: f32) -> f32 {
    if logit.is_infinite() { logit_of(if logit > 0.0 { 1.0 } else { 0.0 }) } else { logit }
}

/// The logarithm of a standard deviation in a file.
pub(crate) fn log_scale(log: f32) -> f32 {
    if log == f32::NEG_INFINITY { log_of(0.0) } else { log }
}

/// The logarithm of a standard deviation. Zero, which has none, counts as the least normal float.
pub(super) fn log_of(scale: f32) -> f32 {
    // Comparison keeps NaN.
    if scale <= f32::MIN_POSITIVE { f32::MIN_POSITIVE.ln() } else { scale.ln() }
}

#[cfg(test)]
mod tests;
