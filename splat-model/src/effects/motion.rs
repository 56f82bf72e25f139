//! Camera motion during the exposure and during the readout of the sensor.
//!
//! A twist `(ω, τ)`, `[6]`, is the motion of the scene in the camera's frame: over the exposure, a point `p` of the
//! camera's frame moves along `exp(t ξ) p`, `t` from −½ to ½, with `ω` a rotation vector in rad and `τ` a translation in
//! scene units. The pose of the photograph is the pose at `t = 0`. A camera that moves one unit forward has
//! `τ = (0, 0, −1)`.
//!
//! The velocity of a centre on the screen follows from the image Jacobian of a pinhole (Longuet-Higgins and Prazdny 1980),
//! with the slopes `s = (x/z, y/z)`:
//!
//! ```text
//! v_x = f_x ( (τ_x − s_x τ_z)/z + ω_y (1 + s_x²) − ω_x s_x s_y − ω_z s_y )
//! v_y = f_y ( (τ_y − s_y τ_z)/z − ω_x (1 + s_y²) + ω_y s_x s_y + ω_z s_x )
//! ```
//!
//! in px over the exposure. If `v` is taken as constant over the exposure and over an ellipse, motion blur is a
//! [widening](screen::widen_along) by `v vᵀ/12`, the variance of a uniform distribution along `v`, and a rolling shutter is
//! a linear map. The approximation is good for a blur while `v` is below the width of the moving object, and for a shutter
//! while `v` is far below the picture's height. (Moving ellipses on the screen is the idea of Seiskari et al. 2024,
//! "Gaussian Splatting on the Move".) Beyond that, and for cameras that are not pinholes, [`poses`] returns poses whose
//! renders are averaged.

use burn::tensor::{Tensor, TensorData};
use splat_op::{Ellipses, Intrinsics, RenderOptions};

use super::screen::{self, ScreenError, column, culled, pairs, require_pinhole};

/// Largest vertical motion over a rolling shutter, as a share of the picture's height. Faster points are clamped to it.
const LARGEST_SHARE: f64 = 0.5;

/// Terms of the series in [`poses`]: enough for all digits of an f64 for rotations by up to half a turn.
const TERMS: usize = 14;

/// `[N, 2]`: motion of each centre on the screen under `twist` `[6]`, px; zero for culled Gaussians. Differentiable in the
/// ellipses and the twist.
///
/// A centre outside the picture is clamped to a distance of `options.jacobian_margin` from it, as in
/// [`splat_op::project()`], because velocities on the image plane grow without bound there.
///
/// # Errors
/// [`ScreenError::Lens`] if the camera is not a pinhole.
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
    // A culled Gaussian has depth zero, which must not be divided by.
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

/// The ellipses blurred by an open shutter while they move by `v`, `[N, 2]` px, for example from [`velocity`].
pub fn blurred(ellipses: Ellipses, v: Tensor<2>) -> Ellipses {
    screen::widen_along(ellipses, v / 12_f64.sqrt())
}

/// The ellipses on a sensor that is read row by row, from the upper border to the lower, in a picture of `height` rows,
/// while they move by `v`, `[N, 2]` px: the [`velocity`] under the twist over the time from the first row to the last.
///
/// Row `y` is exposed at `t = y/H − ½`. A point at `(x, y)` in the middle of that time, moving by `v`, is found in the row
/// `y' = y + v_y (y'/H − ½)`, so that with `k = 1/(1 − v_y/H)`
///
/// ```text
/// y' = k (y − v_y/2)     x' = x + v_x (y'/H − ½)     M = | 1  k v_x/H |
///                                                        | 0  k       |
/// ```
///
/// exactly, with `M` the linear map about the centre. `v_y` is clamped to half of `H` either way: near `H` a point would
/// stay ahead of the shutter for ever, and beyond it be visible in no row or upside down.
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
    let twice = cross.clone().matmul(cross.clone());
    // Multiplies `I + x [θ] + y [θ]²` with a matrix. The identity's part is added without a product.
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
pub(super) fn cross_matrix(v: &Tensor<1>) -> Tensor<2> {
    // The signs with which each component of `v` enters the matrix, row-major.
    const PLACES: [[f64; 9]; 3] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
    let places = Tensor::<2>::from_data(TensorData::from(PLACES), (&v.device(), v.dtype()));
    v.clone().unsqueeze::<2>().matmul(places).reshape([3, 3])
}

#[cfg(test)]
mod tests;
