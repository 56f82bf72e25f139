//! `project` and `shade` in one pass over the Gaussians, as a render that needs both takes them. Differentiable.
//!
//! The functions are those of the two stages; what is saved is what lies between them. Parameters are read once, the two
//! gradients of the means are added where they arise, and a Gaussian that cannot show in the picture is not shaded: its
//! harmonics, most of what there is to read of it, are left alone, and its colour is zero. It cannot show if it is culled,
//! or if the box around its ellipse, out to where an opacity of 1 falls to `alpha_min`, does not meet the picture:
//!
//! ```text
//! |x − centre| <= REACH_MARGIN · k · (sigma_u,  sigma_v + |shear| sigma_u) + 1 px,   k² = 2 ln(1 / alpha_min) + 0.001
//! ```
//!
//! which is wider than what `tile` lists, so that no picture changes.
//!
//! Gaussians whose colour does not vary with the direction may come last, as *matte* ones of degree 0 whatever the degree of
//! the others is: the first `M` have coefficients `[M, (degree+1)², 3]`, the other `N − M` have `[N − M, 1, 3]`. It is as if
//! those had coefficients of zero for all higher degrees, which nobody reads, and whose gradients nobody computes. Without
//! matte ones `M` is `N`, and the kernels are compiled without them.
//!
//! Shapes: means `[N, 3]`, rotations `[N, 4]`, scales `[N, 3]`, opacities `[N]`, coefficients `[M, (degree+1)², 3]` and
//! `[N − M, 1, 3]`, pose `[3, 4]` → packed `[N, 7]` and colours `[N, 3]`. The pose is a constant here: where it is trained,
//! the two stages run one after the other.

#[cfg(feature = "cube")]
mod backward;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType};

use crate::op::Slot;
use crate::project::{ProjectGrads, ProjectInputs, ProjectNeeds};

/// How much wider the box is than exact arithmetic would have it, and what is added to the square of the reach. `tile` widens
/// its own square by 1e-5 and adds 1e-4.
pub(crate) const REACH_MARGIN: f64 = 1.01;
const REACH_SLACK: f64 = 1e-3;

/// No exponential of f32 or f64 tells `exp(−k²/2)` from zero here, whatever `alpha_min` is.
const SIGMAS_MAX: f64 = 64.0;

/// Standard deviations out to which a Gaussian of opacity 1 may show.
pub(crate) fn reach_sigmas(alpha_min: f64) -> f64 {
    let sigmas = if alpha_min > 0.0 { (REACH_SLACK - 2.0 * alpha_min.min(1.0).ln()).sqrt() } else { SIGMAS_MAX };
    REACH_MARGIN * sigmas.min(SIGMAS_MAX)
}

/// Inputs of both stages.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ProjectShadeInputs<B: Backend> {
    /// Of `project`; its means and pose are also those of `shade`.
    #[extension_type]
    pub geometry: ProjectInputs<B>,
    /// `[M, (degree+1)², 3]`: of the first Gaussians, or of all.
    pub sh: FloatTensor<B>,
    /// `[N − M, 1, 3]`: of the others, if there are others.
    #[extension_type]
    pub matte: Slot<B>,
}

/// What both stages return.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ProjectedColours<B: Backend> {
    /// `[N, 7]`, packed ellipses.
    pub packed: FloatTensor<B>,
    /// `[N, 3]`; zero where a Gaussian cannot show.
    pub colours: FloatTensor<B>,
}

/// Gradients of the inputs, each only where it was asked for.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ProjectShadeGrads<B: Backend> {
    /// Those of the means from both stages; never that of the pose.
    #[extension_type]
    pub geometry: ProjectGrads<B>,
    /// `[M, (degree+1)², 3]`.
    #[extension_type]
    pub sh: Slot<B>,
    /// `[N − M, 1, 3]`.
    #[extension_type]
    pub matte: Slot<B>,
}

/// Which gradients are asked for; `geometry.cam_from_world` must not be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProjectShadeNeeds {
    pub geometry: ProjectNeeds,
    pub sh: bool,
    /// Only where there are matte Gaussians.
    pub matte: bool,
}
