//! Changes of the projected ellipses, between [`project`](splat_op::project()) and [`intersect`](splat_op::intersect()). An effect
//! that blurs or shears a picture does the same to each Gaussian's ellipse. An ellipse after a linear map, or after the
//! addition of another Gaussian's covariance, is an ellipse again.
//!
//! An ellipse is stored as a factor of its covariance, `Σ = L Lᵀ` with `sigma_u`, `shear` and `sigma_v` (see [`Ellipses`]),
//! because the covariance itself would lose the digits of a thin ellipse. All results are sums of squares or products of
//! rows of `L`, and lengths are computed as hypotenuses, so that no new cancellation or overflow occurs. Where nothing is
//! added, the ellipse stays the same to the last bit.
//!
//! Light is conserved: an ellipse that grows in area loses opacity in proportion, so that the integral of
//! `opacity · exp(−½ dᵀ Σ⁻¹ d)` stays constant. For nearly opaque Gaussians that is an approximation, because the time
//! average of `1 − Π (1 − α)` is not `1 − Π (1 − α)` of the averages. Sub-exposures ([`super::motion::poses`]) avoid it.
//!
//! A culled Gaussian, of depth 0, stays unchanged, and the change given for it gets a gradient of exactly zero.

use burn::tensor::{Bool, Tensor};
use splat_op::{CameraModel, Ellipses};
use thiserror::Error;

/// An effect that cannot be simulated by a change of ellipses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ScreenError {
    /// The camera has a lens, and the equations hold for pinholes only.
    #[error(
        "the camera model is {0:?}, but ellipses can be moved and widened for Pinhole only: average renders from several poses \
         instead, which any camera can do"
    )]
    Lens(CameraModel),
}

/// Returns an error for a camera with a lens.
pub(super) fn require_pinhole(model: CameraModel) -> Result<(), ScreenError> {
    if model == CameraModel::Pinhole { Ok(()) } else { Err(ScreenError::Lens(model)) }
}

/// `[N]`: which Gaussians are culled.
pub(super) fn culled(ellipses: &Ellipses) -> Tensor<1, Bool> {
    ellipses.depth.clone().equal_elem(0.0)
}

/// Column `axis` of a matrix with `N` rows, as `[N]`.
pub(super) fn column(rows: &Tensor<2>, axis: usize) -> Tensor<1> {
    rows.clone().narrow(1, axis, 1).squeeze_dim(1)
}

/// Stacks two `[N]` tensors to `[N, 2]`.
pub(super) fn pairs(x: Tensor<1>, y: Tensor<1>) -> Tensor<2> {
    Tensor::stack(vec![x, y], 1)
}

/// `√(a² + b²)` for values that are not both zero. The larger value is factored out as a constant to avoid overflow. The
/// result does not depend on that factor, so it is detached.
pub(super) fn hypotenuse<const D: usize>(a: Tensor<D>, b: Tensor<D>) -> Tensor<D> {
    let larger = a.clone().abs().max_pair(b.clone().abs()).detach();
    ((a / larger.clone()).square() + (b / larger.clone()).square()).sqrt() * larger
}

/// Widens by the covariance `w wᵀ`, `w` `[N, 2]` in px: a blur along a line. For one of uniform weight over the length
/// `|v|`, `w = v/√12`.
///
/// With `Σ' = Σ + w wᵀ`, `a = sigma_u² + w_x²` and `c = sigma_u / √a`,
///
/// ```text
/// sigma_u' = √a     shear' = shear + w_x (w_y − shear w_x) / a     sigma_v'² = sigma_v² + c² (w_y − shear w_x)²
/// ```
///
/// which is the triangular factor of the rank-one sum (Gill, Golub, Murray and Saunders 1974, method C1), and
/// `opacity' = opacity · sigma_u sigma_v / (sigma_u' sigma_v')`.
pub fn widen_along(ellipses: Ellipses, w: Tensor<2>) -> Ellipses {
    let w = kept(&ellipses, w);
    let (wx, wy) = (column(&w, 0), column(&w, 1));
    let sigma_u = hypotenuse(ellipses.sigma_u.clone(), wx.clone());
    let share = ellipses.sigma_u.clone() / sigma_u.clone();
    // Distance of `w` from the line along which x and y vary together.
    let off = wy - ellipses.shear.clone() * wx.clone();
    let shear = ellipses.shear.clone() + wx / sigma_u.clone() * (off.clone() / sigma_u.clone());
    let sigma_v = hypotenuse(ellipses.sigma_v.clone(), share * off);
    spread(ellipses, sigma_u, shear, sigma_v)
}

