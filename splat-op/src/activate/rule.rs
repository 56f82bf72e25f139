//! What is usable, and what is looked at to know it.

use crate::record::record;

/// The largest absolute value of a usable coordinate or colour coefficient: its square, and sums of many of those, are f32
/// values. No scene that can be seen is that large.
pub const LARGEST: f64 = 1e18;

/// The largest usable logarithm of a standard deviation: `exp(88)` is 1.7e38, half of the largest f32.
pub const LARGEST_LOG_SCALE: f64 = 88.0;

record! {
    /// Parameters as an optimiser holds them; see [`RawSplats`](crate::RawSplats).
    pub struct Raw {
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
