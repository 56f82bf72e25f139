//! Corrections of a camera's pose, and how far a pose is from the directions in which its camera saw known points.
//!
//! A correction rotates the camera by `R(ω)` and moves it by `e τ` in its own frame: `[R₀ | t₀]` becomes `[R R₀ | R t₀ + e τ]`. `R` is
//! the Cayley map of `h = ω/2`, a rotation up to rounding for every `h`:
//!
//! ```text
//! R = I + f (K + K²)     K v = h × v     f = 2 / (1 + |h|²)
//! ```
//!
//! The miss of a pose is the mean of `ρ − r`, `ρ = √(|d − d*|² + r²)`, over known points `x`, with `d = p/|p|` the direction to
//! `p = A x + t` and `d*` the observed one: about the angle between both, rad, where it is large compared with `r`.
//!
//! Both are tensor code on every device.

use burn::tensor::{Tensor, TensorData};

use crate::backend::custom_grad::{constant, plain};
use crate::check::Reference;
use crate::error::Result;
use crate::product::product;

/// The least square of a distance that a direction is divided by.
const LEAST_SQUARE: f64 = 1e-30;

/// Returns the corrected pose `[3, 4]` of a camera with the pose `cam_from_world`, `[3, 4]` f32, or f64 on CPUs. `correction`, `[2, 3]`, is
/// the rotation `ω`, rad, and the movement `τ` in units of `unit`, scene units. Differentiable in both.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn corrected(correction: &Tensor<2>, cam_from_world: &Tensor<2>, unit: f64) -> Result<Tensor<2>> {
    let reference = Reference::new("correction", correction)?;
    reference.check("correction", correction, [Some(2), Some(3)], "[2, 3]")?;
    reference.check("cam_from_world", cam_from_world, [Some(3), Some(4)], "[3, 4]")?;
    let tracked = correction.is_autodiff() || cam_from_world.is_autodiff();
    let (correction, pose) = (constant(correction, tracked), constant(cam_from_world, tracked));
    let half = correction.clone().narrow(0, 0, 1).squeeze_dim::<1>(0) * 0.5;
    let cross = cross_matrix(&half);
    let once = product(cross.clone(), pose.clone());
    let twice = product(cross, once.clone());
    let factor = (half.square().sum() + 1.0).recip().unsqueeze::<2>() * 2.0;
    let moved = correction.narrow(0, 1, 1).transpose() * unit;
    let still = Tensor::zeros([3, 3], (&pose.device(), pose.dtype()));
    Ok(pose + (once + twice) * factor + Tensor::cat(vec![still, moved], 1))
}

/// Returns the matrix of the cross product with `v`, `[3]`: `[3, 3]`. Differentiable.
pub fn cross_matrix(v: &Tensor<1>) -> Tensor<2> {
    // The signs with which each component of `v` enters the matrix, row-major.
    const PLACES: [[f64; 9]; 3] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
    let places = Tensor::<2>::from_data(TensorData::from(PLACES), (&v.device(), v.dtype()));
    product(v.clone().unsqueeze(), places).reshape([3, 3])
}

/// Returns the miss of `pose`, `[3, 4]` f32, or f64 on CPUs, as `[1]`: the mean robust difference between the directions to `points`,
/// `[M, 3]`, world frame, and the observed `directions`, `[M, 3]`, camera frame, of length one. `scale` is the `r` of the module's
/// formula, more than zero. Differentiable in the pose.
///
/// # Errors
/// If a shape is not as documented, or if float types differ.
pub fn miss(pose: &Tensor<2>, points: &Tensor<2>, directions: &Tensor<2>, scale: f64) -> Result<Tensor<1>> {
    let tracked = pose.is_autodiff();
    let values = plain(pose);
    let reference = Reference::new("pose", &values)?;
    let count = points.dims()[0];
    reference.check("pose", &values, [Some(3), Some(4)], "[3, 4]")?;
    reference.check("points", points, [None, Some(3)], "[M, 3]")?;
    reference.check("directions", directions, [Some(count), Some(3)], "[M, 3]")?;
    if count == 0 {
        return Ok(Tensor::zeros([1], (&pose.device(), pose.dtype())));
    }
    let turned = product(constant(points, tracked), pose.clone().narrow(1, 0, 3).transpose());
    let cam = turned + pose.clone().narrow(1, 3, 1).transpose();
    let length = cam.clone().square().sum_dim(1).clamp_min(LEAST_SQUARE).sqrt();
    let squared = (cam / length - constant(directions, tracked)).square().sum_dim(1);
    Ok((squared + scale * scale).sqrt().mean() - scale)
}

#[cfg(test)]
mod tests;