/// Widens by the covariance `diag(s_x², s_y²)`: a blur whose axes are the image axes. `std` is `[N, 2]` in px, of either
/// sign. For a disc of radius `r` with uniform weight, both are `r/2`.
///
/// With `a = sigma_u² + s_x²` and `c = sigma_u / √a`,
///
/// ```text
/// sigma_u' = √a     shear' = shear c²     sigma_v'² = sigma_v² + s_y² + (c shear s_x)²
/// ```
///
/// which is [`widen_along`] for `(s_x, 0)` and then for `(0, s_y)`, with the same change of opacity.
pub fn widen(ellipses: Ellipses, std: Tensor<2>) -> Ellipses {
    let std = kept(&ellipses, std);
    let (sx, sy) = (column(&std, 0), column(&std, 1));
    let sigma_u = hypotenuse(ellipses.sigma_u.clone(), sx.clone());
    let share = ellipses.sigma_u.clone() / sigma_u.clone();
    let tilted = share.clone() * ellipses.shear.clone();
    let shear = share * tilted.clone();
    let sigma_v = hypotenuse(hypotenuse(ellipses.sigma_v.clone(), sy), tilted * sx);
    spread(ellipses, sigma_u, shear, sigma_v)
}

/// `rows` with zeros for culled Gaussians.
fn kept(ellipses: &Ellipses, rows: Tensor<2>) -> Tensor<2> {
    let size = rows.dims();
    rows.mask_fill(culled(ellipses).unsqueeze_dim::<2>(1).expand(size), 0.0)
}

/// Replaces the factor and scales the opacity such that the light is conserved.
fn spread(ellipses: Ellipses, sigma_u: Tensor<1>, shear: Tensor<1>, sigma_v: Tensor<1>) -> Ellipses {
    let area = (ellipses.sigma_u / sigma_u.clone()) * (ellipses.sigma_v / sigma_v.clone());
    Ellipses { opacity: ellipses.opacity * area, sigma_u, shear, sigma_v, ..ellipses }
}

/// Maps the ellipses about their centres by `[[1, q], [0, k]]`, both `[N]` and `k > 0`: a point `d_y` below a centre moves
/// `q d_y` to the right and ends `k d_y` below the centre. Opacities and centres stay the same.
///
/// The rows of `M L` are `(sigma_u (1 + q shear), q sigma_v)` and `k (shear sigma_u, sigma_v)`. From these,
///
/// ```text
/// sigma_u' = |row 0|     shear' = row 0 · row 1 / sigma_u'²     sigma_v' = k sigma_u sigma_v / sigma_u'
/// ```
pub(super) fn sheared(ellipses: Ellipses, q: Tensor<1>, k: Tensor<1>) -> Ellipses {
    let Ellipses { sigma_u, shear, sigma_v, .. } = ellipses.clone();
    let (along, across) = (sigma_u.clone() * (q.clone() * shear.clone() + 1.0), q * sigma_v.clone());
    let length = hypotenuse(along.clone(), across.clone());
    let (along, across) = (along / length.clone(), across / length.clone());
    let share = sigma_u / length.clone();
    let turned = along * (shear * share.clone()) + across * (sigma_v.clone() / length.clone());
    Ellipses { sigma_u: length, shear: k.clone() * turned, sigma_v: k * sigma_v * share, ..ellipses }
}

#[cfg(test)]
mod tests;
