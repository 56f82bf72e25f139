//! Mean absolute error.

use burn::tensor::Tensor;

/// `mean |image − truth|` over pixels and channels, `[1]`.
///
/// `image` and `truth` are `[H, W, C]`, 0 to 1. The first term of the loss of 3D Gaussian splatting (Kerbl et al. 2023,
/// eq. 7). The derivative at equality is 0.
pub fn l1(image: Tensor<3>, truth: Tensor<3>) -> Tensor<1> {
    (image - truth).abs().mean()
}

/// `Σ w |image − truth| / (C Σ w)`, `[1]`: the mean absolute error under weights, for masks and confidences.
///
/// `image` and `truth` are `[H, W, C]`, 0 to 1; `weights` is `[H, W, 1]`, not negative. Weights that are all equal give
/// [`l1()`]; weights that are all zero give 0, with gradients of 0, because such a view holds no information.
pub fn weighted_l1(image: Tensor<3>, truth: Tensor<3>, weights: Tensor<3>) -> Tensor<1> {
    let channels = image.dims()[2] as f64;
    let total = weights.clone().sum() * channels;
    // If the total is zero, so is the numerator: division by 1 then gives 0.
    let divisor = total.clone().mask_fill(total.equal_elem(0.0), 1.0);
    ((image - truth).abs() * weights).sum() / divisor
}
