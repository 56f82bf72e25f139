//! What shutter and sensor do to a picture, done to each Gaussian's ellipse: packed ellipses → packed ellipses.
//! Differentiable in the ellipses and in the motion.
//!
//! A pinhole's ellipse `(x, y, sigma_u, shear, sigma_v, z, opacity)` as of [`mod@crate::project`] is moved and widened, or moved and
//! sheared. A culled Gaussian, of depth 0, stays as it is, and gives the motion no gradient.
//!
//! # Widening
//!
//! For the covariance `Σ + w wᵀ`, with `a = sigma_u² + w_x²` and `c = sigma_u / √a`,
//!
//! ```text
//! sigma_u' = √a     shear' = c² shear + w_x w_y / a     sigma_v'² = sigma_v² + c² (w_y − shear w_x)²
//! opacity' = opacity · sigma_u sigma_v / (sigma_u' sigma_v')
//! ```
//!
//! which is the triangular factor of a rank-one sum (Gill, Golub, Murray and Saunders 1974, method C1).
//! Lengths are computed as hypotenuses, so that no new cancellation or overflow occurs. Where nothing is added, the ellipse stays the
//! same. Light is conserved: the integral of `opacity · exp(−½ dᵀ Σ⁻¹ d)` is constant. For nearly opaque Gaussians that is an
//! approximation, because the time average of `1 − Π (1 − α)` is not `1 − Π (1 − α)` of the averages.
//!
//! # Motion
//!
//! A twist `(ω, τ)`, `[6]`, is the motion of the scene in the camera's frame: a point `p` moves along `exp(t ξ) p`, `t` from −½ to ½. The
//! velocity of a centre in the picture follows from the image Jacobian of a pinhole (Longuet-Higgins and Prazdny 1980). With the slopes
//! `s = (x − c_x)/f_x, (y − c_y)/f_y`, of a centre clamped to a margin around the picture, because velocities grow without bound there,
//!
//! ```text
//! v_x = f_x ( (τ_x − s_x τ_z)/z + ω_y (1 + s_x²) − ω_x s_x s_y − ω_z s_y )
//! v_y = f_y ( (τ_y − s_y τ_z)/z − ω_x (1 + s_y²) + ω_y s_x s_y + ω_z s_x )
//! ```
//!
//! in px. It is taken as constant over the time and over an ellipse. (Moving ellipses in the picture is the idea of Seiskari et al.
//! 2024, "Gaussian Splatting on the Move".)
//!
//! **Motion blur** widens by `w = v/√12`, the deviation of a uniform distribution along `v`.
//!
//! **Rolling shutter**: row `y` is exposed at `t = y/H − ½`. A point at `(x, y)` in the middle of that time is found in the row
//! `y' = y + v_y (y'/H − ½)`, so that with `k = 1/(1 − v_y/H)`, `q = k v_x/H` and `D = k (y − H/2)`
//!
//! ```text
//! x' = x + v_x D/H     y' = y + v_y D/H     M = | 1 q |
//!                                               | 0 k |
//! ```
//!
//! exactly, with `M` the linear map about the centre. The rows of `M L` are `(sigma_u (1 + q shear), q sigma_v)` and
//! `k (shear sigma_u, sigma_v)`, and
//!
//! ```text
//! sigma_u' = |row 0|     shear' = row 0 · row 1 / sigma_u'²     sigma_v' = k sigma_u sigma_v / sigma_u'
//! ```
//!
//! `v_y` is clamped to half of `H` either way: near `H` a point would stay ahead of the shutter for ever, and beyond it be visible in
//! no row or upside down.

pub(crate) mod cpu;
mod formulas;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
mod tensors;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::backend::apply;
use crate::check::{Reference, check_value};
use crate::record::record;
use crate::{CameraModel, Intrinsics, Projected, Result, is_tensor_code};

/// Largest vertical motion over a rolling shutter, as a share of the picture's height. Faster points are clamped to it.
pub(crate) const LARGEST_SHARE: f64 = 0.5;

/// Number of parameters of a motion.
pub(crate) const PARAMETERS: usize = 6;

record! {
    /// Inputs of a change, or their gradients.
    pub(crate) struct Exposed {
        /// `[N, 7]`: packed ellipses.
        projected,
        /// `[6]`: a twist.
        twist,
    }
}

/// How a picture is exposed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OpticsEffect {
    /// The shutter is open while the camera moves.
    MotionBlur,
    /// Rows are read one after the other while the camera moves.
    RollingShutter,
}

/// A change of ellipses but for its tensors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OpticsSpec {
    pub(crate) intrinsics: Intrinsics,
    pub(crate) exposure: OpticsEffect,
    /// Share of half the picture's size by which a centre may lie outside it before its velocity is that at the margin.
    pub(crate) margin: f64,
}

impl OpticsSpec {
    /// Per axis: focal length, principal point, and the limits to which a centre is clamped, px.
    pub(crate) fn axes(&self) -> [[f64; 4]; 2] {
        let Intrinsics { fx, fy, cx, cy, width, height, .. } = self.intrinsics;
        let axis = |focal: f64, principal: f64, size: usize| {
            let reach = 0.5 * self.margin * size as f64;
            [focal, principal, -reach, size as f64 + reach]
        };
        [axis(fx, cx, width), axis(fy, cy, height)]
    }
}

/// Returns the ellipses of a picture that is exposed while the camera moves by `twist`, `[6]`: a rotation vector, rad, and a
/// translation, scene units, of the scene in the camera's frame over the exposure, whose middle has the camera's pose. A camera that
/// moves one unit forward has the translation `(0, 0, −1)`. Differentiable in both.
///
/// `margin` is [`RenderOptions::jacobian_margin`](crate::RenderOptions::jacobian_margin). The approximation is good while the motion is
/// below the width of the moving object.
///
/// # Errors
/// If the camera is not a pinhole, if a shape is not as documented, or if float types or devices differ.
pub fn blurred(projected: &Projected, twist: &Tensor<1>, margin: f64) -> Result<Projected> {
    exposed(projected, twist, OpticsEffect::MotionBlur, margin)
}

/// Returns the ellipses on a sensor that is read row by row, from the upper border to the lower, while the camera moves by `twist`,
/// `[6]`, from the first row to the last, otherwise as [`blurred`]. Differentiable in both. The approximation is good while the motion
/// is far below the picture's height.
///
/// # Errors
/// As [`blurred`].
pub fn rolled(projected: &Projected, twist: &Tensor<1>, margin: f64) -> Result<Projected> {
    exposed(projected, twist, OpticsEffect::RollingShutter, margin)
}

fn exposed(projected: &Projected, twist: &Tensor<1>, exposure: OpticsEffect, margin: f64) -> Result<Projected> {
    let intrinsics = *projected.intrinsics();
    let model = intrinsics.model;
    let expected = "Pinhole, because ellipses are moved and widened for that alone: average renders from several poses \
                    instead, which any camera can do";
    check_value("model", model == CameraModel::Pinhole, format_args!("{model:?}"), expected)?;
    let reference = Reference::new("projected", projected.packed())?;
    reference.check("twist", twist, [Some(PARAMETERS)], "[6]")?;
    let spec = OpticsSpec { intrinsics, exposure, margin };
    if is_tensor_code() {
        return tensors::exposed(projected, twist, &spec);
    }
    let inputs = Exposed { projected: projected.packed().into(), twist: twist.into() };
    Ok(Projected::of(apply(operation::Expose(spec), inputs.into_array()).float(0), intrinsics))
}
