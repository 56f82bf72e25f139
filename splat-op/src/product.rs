//! Products of matrices in the precision of their numbers. Burn's product rounds factors to TF32 or half precision on cards that have
//! units for it, which moves a pose by a thousandth and a colour by a shade.

use burn::tensor::Tensor;

use crate::abilities::is_gpu;

/// Returns the product of `a`, `[M, K]`, and `b`, `[K, N]`. Differentiable.
pub fn product(a: Tensor<2>, b: Tensor<2>) -> Tensor<2> {
    mixed(a, b.unsqueeze_dim(2)).squeeze_dim(2)
}

/// Returns sums of `planes`, `[K, H, W]`, with `weights`, `[R, K]`: `[R, H, W]`. Differentiable.
pub fn mixed(weights: Tensor<2>, planes: Tensor<3>) -> Tensor<3> {
    let ([rows, count], [_, height, width]) = (weights.dims(), planes.dims());
    if is_gpu(&planes.device()) {
        // One fused kernel. The gradient of the weights is summed along one side and then the other, which keeps a GPU busy.
        let weighted = weights.reshape([rows, count, 1, 1]) * planes.unsqueeze_dim(0);
        return weighted.sum_dim(1).squeeze_dim(1);
    }
    weights.matmul(planes.reshape([count, height * width])).reshape([rows, height, width])
}
