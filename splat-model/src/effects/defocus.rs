//! A thin lens with an open aperture: points away from the focus distance are blurred.
//!
//! A ray from a point at depth `z` that passes the lens at an offset `a` from its axis hits the picture at a distance of
//! `f a (1/z − 1/z_focus)` from the point's image, `f` in px (similar triangles; Potmesil and Chakravarty 1981). Over an
//! aperture of radius `R` with uniform weight, these hits fill a disc of radius `r = R f |1/z − 1/z_focus|`, whose variance
//! along each axis is `r²/4`. An ellipse is widened by that variance. The sharp edge of the disc, which is visible on
//! bright points, is not modelled.
//!
//! Both parameters can be learned: the logarithm of the aperture, which keeps it positive, and the inverse of the focus
//! distance, which is 0 at infinity. The variance uses the signed `r`, squared, so that the result is smooth at the focus.

use burn::tensor::Tensor;
use splat_op::{Ellipses, Intrinsics};

use super::screen::{self, ScreenError, culled, pairs, require_pinhole};

/// `[N, 2]`: signed radii of the circles of confusion along x and y, px, positive in front of the focus. They differ where
/// pixels are not square, and are zero for culled Gaussians. `log_aperture` `[1]`: natural logarithm of the aperture's
/// radius, scene units. `inverse_focus` `[1]`: inverse of the focus distance along the optical axis, per scene unit.
///
/// # Errors
/// [`ScreenError::Lens`] if the camera is not a pinhole.
pub fn confusion(
    ellipses: &Ellipses,
    intrinsics: &Intrinsics,
    log_aperture: &Tensor<1>,
    inverse_focus: &Tensor<1>,
) -> Result<Tensor<2>, ScreenError> {
    require_pinhole(intrinsics.model)?;
    let gone = culled(ellipses);
    // A culled Gaussian has depth zero, which must not be divided by.
    let inverse_depth = ellipses.depth.clone().mask_fill(gone.clone(), 1.0).recip();
    let slope = ((inverse_depth - inverse_focus.clone()) * log_aperture.clone().exp()).mask_fill(gone, 0.0);
    Ok(pairs(slope.clone() * intrinsics.fx, slope * intrinsics.fy))
}

/// The ellipses blurred by circles of confusion of these radii, `[N, 2]` px, for example from [`confusion`].
pub fn blurred(ellipses: Ellipses, radii: Tensor<2>) -> Ellipses {
    screen::widen(ellipses, radii * 0.5)
}

#[cfg(test)]
mod tests;
