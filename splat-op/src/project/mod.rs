//! 3D Gaussians → screen-space ellipses. Differentiable.
//!
//! A Gaussian with centre `m`, rotation `R` and standard deviations `s` seen by a camera with rotation `W` has the 2D
//! covariance `Σ = M Mᵀ + ε I` with `M = J W R diag(s)`, where `J` is the Jacobian of the projection at the centre
//! (Zwicker et al. 2001, EWA splatting, eq. 26 to 31; Kerbl et al. 2023, eq. 5) and `ε` the blur. What leaves this stage
//! is not `Σ` nor its inverse but its triangular factor, computed from the rows `m0, m1` of `M` by sums of squares only:
//!
//! ```text
//! Σ = L Lᵀ,  L = | sigma_u          0       |     sigma_u² = |m0|² + ε
//!                | shear · sigma_u  sigma_v |     shear    = m0·m1 / sigma_u²
//!                                                 sigma_v² = ε + |n × m1|² + ε |m1|² / sigma_u²,  n = m0 / sigma_u
//! ```
//!
//! Solving `L (u, v)ᵀ = d` for a pixel's offset `d` whitens it: `u = dx / sigma_u`, `v = (dy − shear dx) / sigma_v`, and
//! the Gaussian is `exp(−(u² + v²)/2)`. Nothing cancels however thin the Gaussian is. The factor holds standard
//! deviations, not variances, so that it stays in range where their squares would overflow.
//!
//! What a lens that is no pinhole changes in `J` is in `lens.rs`.
//!
//! Shapes: means `[N, 3]`, rotations `[N, 4]`, scales `[N, 3]`, opacities `[N]`, pose `[3, 4]` → packed `[N, 7]`.

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
#[cfg(feature = "cube")]
mod lens_backward;
#[cfg(feature = "cube")]
mod lens_forward;
mod lens_simd;
mod simd;
#[cfg(test)]
mod tests;

use crate::camera::Intrinsics;
use crate::options::RenderOptions;
use crate::record::record;

/// Columns of the packed output.
pub(crate) const COLUMNS: usize = 7;

/// The opacity compensation of a render with anti-aliasing is at least this. gsplat's floor; with it a splat far below
/// a pixel keeps a trace and a gradient path to grow by.
pub(crate) const COMPENSATION_MIN: f64 = 0.005;

/// One row of the packed output. A culled Gaussian has all fields zero but `sigma_u = sigma_v = 1`.
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
    /// The geometry of Gaussians and the pose of the camera that sees them.
    pub struct Geometry {
        /// `[N, 3]`, world frame.
        means,
        /// `[N, 4]`, quaternions wxyz of any non-zero length.
        rotations,
        /// `[N, 3]`, standard deviations, scene units.
        scales,
        /// `[N]`, 0 to 1.
        opacities,
        /// `[3, 4]`; in the gradient every entry is taken as free.
        cam_from_world,
        /// The probe at the projected centres: `[N, 2]`, or `[0, 2]` for none, and not read. Its gradient is that of the centres,
        /// per px.
        mean2d,
    }
}

/// The plain numbers the stage depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectSpec {
    /// Camera intrinsics.
    pub intrinsics: Intrinsics,
    /// Render options.
    pub options: RenderOptions,
}
