//! Rasterizes Gaussians: intersections + features → picture. Differentiable.
//!
//! Layers are composited front to back, with `gᵢ = exp(−(u² + v²)/2)` and `αᵢ = min(alpha_max, opacityᵢ gᵢ)` (skipped below `alpha_min`):
//! `C = Σ wᵢ cᵢ + T background`, `wᵢ = αᵢ Tᵢ`, `Tᵢ = Πⱼ₍ⱼ₌₁‥ᵢ₋₁₎ (1 − αⱼ)` (equation 3 of Kerbl et al. 2023). The Gaussian that would bring
//! `T` to `transmittance_min` or below is left out, and so are all Gaussians behind it. The backward pass goes back to front:
//! `∂C/∂αᵢ = Tᵢ (cᵢ − Rᵢ₊₁)`, `Rᵢ = αᵢ cᵢ + (1 − αᵢ) Rᵢ₊₁`, `Rₙ₊₁ = background`. `Tᵢ` is recomputed front to back from checkpoints. Nothing is divided
//! by `1 − α`, and no prefix sum is subtracted from a total: both lose all digits under many layers.
//!
//! Both passes are written once over a trait of splats, for kernels and for the CPU twin. A splat says its alpha at a pixel, and what a
//! pair of it and a pixel adds to its row of sums. There are two: the affine ellipse, and the largest value along the pixel's ray
//! ([`crate::rasterize_rays`]), whose `zᵢ` depends on the pixel.
//!
//! Shapes: packed ellipses `[N, 7]`, features `[N, C]`, background `[C]` → planes `[C + 1 (+ 1), H, W]`: features,
//! alpha `1 − T`, and, if requested, depth `Σ wᵢ zᵢ`.

#[cfg(all(test, feature = "cube"))]
mod alpha_tests;
#[cfg(feature = "cube")]
pub(crate) mod backward;
#[cfg(feature = "cube")]
mod backward_block;
#[cfg(feature = "cube")]
mod backward_groups;
#[cfg(feature = "cube")]
pub(crate) mod blocks;
#[cfg(feature = "cube")]
mod contributors;
mod contributors_cpu;
#[cfg(all(test, feature = "cube"))]
mod contributors_tests;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod ellipse;
#[cfg(test)]
mod features_tests;
pub(crate) mod footprint;
#[cfg(feature = "cube")]
mod forward;
#[cfg(feature = "cube")]
mod gather;
mod gather_cpu;
#[cfg(feature = "cube")]
mod groups;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(feature = "cube")]
pub(crate) mod layer;
mod layer_cpu;
pub(crate) mod operation;
pub(crate) mod pixels;
mod prepared;
#[cfg(feature = "cube")]
pub(crate) mod rows;
#[cfg(feature = "cube")]
mod segment;
#[cfg(feature = "cube")]
pub(crate) mod splat;
pub(crate) mod splat_cpu;
#[cfg(feature = "cube")]
mod suffix;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tile;
mod tile_backward;
pub(crate) mod tile_blocks;
#[cfg(feature = "cube")]
pub(crate) mod trace;

use crate::camera::Intrinsics;
use crate::options::RenderOptions;
use crate::record::record;

/// Number of moments: the sums of `h, h u, h v, h u², h u v, h v²` with `h = α ∂L/∂α` where alpha is not at its limit.
pub(crate) const MOMENTS: usize = 6;

/// Transmittance at which the median of a pixel lies.
pub(crate) const MEDIAN: f64 = 0.5;

record! {
    /// Inputs of the rasterizer.
    pub(crate) struct Layers {
        /// `[N, 7]`: ellipses, packed by `project`.
        projected,
        /// `[N, C]`: features of each Gaussian.
        features,
        /// `[C]`: background of each feature.
        background,
        /// Probe of AbsGrad (Ye et al. 2024): `[N, 2]`, or `[0, 2]` for none. Its values are not read. Its gradient is
        /// `Σ |∂L/∂mean2d|`, a sum of absolute values over the pixels, per px.
        mean2d_abs,
        /// `[N, 9]`, with a lens `[N, 15]`, from `ray_space`; only for Gaussians seen along rays.
        ray_space,
    }
}

record! {
    /// Gradients of the planes of a render, or their absence.
    pub(crate) struct PlaneParts {
        /// `[C, H, W]`: of the features.
        colour,
        /// `[1, H, W]`
        alpha,
        /// `[1, H, W]`, where depth is rendered.
        depth,
    }
}

/// Camera intrinsics and options of the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RasterizeSpec {
    /// Camera intrinsics.
    pub intrinsics: Intrinsics,
    /// Render options.
    pub options: RenderOptions,
}

impl RasterizeSpec {
    /// Number of output planes for `features` channels.
    pub(crate) fn planes(&self, features: usize) -> usize {
        features + 1 + usize::from(self.options.depth)
    }
}
