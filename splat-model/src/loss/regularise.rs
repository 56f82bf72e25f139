//! Penalties on the Gaussians themselves. None is on by default; the caller weights and adds them.

use burn::tensor::Tensor;

use crate::fold::folded;

/// Mean opacity, `[1]`, of `opacities`, `[N]` or `[N, 1]`, 0 to 1.
///
/// Lets Gaussians that explain nothing fade, so that they can be relocated (Kheradmand et al. 2024, "3D Gaussian
/// Splatting as Markov Chain Monte Carlo", the opacity term of the total loss, weight 0.01).
pub fn opacity<const D: usize>(opacities: Tensor<D>) -> Tensor<1> {
    mean(opacities.abs())
}

/// Mean standard deviation, `[1]`, of `scales`, `[N, 3]`, scene units, positive.
///
/// Keeps Gaussians small where nothing asks for size (Kheradmand et al. 2024, the covariance term of the total loss, weight 0.01).
pub fn scale(scales: Tensor<2>) -> Tensor<1> {
    mean(scales.abs())
}

/// Penalty on needle-shaped Gaussians, `[1]`: the mean of `max(0, ln(longest / shortest) − ln largest_ratio)`. `log_scales` is
/// `[N, 3]`, natural logarithms of the standard deviations; `largest_ratio` is at least 1, 10 in the source.
///
/// The anisotropy regulariser of PhysGaussian (Xie et al. 2024), a hinge on the ratio of axes, here on its logarithm so
/// that neither value nor gradient can overflow.
pub fn needles(log_scales: Tensor<2>, largest_ratio: f64) -> Tensor<1> {
    let longest = log_scales.clone().max_dim(1);
    let shortest = log_scales.min_dim(1);
    mean((longest - shortest - largest_ratio.ln()).clamp_min(0.0))
}

/// The mean, and of no values zero.
pub(super) fn mean<const D: usize>(values: Tensor<D>) -> Tensor<1> {
    let count = values.shape().num_elements();
    if count == 0 {
        return values.sum();
    }
    (folded(values.reshape([1, count]), 0.0).sum_dim(2).sum_dim(1) / count as f64).reshape([1])
}
