//! Spherical harmonics → colour. Differentiable.
//!
//! `colour = max(0, 0.5 + Σₖ Yₖ(d) cₖ)` with `d` the unit direction from the camera's centre to the Gaussian's, `Yₖ` the
//! real spherical harmonics in the order and with the signs of the original code (Kerbl et al. 2023; the polynomials
//! are those of Sloan 2013, "Efficient Spherical Harmonic Evaluation"). The gradient flows to the coefficients and,
//! through the direction, to the centre and the pose; it is zero in a channel that the clamp holds at zero.
//!
//! Coefficients may be half-precision numbers where everything else is f32 or f64 ([`crate::Storage`]): they are read as such, and
//! all that is computed, their gradients too, is of the other type.
//!
//! # Who is visible
//!
//! Given the packed ellipses of `project` as well, the stage shades what can show in their picture alone. The harmonics of all
//! others, most of what there is to read of them, are left alone; their colours are zero and have no gradient. A Gaussian cannot
//! show if it is culled, or if the box around its ellipse, out to where an opacity of 1 falls to `alpha_min`, does not meet the
//! picture:
//!
//! ```text
//! |x − centre| <= REACH_MARGIN · k · (sigma_u,  sigma_v + |shear| sigma_u) + 1 px,   k² = 2 ln(1 / alpha_min) + 0.001
//! ```
//!
//! which is wider than what `intersect` lists, so that no picture changes. An opacity above one, which the op does not forbid, reaches
//! further than the box, and always counts as visible.
//!
//! Shapes: coefficients `[N, (degree+1)², 3]`, means `[N, 3]`, pose `[3, 4]`, and packed ellipses `[N, 7]` or none → colours
//! `[N, 3]`.

#[cfg(feature = "cube")]
mod backward;
mod basis;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(test)]
mod tests;
#[cfg(all(test, feature = "cube"))]
mod visible_kernel_tests;
#[cfg(test)]
mod visible_tests;

#[cfg(feature = "cube")]
use crate::dials::Storage;
use crate::record::record;

/// The highest degree of spherical harmonics.
pub const SH_DEGREE_MAX: usize = 4;

/// Coefficients per channel at the highest degree.
pub const SH_COEFFICIENTS_MAX: usize = (SH_DEGREE_MAX + 1) * (SH_DEGREE_MAX + 1);

/// The degree that a number of coefficients per channel stands for; `None` unless it is 1, 4, 9, 16 or 25.
pub fn sh_degree(coefficients: usize) -> Option<usize> {
    (0..=SH_DEGREE_MAX).find(|degree| (degree + 1) * (degree + 1) == coefficients)
}

/// The real spherical harmonics `Yₖ(d)` of the unit direction `d`, for `k < (degree+1)²` with a degree of 0 to 4, in the order
/// of the coefficients; zero from there on.
pub fn harmonics(d: [f64; 3], degree: usize) -> [f64; SH_COEFFICIENTS_MAX] {
    basis::basis(d, degree)
}

/// [`sh_degree`] of a number of coefficients that was checked where tensors entered.
pub(crate) fn degree_of(coefficients: usize) -> usize {
    sh_degree(coefficients).expect("the number of coefficients is checked where tensors enter")
}

/// Coefficients per channel at a degree.
#[cfg(feature = "cube")]
const fn coefficients_of(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// What a kernel is compiled for.
#[cfg(feature = "cube")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Harmonics {
    /// 0 to 4.
    pub degree: usize,
    /// Of the coefficients, in memory.
    pub storage: Storage,
}

#[cfg(feature = "cube")]
impl Harmonics {
    /// Coefficients per channel.
    pub const fn coefficients(self) -> usize {
        coefficients_of(self.degree)
    }
}

/// How much wider the box of what is visible is than exact arithmetic would have it, and what is added to the square of the
/// reach. `intersect` widens its own square by 1e-5 and adds 1e-4.
const REACH_MARGIN: f64 = 1.01;
const REACH_SLACK: f64 = 1e-3;

/// No exponential of f32 or f64 tells `exp(−k²/2)` from zero here, whatever `alpha_min` is.
const SIGMAS_MAX: f64 = 64.0;

/// Standard deviations out to which a Gaussian of opacity 1 may show.
fn reach_sigmas(alpha_min: f64) -> f64 {
    let sigmas = if alpha_min > 0.0 { (REACH_SLACK - 2.0 * alpha_min.min(1.0).ln()).sqrt() } else { SIGMAS_MAX };
    REACH_MARGIN * sigmas.min(SIGMAS_MAX)
}

record! {
    /// What colours are computed from.
    pub struct Shading {
        /// `[N, (degree+1)², 3]`, of half precision or of the type of the others, which its gradient has.
        sh,
        /// `[N, 3]`, world frame.
        means,
        /// `[3, 4]`; in the gradient every entry is taken as free.
        cam_from_world,
    }
}
