//! The camera's motion while the shutter is open, and while the sensor is read.
//!
//! A twist `(ω, τ)`, `[6]`, is how the scene moves as the camera sees it: over the exposure, a point `p` of the camera's frame
//! goes along `exp(t ξ) p`, `t` from −½ to ½, with `ω` a rotation vector in rad and `τ` a translation in scene units. The
//! pose of the photograph is that of the middle. A camera that itself goes one unit forward has `τ = (0, 0, −1)`.
//!
//! A centre's velocity on the screen follows from the image Jacobian of a pinhole (Longuet-Higgins and Prazdny 1980), with
//! the slopes `s = (x/z, y/z)`:
//!
//! ```text
//! v_x = f_x ( (τ_x − s_x τ_z)/z + ω_y (1 + s_x²) − ω_x s_x s_y − ω_z s_y )
//! v_y = f_y ( (τ_y − s_y τ_z)/z − ω_x (1 + s_y²) + ω_y s_x s_y + ω_z s_x )
//! ```
//!
//! px over the exposure. Taken as constant, over the exposure and over an ellipse, it makes of motion blur a
//! [widening](screen::widen_along) by `v vᵀ/12`, the variance of a uniform distribution along `v`, and of a rolling shutter a
//! linear map. That is good while `v` stays below the width of what moves, for a blur, and far below the picture's
//! height, for a shutter (the idea of ellipses that move on the screen is that of Seiskari et al. 2024, "Gaussian Splatting
//! on the Move"). Beyond that, and for cameras that are no pinholes, [`poses`] gives the poses of which to average renders.

use burn::tensor::{Tensor, TensorData};
use splat_op::{Ellipses, Intrinsics, RenderOptions};

use super::screen::{self, ScreenError, column, culled, pairs, require_pinhole};

/// Over a rolling shutter, a point may go down or up by this share of the picture's height; one that is faster is taken to be so fast.
const LARGEST_SHARE: f64 = 0.5;

/// Terms of the series in [`poses`]: all digits of an f64 for rotations by up to half a turn.
const TERMS: usize = 14;

/// `[N, 2]`: how far each centre goes on the screen under `twist` `[6]`, px; zero where culled. Differentiable in the ellipses
/// and the twist.
///
/// A centre beyond the picture counts as if it were no further from it than `options.jacobian_margin`, as in
/// [`splat_op::project()`]: what lies there on the image plane would seem to move ever faster.
///
/// # Errors
/// [`ScreenError::Lens`] if the camera is no pinhole.
pub fn velocity(
    ellipses: &Ellipses,
    intrinsics: &Intrinsics,
    twist: &Tensor<1>,
    options: &RenderOptions,
) -> Result<Tensor<2>, ScreenError> {
    require_pinhole(intrinsics.model)?;
    let part = |i: usize| twist.clone().narrow(0, i, 1);
    let [wx, wy, wz, tx, ty, tz] = [0, 1, 2, 3, 4, 5].map(part);
    let gone = culled(ellipses);
    // Of a culled Gaussian nothing is known, and its depth is zero.
    let z = ellipses.depth.clone().mask_fill(gone.clone(), 1.0);
    let slope = |axis: usize, focal: f64, principal: f64, size: usize| {
        let reach = 0.5 * options.jacobian_margin * size as f64;
        let px = column(&ellipses.mean2d, axis).clamp(-reach, size as f64 + reach);
        (px - principal) / focal
    };
    let x = slope(0, intrinsics.fx, intrinsics.cx, intrinsics.width);
    let y = slope(1, intrinsics.fy, intrinsics.cy, intrinsics.height);
    let xy = x.clone() * y.clone();
    let across = (tx - x.clone() * tz.clone()) / z.clone() + wy.clone() * (x.clone().square() + 1.0)
        - wx.clone() * xy.clone()
        - wz.clone() * y.clone();
    let down = (ty - y.clone() * tz) / z - wx * (y.square() + 1.0) + wy * xy + wz * x;
    let still = |v: Tensor<1>, focal: f64| (v * focal).mask_fill(gone.clone(), 0.0);
    Ok(pairs(still(across, intrinsics.fx), still(down, intrinsics.fy)))
}

/// What the ellipses look like through a shutter that is open while they go along `v`, `[N, 2]` px, such as [`velocity`] gives.
pub fn blurred(ellipses: Ellipses, v: Tensor<2>) -> Ellipses {
    screen::widen_along(ellipses, v / 12_f64.sqrt())
}

