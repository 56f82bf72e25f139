//! The loss of 3D Gaussian splatting.

use burn::tensor::Tensor;
use splat_op::is_tensor_code;

use super::ssim::{Truth, planes, ssim};
use super::with_gradient;

/// `mean |image − truth|` over pixels and channels, `[1]`.
///
/// `image` and `truth` are `[H, W, C]`, 0 to 1. The first term of the loss of 3D Gaussian splatting (Kerbl et al. 2023,
/// eq. 7). The derivative at equality is 0.
pub fn l1(image: Tensor<3>, truth: Tensor<3>) -> Tensor<1> {
    (image - truth).abs().mean()
}

/// `1 − SSIM`, `[1]`, of `image` `[H, W, C]`, 0 to 1. The second term of the loss of 3D Gaussian splatting (Kerbl et al.
/// 2023, eq. 7, as their code computes it, without halving).
pub fn d_ssim(image: Tensor<3>, truth: &Truth) -> Tensor<1> {
    photometric(image, truth, 1.0)
}

/// Share of D-SSIM in [`photometric`] in the original implementation and all its successors.
pub const DEFAULT_LAMBDA: f64 = 0.2;

/// `(1 − λ) · L1 + λ · (1 − SSIM)`, `[1]` (Kerbl et al. 2023, eq. 7).
///
/// `image` is `[H, W, C]`, 0 to 1, and may be tracked; `lambda` is 0 to 1, usually [`DEFAULT_LAMBDA`]. One operation computes
/// the value and the gradient (see [`splat_op::loss`]), so `backward` costs one elementwise product. The value equals
/// `l1(..) * (1 − λ) + (1 − ssim(..)) * λ`, tensor code that can be composed differently, and is what runs in
/// [tensor code](splat_op::in_tensor_code).
///
/// The subgradient at `image = truth` is 0, as for [`l1()`].
pub fn photometric(image: Tensor<3>, truth: &Truth, lambda: f64) -> Tensor<1> {
    if is_tensor_code() {
        let photograph = if image.is_autodiff() { Tensor::from_inner(truth.image()) } else { truth.image() };
        return l1(image.clone(), photograph.clone()) * (1.0 - lambda) + (ssim(image, photograph).neg() + 1.0) * lambda;
    }
    let variable = planes(image);
    let (value, gradient) = truth.loss(&variable.clone().inner(), lambda, variable.is_tracked());
    match gradient {
        Some(gradient) => with_gradient(variable, value, gradient),
        None => value,
    }
}
