//! The rule for usable Gaussians and the parameters that it reads.

use crate::record::record;

/// Largest absolute value of a usable coordinate or colour coefficient. Its square, and sums of many such squares, are finite in
/// f32. No real scene is that large.
pub const LARGEST: f64 = 1e18;

/// Largest usable logarithm of a standard deviation: `exp(88)` is 1.7e38, half of the largest f32.
pub const LARGEST_LOG_SCALE: f64 = 88.0;

record! {
    /// Parameters as an optimiser holds them; see [`RawSplats`](crate::RawSplats).
    pub(crate) struct Raw {
        /// `[N, 3]`.
        means,
        /// `[N, 4]`.
        rotations,
        /// `[N, 3]`.
        log_scales,
        /// `[N]`.
        logit_opacities,
        /// `[N, K, 3]`.
        sh,
    }
}
