//! L1 and structural dissimilarity of a picture against a photograph, with the derivative, on GPUs.
//!
//! The loss of 3D Gaussian splatting is tensor code like any other, and on CPU backends it stays that. On a GPU that code is
//! twelve convolutions and forty passes over the picture, most of a training step (on a software driver 1.7 of 2.0 s), so
//! there this operation computes the same in four: the window is separable, and whoever has a strip of pixels in registers
//! can filter it, multiply it and differentiate it at once.
//!
//! With `K` the window (11 × 11 taps, σ = 1.5 px, zero outside), the index of Wang et al. 2004, eq. 13, is
//! `S = A1 A2 / (B1 B2)`, `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`, where
//! `μx = Kx`, `σx² = Kx² − μx²`, `σxy = Kxy − μx μy`. As `K` is its own adjoint,
//! `∂S/∂x = K ∂μx + 2 x K ∂Kx² + y K ∂Kxy`, `∂Kxy = 2 A1/(B1 B2)`, `∂Kx² = −S/B2`,
//! `∂μx = 2 μy (A2 − A1)/(B1 B2) + 2 μx S (1/B2 − 1/B1)`.
//!
//! Shapes: everything is `[.., H, W]`, of at least two dimensions, values 0 to 1.

#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod launch;
#[cfg(feature = "cube")]
mod op;

use burn::tensor::Tensor;

#[cfg(feature = "cube")]
pub use op::{Photometric, PhotometricBackend, PhotometricInputs};

/// Taps of the window along each axis.
pub const TAPS: usize = 11;
/// Standard deviation of the window, px.
pub const SIGMA_PX: f64 = 1.5;
/// `(0.01 L)²` for the dynamic range `L` = 1: keeps the ratio of means defined where both are black.
pub const C1: f64 = 1e-4;
/// `(0.03 L)²`: keeps the ratio of variances defined where both are flat.
pub const C2: f64 = 9e-4;

/// The loss of `image` against a photograph, `[.., H, W]` f32 without autodiff: the shares whose sum it is, and its
/// derivative if asked for. `None` on devices that have no such operation: compute it with tensor code there.
///
/// The photograph is given by itself, its mean `μy` and its variance `σy² + C2`; `lambda` weighs the dissimilarity.
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
pub fn photometric<const D: usize>(
    image: &Tensor<D>,
    photograph: [&Tensor<D>; 3],
    lambda: f64,
    with_gradient: bool,
) -> Option<(Tensor<D>, Option<Tensor<D>>)> {
    #[cfg(feature = "cube")]
    if taken(image) {
        return Some(op::photometric(image, photograph, lambda, with_gradient));
    }
    None
}

/// `Kx` of planes `[.., H, W]` f32 without autodiff. `None` as for [`photometric()`].
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
pub fn window<const D: usize>(planes: &Tensor<D>) -> Option<Tensor<D>> {
    #[cfg(feature = "cube")]
    if taken(planes) {
        return Some(op::window(planes));
    }
    None
}

/// The same values, one after the other in memory: what is read at every step should not be put in order at every step.
/// `None` as for [`photometric()`].
#[cfg_attr(not(feature = "cube"), expect(unused_variables, reason = "no GPU runtime is compiled in"))]
pub fn contiguous<const D: usize>(planes: &Tensor<D>) -> Option<Tensor<D>> {
    #[cfg(feature = "cube")]
    if taken(planes) {
        return Some(op::contiguous(planes));
    }
    None
}

/// Whether the operations take this tensor.
#[cfg(feature = "cube")]
fn taken<const D: usize>(tensor: &Tensor<D>) -> bool {
    use burn::backend::DispatchDevice;
    matches!(tensor.device().as_dispatch(), DispatchDevice::Cube(_)) && tensor.dtype() == burn::tensor::DType::F32
}
