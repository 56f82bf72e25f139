//! Inputs of the loss, its window, and the constants of the index.

use crate::record::record;

/// Number of taps of the window along each axis.
pub const TAPS: usize = 11;
/// Number of taps on one side of the middle.
pub(super) const HALF: usize = TAPS / 2;
/// Standard deviation of the window, px.
pub const SIGMA_PX: f64 = 1.5;
/// `(0.01 L)²` for the dynamic range `L` = 1: keeps the ratio of means defined where both are black.
pub const C1: f64 = 1e-4;
/// `(0.03 L)²`: keeps the ratio of variances defined where both are flat.
pub const C2: f64 = 9e-4;

/// Returns half of the window's taps, from the middle outwards. The whole window sums to one.
pub(super) fn half_window() -> [f64; HALF + 1] {
    let weight = |i: usize| (-(i as f64).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp();
    let sum: f64 = weight(0) + 2.0 * (1..=HALF).map(weight).sum::<f64>();
    std::array::from_fn(|i| weight(i) / sum)
}

record! {
    /// A picture, the photograph that it is compared with, and the photograph's mean and variance. Each is `[.., H, W]`.
    pub(crate) struct Compared {
        /// The picture.
        image,
        /// The photograph.
        truth,
        /// `μy` of the photograph.
        mean,
        /// `σy² + C2` of the photograph.
        variance,
    }
}
