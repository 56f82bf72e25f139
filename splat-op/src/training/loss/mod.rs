//! L1 loss and structural dissimilarity of a picture against a photograph, with the gradient.
//!
//! `splat-model` has the loss of 3D Gaussian splatting as tensor code. That code is twelve convolutions and forty
//! passes over the picture, with those of autodiff on top, and takes most of a training step (on a software driver 1.7
//! of 2.0 s). This operation computes the same loss in two sweeps on a CPU and four passes on a GPU: the window is
//! separable, and a strip of pixels in registers can be filtered, multiplied and differentiated at once.
//!
//! With `K` the window (11 × 11 taps, σ = 1.5 px, zero outside), the index of Wang et al. 2004, eq. 13, is `S = A1 A2 / (B1 B2)`,
//! `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`, where `μx = Kx`, `σx² = Kx² − μx²`, `σxy = Kxy − μx μy`.
//!
//! Variances are differences of moments, which lose the digits that both share. So the moments here are not squares but
//! `P = K x(1 − x)` and `Q = K (x(1 − y) + y(1 − x))`, with `σx² = μx(1 − μx) − P` and `2 σxy = μx(1 − μy) + μy(1 − μx) − Q`.
//! They are at most ¼ and 1, vanish where both pictures are black or white, and are zero outside the picture like `x` and `y`.
//!
//! Near the border of a white picture `1 − μ` is the share `o` of the window beyond the border, of which `μ` in f32 leaves few digits. What
//! `μ` lost is known, because rounding of the same sums turned the window of ones, `1 − o`, into `w`. So `1 − μ` is computed as
//! `(1 − μ) + e μ` with the excess `e = ((w − 1) + o) / w`: as exact for white as for black, and zero inside the picture.
//!
//! The derivatives are those with respect to `Kx²` and `Kxy`, which cancel nothing where the pictures are black. As `K` is its own adjoint,
//! `∂S/∂x = K ∂μx + 2 x K ∂Kx² + y K ∂Kxy`, `∂Kxy = 2 A1/(B1 B2)`, `∂Kx² = −S/B2`, `∂μx = 2 μy (A2 − A1)/(B1 B2) + 2 μx S (1/B2 − 1/B1)`.
//!
//! Shapes: all tensors are `[.., H, W]`, of at least two dimensions, with values 0 to 1.

mod border;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
pub(crate) mod sweep;
pub(crate) mod taps;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;
use taps::Compared;
pub use taps::{C1, C2, SIGMA_PX, TAPS};

use crate::backend::{Slot, apply};
use crate::check::Reference;
use crate::error::Result;

/// Computes the loss of `image` against a photograph, `[.., H, W]` f32, or f64 on CPUs, without autodiff. Returns
/// the loss and, if `with_gradient` is set, its gradient.
///
/// `photograph` is the photograph, its mean `μy` and its variance `σy² + C2`, all of the shape of the picture; `lambda`
/// weighs the dissimilarity.
///
/// # Errors
/// If shapes, float types or devices differ, or if the float type has no kernel.
pub fn photometric<const D: usize>(
    image: &Tensor<D>,
    photograph: [&Tensor<D>; 3],
    lambda: f64,
    with_gradient: bool,
) -> Result<(Tensor<1>, Option<Tensor<D>>)> {
    let reference = checked("image", image)?;
    for (name, planes) in ["truth", "mean", "variance"].into_iter().zip(photograph) {
        reference.check(name, planes, image.dims().map(Some), "that of the picture")?;
    }
    let [truth, mean, variance] = photograph.map(Slot::from);
    let inputs = Compared { image: image.into(), truth, mean, variance };
    let mut found = apply(operation::Photometric { lambda, with_gradient }, inputs.into_array());
    Ok((found.float(0), with_gradient.then(|| found.float(1))))
}

/// Returns the mean `μy` and the variance `σy² + C2` of a photograph's planes, `[.., H, W]` f32, or f64 on CPUs, without autodiff: what
/// [`photometric`] takes besides the planes.
///
/// # Errors
/// If the float type has no kernel.
pub fn moments<const D: usize>(photograph: &Tensor<D>) -> Result<[Tensor<D>; 2]> {
    checked("photograph", photograph)?;
    let mut found = apply(operation::PhotographMoments, [photograph.into()]);
    Ok([0, 1].map(|i| found.float(i)))
}

/// Takes the float type and device of planes, `[.., H, W]`.
fn checked<const D: usize>(name: &'static str, planes: &Tensor<D>) -> Result<Reference> {
    const { assert!(D >= 2, "a picture has rows and columns") };
    Reference::new(name, planes)
}

/// Returns the planes contiguous in memory. Planes that every step reads need not be rearranged at every step.
///
/// # Errors
/// If the float type has no kernel.
pub fn contiguous<const D: usize>(planes: &Tensor<D>) -> Result<Tensor<D>> {
    checked("planes", planes)?;
    Ok(apply(operation::Contiguous, [planes.into()]).float(0))
}
