//! Rotations of many vectors, by quaternions of any length.

use burn::tensor::Tensor;

/// Real part, `[N, 1]`, and imaginary parts, `[N, 3]`, of the normalised quaternions `[N, 4]`, wxyz.
pub(super) fn unit(quaternions: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
    // Divided by the largest component first, because its square may overflow or underflow in f32.
    let largest = quaternions.clone().abs().max_dim(1);
    let sized = quaternions / largest;
    let length = sized.clone().square().sum_dim(1).sqrt();
    let unit = sized / length;
    (unit.clone().narrow(1, 0, 1), unit.narrow(1, 1, 3))
}

/// Rotates `v` by unit quaternions: `v + 2 w (u × v) + 2 u × (u × v)`.
pub(super) fn rotated(v: Tensor<2>, w: Tensor<2>, u: Tensor<2>) -> Tensor<2> {
    let twice = u.clone().cross(v.clone(), 1) * 2.0;
    v + twice.clone() * w + u.cross(twice, 1)
}
