//! The loss of 3D Gaussian splatting.

use burn::tensor::Tensor;

use super::ssim::{Similarity, Truth, planes, similarity};
use super::with_gradient;

/// Share of D-SSIM in [`photometric`] that the original and all its successors train with.
pub const DEFAULT_LAMBDA: f64 = 0.2;

/// `(1 − λ) · L1 + λ · (1 − SSIM)`, `[1]` (Kerbl et al. 2023, eq. 7).
///
/// `image` is `[H, W, C]`, 0 to 1, and may be tracked; `lambda` is 0 to 1, usually [`DEFAULT_LAMBDA`]. One pass computes
/// the value and the gradient, so `backward` costs two elementwise operations.
///
/// The subgradient at `image = truth` is 0, as that of [`super::l1()`].
pub fn photometric(image: Tensor<3>, truth: &Truth, lambda: f64) -> Tensor<1> {
    let variable = planes(image);
    let tracked = variable.is_tracked();
    let x = variable.clone().inner();
    if let Some((value, gradient)) = truth.on_gpu(&x, lambda, tracked) {
        return match gradient {
            Some(gradient) => with_gradient(variable, value, gradient),
            None => value,
        };
    }
    let count = x.shape().num_elements() as f64;

    let difference = x.clone() - truth.planes.clone();
    let absolute = difference.clone().abs().sum() * ((1.0 - lambda) / count);
    let Similarity { mean, gradient } = similarity(x, truth, tracked);
    let value = absolute + (mean.neg() + 1.0) * lambda;
    match gradient {
        Some(gradient) => {
            let gradient = gradient * -lambda + sign(difference) * ((1.0 - lambda) / count);
            with_gradient(variable, value, gradient)
        }
        None => value,
    }
}

/// The sign, 0 at 0. `Tensor::sign` calls a library function per element on Flex; this is two vectorised passes. Between
/// −1e-38 and 1e-38 the result is linear, which is still a subgradient of the absolute value.
fn sign(x: Tensor<4>) -> Tensor<4> {
    (x * 1e38).clamp(-1.0, 1.0)
}
