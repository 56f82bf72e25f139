//! Changes of the ellipses on the screen, between [`project`](splat_op::project()) and [`tile`](splat_op::tile()): what blurs and
//! shears a picture does so to each Gaussian's ellipse, and an ellipse that a linear map or another Gaussian's covariance
//! changes is an ellipse again.
//!
//! An ellipse is kept as the factor of its covariance, `Σ = L Lᵀ` with `sigma_u`, `shear` and `sigma_v` (see [`Ellipses`]), because
//! the covariance itself would lose a thin one's digits. All that is computed here is a sum of squares, or a product
//! of rows of `L`, and lengths are taken as hypotenuses: nothing cancels or overflows that did not before. Where
//! nothing is added, the ellipse stays as it was to the last bit.
//!
//! Light is spread and not added: an ellipse that grows in area loses opacity in proportion, so that the integral of
//! `opacity · exp(−½ dᵀ Σ⁻¹ d)` is what it was. For what is nearly opaque that is an approximation, as a time average of
//! `1 − Π (1 − α)` is not that of the averages; sub-exposures ([`super::motion::poses`]) make none.
//!
//! A culled Gaussian, of depth 0, stays as it is, and whatever is given for it gets a gradient of exactly zero.

use burn::tensor::{Bool, Tensor};
use splat_op::{CameraModel, Ellipses};
use thiserror::Error;

/// What cannot be had by changing ellipses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum ScreenError {
    /// The equations are those of a pinhole.
    #[error(
        "the camera model is {0:?}, and ellipses are moved and widened for Pinhole alone: average renders from several poses \
         instead, which any camera can do"
    )]
    Lens(CameraModel),
}

/// Refuses a lens.
pub(super) fn require_pinhole(model: CameraModel) -> Result<(), ScreenError> {
    if model == CameraModel::Pinhole { Ok(()) } else { Err(ScreenError::Lens(model)) }
}

/// `[N]`: which Gaussians are culled.
pub(super) fn culled(ellipses: &Ellipses) -> Tensor<1, Bool> {
    ellipses.depth.clone().equal_elem(0.0)
}

/// One of the two columns of `[N, 2]`, as `[N]`.
pub(super) fn column(pairs: &Tensor<2>, axis: usize) -> Tensor<1> {
    pairs.clone().narrow(1, axis, 1).squeeze_dim(1)
}

/// `[N]` and `[N]` as `[N, 2]`.
pub(super) fn pairs(x: Tensor<1>, y: Tensor<1>) -> Tensor<2> {
    Tensor::stack(vec![x, y], 1)
}

/// `√(a² + b²)` where they are not both zero. The larger of the two is put outside as a constant: the result is the same
/// whatever it is, so that it has no gradient of its own.
fn hypotenuse(a: Tensor<1>, b: Tensor<1>) -> Tensor<1> {
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
    // How far `w` leads away from the line along which x and y vary together.
    let off = wy - ellipses.shear.clone() * wx.clone();
    let shear = ellipses.shear.clone() + wx / sigma_u.clone() * (off.clone() / sigma_u.clone());
    let sigma_v = hypotenuse(ellipses.sigma_v.clone(), share * off);
    spread(ellipses, sigma_u, shear, sigma_v)
}

/// Widens by the covariance `diag(s_x², s_y²)`, `std` `[N, 2]` in px, of either sign: a blur whose axes are those of the screen. For a
/// disc of radius `r` with uniform weight, both are `r/2`.
///
/// With `a = sigma_u² + s_x²` and `c = sigma_u / √a`,
///
/// ```text
/// sigma_u' = √a     shear' = shear c²     sigma_v'² = sigma_v² + s_y² + (c shear s_x)²
/// ```
///
/// which is [`widen_along`] for `(s_x, 0)` and then for `(0, s_y)`; the opacity as there.
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

/// The rows of what is not culled, and zeros.
fn kept(ellipses: &Ellipses, rows: Tensor<2>) -> Tensor<2> {
    let size = rows.dims();
    rows.mask_fill(culled(ellipses).unsqueeze_dim::<2>(1).expand(size), 0.0)
}

/// The same light over another factor.
fn spread(ellipses: Ellipses, sigma_u: Tensor<1>, shear: Tensor<1>, sigma_v: Tensor<1>) -> Ellipses {
    let area = (ellipses.sigma_u / sigma_u.clone()) * (ellipses.sigma_v / sigma_v.clone());
    Ellipses { opacity: ellipses.opacity * area, sigma_u, shear, sigma_v, ..ellipses }
}

/// Maps the ellipses about their centres by `[[1, q], [0, k]]`, both `[N]` and `k > 0`: what lies `d_y` below a centre goes `q d_y`
/// to the right and ends `k d_y` below it. Opacity and centres stay.
///
/// The rows of `M L` are `(sigma_u (1 + q shear), q sigma_v)` and `k (shear sigma_u, sigma_v)`; of these,
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
