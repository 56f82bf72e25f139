//! Opacities in eight bits.

use crate::gaussians::sigmoid;

/// The level of a logit: 255 times the opacity, rounded.
pub(super) fn level(logit: f32) -> u8 {
    (255.0 * sigmoid(logit)).round() as u8
}

/// The logit of a level. The first and the last level count as a quarter of a level inside the range, because their own logits
/// are infinite.
pub(super) fn logit(level: u8) -> f32 {
    let level = f64::from(level).clamp(0.25, 254.75);
    (level / (255.0 - level)).ln() as f32
}

/// The logit of an opacity from 0 to 1. The logits of 0 and 1 are infinite: they count as the least normal float, and as the middle between 1
/// and the float below it. NaN stays NaN.
pub(super) fn logit_of(opacity: f32) -> f32 {
    let opacity = f64::from(opacity).clamp(f64::from(f32::MIN_POSITIVE), 1.0 - 0.25 * f64::from(f32::EPSILON));
    (opacity / (1.0 - opacity)).ln() as f32
}
