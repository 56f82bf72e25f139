//! The spherical harmonics (SH) stage: coefficients → colours. Differentiable.
//!
//! `colour = max(0, 0.5 + Σₖ Yₖ(d) cₖ)` with `d` the unit direction from the camera's centre to the Gaussian's, `Yₖ` the
//! real spherical harmonics in the order and with the signs of the original code (Kerbl et al. 2023; the polynomials
//! are those of Sloan 2013, "Efficient Spherical Harmonic Evaluation"). The gradient flows to the coefficients and,
//! through the direction, to the centre and the pose; it is zero in a channel that is clamped to zero.
//!
//! # Visibility
//!
//! If the packed ellipses of `project` are given, the stage computes colours only for Gaussians that can show in their picture. The
//! harmonics of all others, which are most of their data, are not read; their colours are zero and have no gradient. A Gaussian
//! cannot show if it is culled, or if the bounding box of its ellipse does not overlap the picture. The ellipse ends where the
//! alpha of a Gaussian with an opacity of 1 falls to `alpha_min`. A pixel is within the box if
//!
//! ```text
//! |x − centre| <= EXTENT_MARGIN · k · (sigma_u,  sigma_v + |shear| sigma_u) + 1 px,   k² = 2 ln(1 / alpha_min) + 0.001
//! ```
//!
//! This box is wider than the extent that `intersect` uses, so that no picture changes. A Gaussian with an opacity above one, which
//! the operation does not forbid, extends beyond the box and always counts as visible.
//!
//! Shapes: coefficients `[N, (degree+1)², 3]`, means `[N, 3]`, pose `[3, 4]`, and packed ellipses `[N, 7]` or none → colours `[N, 3]`.

#[cfg(feature = "cube")]
mod backward;
pub(crate) mod basis;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
pub(crate) mod operation;
#[cfg(test)]
mod tests;
#[cfg(all(test, feature = "cube"))]
mod visible_kernel_tests;
#[cfg(test)]
mod visible_tests;

use crate::record::record;

/// Highest supported degree of the spherical harmonics.
pub const SH_DEGREE_MAX: usize = 4;

/// Number of coefficients per channel at the highest degree.
pub const SH_COEFFICIENTS_MAX: usize = (SH_DEGREE_MAX + 1) * (SH_DEGREE_MAX + 1);

/// Returns the degree that has `coefficients` per channel; `None` unless that is 1, 4, 9, 16 or 25.
pub fn sh_degree(coefficients: usize) -> Option<usize> {
    (0..=SH_DEGREE_MAX).find(|degree| (degree + 1) * (degree + 1) == coefficients)
}

/// Evaluates the real spherical harmonics `Yₖ(d)` for the unit direction `d`.
///
/// Returns the values for `k < (degree+1)²`, degree 0 to 4, in the order of the coefficients, followed by zeros. Source: the
/// polynomials of Sloan 2013, with the order and signs of Kerbl et al. 2023; see [this module](self).
pub fn harmonics(d: [f64; 3], degree: usize) -> [f64; SH_COEFFICIENTS_MAX] {
    basis::basis(d, degree)
}

/// [`sh_degree`] for a number of coefficients that was checked with the input tensors.
pub(crate) fn degree_of(coefficients: usize) -> usize {
    sh_degree(coefficients).expect("the number of coefficients is checked where tensors enter")
}

/// Number of coefficients per channel at a degree.
#[cfg(feature = "cube")]
pub(crate) const fn coefficients_of(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// Length of the vectors that a Gaussian's coefficients are loaded or stored by: rows of vectors of four are aligned to 16 bytes.
#[cfg(feature = "cube")]
const fn vector_width(degree: usize) -> usize {
    if (3 * coefficients_of(degree)).is_multiple_of(4) { 4 } else { 1 }
}

/// Factor by which the box of visibility is wider than in exact arithmetic, and the addend to the square of the extent.
/// `intersect` widens its own square by 1e-5 and adds 1e-4.
const EXTENT_MARGIN: f64 = 1.01;
const EXTENT_SLACK: f64 = 1e-3;

/// Upper limit of the extent in standard deviations: beyond it `exp(−k²/2)` is zero in f32 and f64, whatever `alpha_min` is.
const SIGMAS_MAX: f64 = 64.0;

/// Extent of a Gaussian with an opacity of 1, in standard deviations.
fn extent_sigmas(alpha_min: f64) -> f64 {
    let sigmas = if alpha_min > 0.0 { (EXTENT_SLACK - 2.0 * alpha_min.min(1.0).ln()).sqrt() } else { SIGMAS_MAX };
    EXTENT_MARGIN * sigmas.min(SIGMAS_MAX)
}

record! {
    /// Inputs of the stage.
    pub(crate) struct Shading {
        /// `[N, (degree+1)², 3]` coefficients.
        sh,
        /// `[N, 3]` centres, world frame, scene units.
        means,
        /// `[3, 4]` pose; every entry is a free variable of the gradient.
        cam_from_world,
    }
}
