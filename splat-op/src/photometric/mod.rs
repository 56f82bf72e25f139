//! L1 and structural dissimilarity of a picture against a photograph, with the derivative.
//!
//! The loss of 3D Gaussian splatting can be written as tensor code like any other, and `splat-model` has it as such. But that
//! code is twelve convolutions and forty passes over the picture, with autodiff's on top, most of a training step (on a
//! software driver 1.7 of 2.0 s). This operation computes the same in two sweeps on a CPU and four passes on a GPU: the
//! window is separable, and whoever has a strip of pixels in registers can filter it, multiply it and differentiate it at once.
//!
//! With `K` the window (11 × 11 taps, σ = 1.5 px, zero outside), the index of Wang et al. 2004, eq. 13, is
//! `S = A1 A2 / (B1 B2)`, `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`, where
//! `μx = Kx`, `σx² = Kx² − μx²`, `σxy = Kxy − μx μy`. As `K` is its own adjoint,
//! `∂S/∂x = K ∂μx + 2 x K ∂Kx² + y K ∂Kxy`, `∂Kxy = 2 A1/(B1 B2)`, `∂Kx² = −S/B2`,
//! `∂μx = 2 μy (A2 − A1)/(B1 B2) + 2 μx S (1/B2 − 1/B1)`.
//!
//! Shapes: everything is `[.., H, W]`, of at least two dimensions, values 0 to 1.

mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod launch;
mod op;
#[cfg(test)]
mod tests;

pub use op::{Photometric, PhotometricBackend, PhotometricInputs, contiguous, photometric, window};

/// Taps of the window along each axis.
pub const TAPS: usize = 11;
/// Standard deviation of the window, px.
pub const SIGMA_PX: f64 = 1.5;
/// `(0.01 L)²` for the dynamic range `L` = 1: keeps the ratio of means defined where both are black.
pub const C1: f64 = 1e-4;
/// `(0.03 L)²`: keeps the ratio of variances defined where both are flat.
pub const C2: f64 = 9e-4;

/// Half the window, from the middle outwards; the whole sums to one.
fn half_window() -> [f64; TAPS / 2 + 1] {
    let weight = |i: usize| (-(i as f64).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp();
    let sum: f64 = weight(0) + 2.0 * (1..=TAPS / 2).map(weight).sum::<f64>();
    std::array::from_fn(|i| weight(i) / sum)
}
