//! Corrections of a camera's pose, and how far a pose is from the directions in which its camera saw known points.
//!
//! A correction rotates the camera by `R(ω)` and moves it by `e τ` in its own frame: `[R₀ | t₀]` becomes `[R R₀ | R t₀ + e τ]`. `R` is
//! the Cayley map of `h = ω/2`, a rotation up to rounding for every `h`:
//!
//! ```text
//! R = I + f (K + h hᵀ − |h|² I)     K v = h × v     f = 2 / (1 + |h|²)
//! ```
//!
//! With `g = [G | γ]` the gradient of the corrected pose, `B = G R₀ᵀ + γ t₀ᵀ` is that of `R`. With the axial vector
//! `a = (B₂₁ − B₁₂, B₀₂ − B₂₀, B₁₀ − B₀₁)` and `S = a·h + hᵀ B h − |h|² tr B`,
//!
//! ```text
//! ∂h = f (a + (B + Bᵀ) h − 2 (tr B) h) − f² S h     ∂ω = ∂h / 2     ∂τ = e γ
//! ```
//!
//! The miss of a pose is the mean of `ρ − r`, `ρ = √(|d − d*|² + r²)`, over known points `x`, with `d = p/|p|` the direction to
//! `p = A x + t` and `d*` the observed one: about the angle between both, rad, where it is large compared with `r`. With
//! `s = (d − d*)/ρ`, `∂p = (s − d (d·s)) / |p|`, `∂A = Σ ∂p xᵀ` and `∂t = Σ ∂p`, divided by the number of points. It is tensor code.

pub(crate) mod cpu;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::backend::apply;
use crate::backend::custom_grad::constant;
use crate::check::Reference;
use crate::error::SplatError;
use crate::record::record;

/// Numbers of a pose.
#[cfg(any(test, feature = "cube"))]
pub(crate) const POSE: usize = 12;

/// The least square of a distance that a direction is divided by.
const LEAST_SQUARE: f64 = 1e-30;

record! {
    /// Inputs of a correction, or their gradients.
    pub(crate) struct Corrected {
        /// `[2, 3]`: `ω`, rad, and `τ`.
        correction,
        /// `[3, 4]`: the given pose. A constant.
        cam_from_world,
    }
}

/// Returns the corrected pose `[3, 4]` of a camera with the pose `cam_from_world`, `[3, 4]` f32, or f64 on CPUs. `correction`, `[2, 3]`, is
/// the rotation `ω`, rad, and the movement `τ` in units of `unit`, scene units. Differentiable in the correction.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn corrected(correction: &Tensor<2>, cam_from_world: &Tensor<2>, unit: f64) -> Result<Tensor<2>, SplatError> {
    let reference = Reference::new("correction", correction)?;
    reference.check("correction", correction, [Some(2), Some(3)], "[2, 3]")?;
    reference.check("cam_from_world", cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    let inputs = Corrected { correction: correction.into(), cam_from_world: cam_from_world.into() };
    Ok(apply(operation::Correct { unit }, inputs.into_array()).float(0))
}

/// Returns the miss of `pose`, `[3, 4]` f32, or f64 on CPUs, as `[1]`: the mean robust difference between the directions to `points`,
/// `[M, 3]`, world frame, and the observed `directions`, `[M, 3]`, camera frame, of length one. `scale` is the `r` of the module's
/// formula, more than zero. Differentiable in the pose.
///
/// # Errors
/// If a shape is not as documented, or if float types differ.
pub fn miss(pose: &Tensor<2>, points: &Tensor<2>, directions: &Tensor<2>, scale: f64) -> Result<Tensor<1>, SplatError> {
    let tracked = pose.is_autodiff();
    let values = if tracked { pose.clone().inner() } else { pose.clone() };
    let reference = Reference::new("pose", &values)?;
    let count = points.dims()[0];
    reference.check("pose", &values, [Some(3), Some(4)], "[3, 4]")?;
    reference.check("points", points, [None, Some(3)], "[M, 3]")?;
    reference.check("directions", directions, [Some(count), Some(3)], "[M, 3]")?;
    if count == 0 {
        return Ok(Tensor::zeros([1], (&pose.device(), pose.dtype())));
    }
    let turned = constant(points, tracked).matmul(pose.clone().narrow(1, 0, 3).transpose());
    let cam = turned + pose.clone().narrow(1, 3, 1).transpose();
    let length = cam.clone().square().sum_dim(1).clamp_min(LEAST_SQUARE).sqrt();
    let squared = (cam / length - constant(directions, tracked)).square().sum_dim(1);
    Ok((squared + scale * scale).sqrt().mean() - scale)
}
