//! The loss of 3D Gaussian splatting.

use burn::tensor::Tensor;

use super::ssim::{Truth, planes};
use super::with_gradient;

/// Share of D-SSIM in [`photometric`] in the original implementation and all its successors.
pub const DEFAULT_LAMBDA: f64 = 0.2;

/// `(1 − λ) · L1 + λ · (1 − SSIM)`, `[1]` (Kerbl et al. 2023, eq. 7).
///
/// `image` is `[H, W, C]`, 0 to 1, and may be tracked; `lambda` is 0 to 1, usually [`DEFAULT_LAMBDA`]. One operation computes
/// the value and the gradient (see [`splat_op::loss`]), so `backward` costs one elementwise product. The value equals
/// `l1(..) * (1 − λ) + (1 − ssim(..)) * λ`, tensor code that can be composed differently.
///
/// The subgradient at `image = truth` is 0, as for [`super::l1()`].
pub fn photometric(image: Tensor<3>, truth: &Truth, lambda: f64) -> Tensor<1> {
    let variable = planes(image);
    let (value, gradient) = truth.loss(&variable.clone().inner(), lambda, variable.is_tracked());
    match gradient {
        Some(gradient) => with_gradient(variable, value, gradient),
        None => value,
    }
}
