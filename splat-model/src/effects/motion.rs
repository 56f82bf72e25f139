//! The poses of a camera that moves during the exposure.
//!
//! A twist `(ω, τ)`, `[6]`, is the motion of the scene in the camera's frame: over the exposure, a point `p` of the camera's frame moves
//! along `exp(t ξ) p`, `t` from −½ to ½, with `ω` a rotation vector in rad and `τ` a translation in scene units. The pose of the photograph
//! is the pose at `t = 0`. A camera that moves one unit forward has `τ = (0, 0, −1)`.
//!
//! For a pinhole and a small motion, [`splat_op::optics`] changes the ellipses of one render instead. The average of renders from
//! these poses holds for any camera and any motion.

use burn::tensor::Tensor;
use splat_op::pose::cross_matrix;
use splat_op::product;

/// Terms of the series in [`poses`]: enough for all digits of an f64 for rotations by up to half a turn.
const TERMS: usize = 14;

/// `[3, 4]` each: the poses of a camera at the middles of `count` equal parts of an exposure, `exp(t ξ) cam_from_world` at
/// `t = (i + ½)/count − ½`, for `cam_from_world` `[3, 4]` and `twist` `[6]`. Exact, and differentiable in both. The average
/// of renders from these poses converges to the photograph for any camera and any motion.
///
/// With `θ = t ω` and `[θ]` its cross product matrix, `exp(t ξ)` has the rotation `I + A [θ] + B [θ]²` and the translation
/// `(I + B [θ] + C [θ]²) t τ`, `A = sin|θ|/|θ|`, `B = (1 − cos|θ|)/|θ|²`, `C = (|θ| − sin|θ|)/|θ|³` (Murray, Li and Sastry
/// 1994, section 2.3). `A`, `B` and `C` are computed as power series of `|θ|²`, without a special case for no rotation.
pub fn poses(cam_from_world: &Tensor<2>, twist: &Tensor<1>, count: usize) -> Vec<Tensor<2>> {
    (0..count).map(|i| pose_at(cam_from_world, twist, (i as f64 + 0.5) / count as f64 - 0.5)).collect()
}

/// `exp(t ξ) cam_from_world`.
pub fn pose_at(cam_from_world: &Tensor<2>, twist: &Tensor<1>, t: f64) -> Tensor<2> {
    let theta = twist.clone().narrow(0, 0, 3) * t;
    let moved = (twist.clone().narrow(0, 3, 3) * t).unsqueeze_dim::<2>(1);
    let [a, b, c] = series(theta.clone().square().sum());
    let cross = cross_matrix(&theta);
    let twice = product(cross.clone(), cross.clone());
    // Multiplies `I + x [θ] + y [θ]²` with a matrix. The identity's part is added without a product.
    let turned = |of: Tensor<2>, first: &Tensor<2>, second: &Tensor<2>| {
        let change = cross.clone() * first.clone() + twice.clone() * second.clone();
        of.clone() + product(change, of)
    };
    let posed = turned(cam_from_world.clone(), &a, &b);
    let moved = turned(moved, &b, &c);
    let still = Tensor::zeros([3, 3], (&posed.device(), posed.dtype()));
    posed + Tensor::cat(vec![still, moved], 1)
}

/// `A`, `B` and `C` of [`poses`], `[1, 1]` each, from `|θ|²`, `[1]`: `Σ (−1)ⁿ |θ|²ⁿ / (2n + k)!` for `k` = 1, 2, 3.
fn series(squared: Tensor<1>) -> [Tensor<2>; 3] {
    let squared = squared.reshape([1, 1]);
    [1, 2, 3].map(|k| {
        // Horner's scheme, as a chain of ratios of neighbouring terms.
        let ratio = |n: usize| ((2 * n + k) * (2 * n + k - 1)) as f64;
        let last = squared.ones_like();
        let sum = (1..TERMS).rev().fold(last, |sum, n| (sum * squared.clone() / ratio(n)).neg() + 1.0);
        sum / (if k == 3 { 6.0 } else { k as f64 })
    })
}

#[cfg(test)]
mod tests;
