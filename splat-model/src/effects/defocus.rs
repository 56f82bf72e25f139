//! A thin lens with an open aperture: what is not at the distance that it is focused on is blurred.
//!
//! Rays from a point at depth `z` that pass the lens at an offset `a` from its axis meet the picture beside the point's image
//! by `f a (1/z − 1/z_focus)`, `f` in px (similar triangles; Potmesil and Chakravarty 1981). Over an aperture of radius `R` with
//! uniform weight they fill a disc of radius `r = R f |1/z − 1/z_focus|`, whose variance along each axis is `r²/4`.
//! An ellipse is widened by that variance; the disc's sharp edge, which one sees on bright points, is not shown.
//!
//! Both parameters are learnable: the logarithm of the aperture, which keeps it positive, and the inverse of the distance in
//! focus, which at infinity is 0. What enters is `r` with its sign, squared, so that nothing has a kink in focus.

use burn::tensor::Tensor;
use splat_op::{Ellipses, Intrinsics};

use super::screen::{self, ScreenError, culled, pairs, require_pinhole};

/// `[N, 2]`: radii of the circles of confusion along x and y, px, of either sign: positive before the focus. They differ
/// where pixels are not square. Zero where culled. `log_aperture` `[1]`: natural logarithm of the aperture's radius, scene units;
/// `inverse_focus` `[1]`: one over the distance in focus along the optical axis, per scene unit.
///
/// # Errors
/// [`ScreenError::Lens`] if the camera is no pinhole.
pub fn confusion(
    ellipses: &Ellipses,
    intrinsics: &Intrinsics,
    log_aperture: &Tensor<1>,
    inverse_focus: &Tensor<1>,
) -> Result<Tensor<2>, ScreenError> {
    require_pinhole(intrinsics.model)?;
    let gone = culled(ellipses);
    // Of a culled Gaussian nothing is known, and its depth is zero.
    let inverse_depth = ellipses.depth.clone().mask_fill(gone.clone(), 1.0).recip();
    let slope = ((inverse_depth - inverse_focus.clone()) * log_aperture.clone().exp()).mask_fill(gone, 0.0);
    Ok(pairs(slope.clone() * intrinsics.fx, slope * intrinsics.fy))
}

/// What the ellipses look like through an aperture, with circles of confusion of these radii, `[N, 2]` px, such as
/// [`confusion`] gives.
pub fn blurred(ellipses: Ellipses, radii: Tensor<2>) -> Ellipses {
    screen::widen(ellipses, radii * 0.5)
}

#[cfg(test)]
mod tests;
