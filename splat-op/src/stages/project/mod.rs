//! The projection stage: 3D Gaussians → screen-space ellipses. Differentiable.
//!
//! A Gaussian with centre `m`, rotation `R` and standard deviations `s` seen by a camera with rotation `W` has the 2D
//! covariance `Σ = M Mᵀ + ε I` with `M = J W R diag(s)`, where `J` is the Jacobian of the projection at the centre
//! (Zwicker et al. 2001, EWA splatting, eq. 26 to 31; Kerbl et al. 2023, eq. 5) and `ε` the blur. The stage returns neither
//! `Σ` nor its inverse but its triangular factor, computed from the rows `m0, m1` of `M` by sums of squares only:
//!
//! ```text
//! Σ = L Lᵀ,  L = | sigma_u          0       |     sigma_u² = |m0|² + ε
//!                | shear · sigma_u  sigma_v |     shear    = m0·m1 / sigma_u²
//!                                                 sigma_v² = ε + |n × m1|² + ε |m1|² / sigma_u²,  n = m0 / sigma_u
//! ```
//!
//! Solving `L (u, v)ᵀ = d` whitens a pixel's offset `d`: `u = dx / sigma_u`, `v = (dy − shear dx) / sigma_v`, and
//! the Gaussian is `exp(−(u² + v²)/2)`. No term cancels however thin the Gaussian is. The factor holds standard
//! deviations instead of variances, so that it stays in range where their squares would overflow.
//!
//! A covariance `C Cᵀ` in the world frame takes `C` in place of `R diag(s)`, a lower triangle: `rotations` holds
//! `C₀₀, C₁₀, C₁₁, C₂₀`, and `scales` `C₂₁, C₂₂` and a number that is not read.
//!
//! `lens.rs` has the `J` of lenses other than the pinhole.
//!
//! Shapes: means `[N, 3]`, rotations `[N, 4]`, scales `[N, 3]`, opacities `[N]`, pose `[3, 4]` → packed `[N, 7]`.

#[cfg(feature = "cube")]
pub(crate) mod axis;
#[cfg(feature = "cube")]
pub(crate) mod backward;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod lens;
pub(crate) mod lens_formulas;
#[cfg(feature = "cube")]
pub(crate) mod lens_kernel;
pub(crate) mod operation;
pub(crate) mod simd;
pub(crate) mod simd_backward;
#[cfg(all(test, feature = "cube"))]
mod testing;
#[cfg(test)]
mod tests;

use crate::record::record;
use crate::{Intrinsics, RenderOptions};

/// Number of columns of the packed output.
pub(crate) const COLUMNS: usize = 7;

/// The column of the opacity, the last one.
pub(crate) const OPACITY: usize = 6;

/// Number of standard deviations that the radius of a splat has, for [`RenderOptions::radius_clip`] and
/// [`Projected::radii`](crate::Projected::radii).
pub(crate) const RADIUS_SIGMAS: f64 = 3.0;

/// Lower limit of the opacity compensation of an anti-aliased render, as in gsplat. It leaves a splat much smaller than a pixel
/// visible enough to have a gradient by which it can grow.
pub(crate) const COMPENSATION_MIN: f64 = 0.005;

/// One row of the packed output. All fields of a culled Gaussian are zero except `sigma_u = sigma_v = 1`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Ellipse<F> {
    /// Centre, px.
    pub mean_px: [F; 2],
    /// Factor of the 2D covariance: px, px per px, px.
    pub sigma_u: F,
    pub shear: F,
    pub sigma_v: F,
    /// Camera z of the centre, scene units.
    pub depth: F,
    /// Opacity, compensated if the render is anti-aliased.
    pub opacity: F,
}

impl<F: Copy> Ellipse<F> {
    #[inline(always)]
    pub fn from_row(row: &[F]) -> Self {
        Self {
            mean_px: [row[0], row[1]],
            sigma_u: row[2],
            shear: row[3],
            sigma_v: row[4],
            depth: row[5],
            opacity: row[6],
        }
    }

    #[inline(always)]
    pub fn to_row(self) -> [F; COLUMNS] {
        [self.mean_px[0], self.mean_px[1], self.sigma_u, self.shear, self.sigma_v, self.depth, self.opacity]
    }
}

record! {
    /// Inputs of the stage: the geometry of Gaussians and the pose of a camera.
    pub(crate) struct Geometry {
        /// `[N, 3]`: centres, world frame, scene units.
        means,
        /// `[N, 4]`: quaternions wxyz, world-from-Gaussian, of any non-zero length.
        rotations,
        /// `[N, 3]`: standard deviations, scene units.
        scales,
        /// `[N]`: opacities, 0 to 1.
        opacities,
        /// `[3, 4]`: pose; every entry is a free variable of the gradient.
        cam_from_world,
        /// `[N, 2]`, or `[0, 2]` for none: probe at the projected centres. Its values are not read; its gradient is that of the
        /// centres, per px.
        mean2d,
    }
}

/// Columns of the gradients with a row per Gaussian; the pose has none.
pub(crate) const WIDTHS: Geometry<usize> =
    Geometry { means: 3, rotations: 4, scales: 3, opacities: 1, cam_from_world: 0, mean2d: 2 };

/// Parameters of the stage that are not tensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ProjectSpec {
    /// Camera intrinsics.
    pub intrinsics: Intrinsics,
    /// Render options.
    pub options: RenderOptions,
    /// Whether rotations and scales hold factors of covariances; see the module.
    pub factors: bool,
}
