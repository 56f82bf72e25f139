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