/// What the ellipses look like on a sensor that is read row by row, from the upper border to the lower, in a picture of `height`
/// rows, while they go along `v`, `[N, 2]` px: the [`velocity`] under the twist of the time from the first row to the last.
///
/// Row `y` is exposed at `t = y/H − ½`. A point that is at `(x, y)` in the middle of that time and goes along `v` is found in the row
/// `y' = y + v_y (y'/H − ½)`, so that with `k = 1/(1 − v_y/H)`
///
/// ```text
/// y' = k (y − v_y/2)     x' = x + v_x (y'/H − ½)     M = | 1  k v_x/H |
///                                                        | 0  k       |
/// ```
///
/// exactly, with `M` the linear map about the centre. `v_y` beyond half of `H` either way counts as that: near `H` a
/// point would be ahead of the shutter for ever, and beyond it be seen in no row or upside down.
pub fn rolled(ellipses: Ellipses, v: Tensor<2>, height: usize) -> Ellipses {
    let height = height as f64;
    let (vx, vy) = (column(&v, 0) / height, (column(&v, 1) / height).clamp(-LARGEST_SHARE, LARGEST_SHARE));
    let gone = culled(&ellipses);
    let (vx, vy) = (vx.mask_fill(gone.clone(), 0.0), vy.mask_fill(gone, 0.0));
    let (x, y) = (column(&ellipses.mean2d, 0), column(&ellipses.mean2d, 1));
    let k = (vy.clone().neg() + 1.0).recip();
    let time = (y.clone() / height - 0.5) * k.clone();
    // `y' − y = v_y t`, and `t = y'/H − ½ = k (y/H − ½)`.
    let mean2d = pairs(x + vx.clone() * time.clone() * height, y + vy * time * height);
    let mapped = screen::sheared(ellipses, k.clone() * vx, k);
    Ellipses { mean2d, ..mapped }
}

/// `[3, 4]` each: the poses of a camera at the middles of `count` equal parts of an exposure, `exp(t ξ) cam_from_world` at
/// `t = (i + ½)/count − ½`, for `cam_from_world` `[3, 4]` and `twist` `[6]`; exact, and differentiable in both. The
/// average of renders from them tends to the photograph as their number grows, for any camera and any motion.
///
/// With `θ = t ω` and `[θ]` its cross product, `exp(t ξ)` has the rotation `I + A [θ] + B [θ]²` and the translation
/// `(I + B [θ] + C [θ]²) t τ`, `A = sin|θ|/|θ|`, `B = (1 − cos|θ|)/|θ|²`, `C = (|θ| − sin|θ|)/|θ|³` (Murray, Li and Sastry 1994,
/// section 2.3). These are power series of `|θ|²` and computed as such, without a case for no rotation.
pub fn poses(cam_from_world: &Tensor<2>, twist: &Tensor<1>, count: usize) -> Vec<Tensor<2>> {
    (0..count).map(|i| pose_at(cam_from_world, twist, (i as f64 + 0.5) / count as f64 - 0.5)).collect()
}

/// `exp(t ξ) cam_from_world`.
pub fn pose_at(cam_from_world: &Tensor<2>, twist: &Tensor<1>, t: f64) -> Tensor<2> {
    let theta = twist.clone().narrow(0, 0, 3) * t;
    let moved = (twist.clone().narrow(0, 3, 3) * t).unsqueeze_dim::<2>(1);
    let [a, b, c] = series(theta.clone().square().sum());
    let cross = cross_matrix(&theta);
    let twice = cross.clone().matmul(cross.clone());
    // `x + y [θ] + z [θ]²` times something: the identity is left out of the sum.
    let turned = |of: Tensor<2>, first: &Tensor<2>, second: &Tensor<2>| {
        let change = cross.clone() * first.clone() + twice.clone() * second.clone();
        of.clone() + change.matmul(of)
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

/// `[3, 3]`: the matrix of the cross product with `v`, `[3]`.
fn cross_matrix(v: &Tensor<1>) -> Tensor<2> {
    // Row by row: which component of `v` stands where, and with which sign.
    const PLACES: [[f64; 3]; 9] = [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -1.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
    ];
    let places = TensorData::new(PLACES.concat(), [9, 3]);
    let places = Tensor::<2>::from_data(places, (&v.device(), v.dtype()));
    places.matmul(v.clone().unsqueeze_dim(1)).reshape([3, 3])
}

#[cfg(test)]
mod tests;
