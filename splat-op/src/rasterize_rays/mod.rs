//! Tile lists + features → picture, along the pixels' rays. Differentiable. In the place of `rasterize` where
//! [`RenderOptions::projection`](crate::RenderOptions) or `order` is not the plain one.
//!
//! A pixel sees a Gaussian at the whitened coordinates `(u, v)` of `project`, and with `ρ² = u² + v²` and the Gaussian's
//! `depth_slope` and `thickness` (see `depth_slope/`)
//!
//! ```text
//! s = 1 − depth_slope·(u, v)    D = s² + thickness² ρ²    λ = s / D
//! Affine   g = exp(−E),  E = ρ²/2               Exact   g = exp(−E),  E = ρ²/(2D),  where s > 0
//! ```
//!
//! `λ z` is the camera z at which the Gaussian is greatest along the pixel's ray, `z` that of its centre; with the blur as a
//! widening of the Gaussian across the ray through its centre, `g` is that greatest value, exactly. (With the ray's points
//! `λ(u, v)` and `(λs − 1)/thickness` from the centre in whitened coordinates, `2E = λ²ρ² + (λs − 1)²/thickness²` at its least.)
//! Where `s <= 0` that place is at the camera or behind it, and the Gaussian is not seen. The affine projection is that with
//! `depth_slope = thickness = 0`: of a Gaussian that is small beside its distance. (Where its Jacobian is held at a limit, so it is for
//! the `λ` that orders its layers.)
//!
//! Alphas, thresholds, sums and the gradient back to front are those of `rasterize`, over the same lists. Their order is that of
//! the lists (camera z of the centres, then the index), or for each pixel that of `λ z`, then the index; by it alone is decided
//! which contributions are behind a `transmittance_min`. The depth plane is `Σ wᵢ zᵢ` for the affine projection and `Σ wᵢ λᵢ zᵢ`
//! for the exact one.
//!
//! # Gradient
//!
//! An order is constant but where it changes: the gradient is that of the values blended in it. For the affine projection the
//! depth slope, which then decides the order alone, has none. With `φ = thickness²/D` and `κ = 2Eφ − λ² = ∂λ/∂s`,
//!
//! ```text
//! ∂E/∂(u, v) = λ (λ (u, v) + 2E depth_slope)        ∂E/∂depth_slope = 2Eλ (u, v)      ∂E/∂thickness = −4E² thickness
//! ∂λ/∂(u, v) = −2λφ (u, v) − κ depth_slope          ∂λ/∂depth_slope = −κ (u, v)       ∂λ/∂thickness = −4Eλ thickness
//! ```
//!
//! in which nothing is divided by `1 − α`, and by `s` or `D` only where the value is. Each intersection has a row of its own for its
//! sums over the tile's pixels, and a Gaussian's rows are added in the order of its intersections: on every device the same bits in
//! every run, whatever [`Accumulation`](crate::Accumulation) says.
//!
//! Shapes: packed ellipses `[N, 7]`, depth slopes `[N, 3]`, features `[N, C]`, background `[C]` → planes as `rasterize`.

#[cfg(feature = "cube")]
mod backward;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(feature = "cube")]
mod layer;
mod pixel;
#[cfg(test)]
mod tests;

use crate::record::record;

/// Whitened coordinates are held at this, and `|s|` at its square, so that no product overflows. What lies there is not seen, or
/// seen as if it were infinitely long.
pub(crate) const WHITENED_MAX: f64 = 1e9;

/// A `D` at or below this has no inverse to reckon with: the ray passes along a sheet, and `λ` counts as zero.
pub(crate) const D_MIN: f64 = 1e-30;

/// Sums of an intersection over a tile's pixels besides those of its channels: of `h = α ∂L/∂α` where alpha is not at its limit; of the
/// gradients `p, q` of `u` and `v`, then of `p u, q u, q v`; of those of the depth slopes and the thickness; of that of the depth.
pub(crate) const SUMS: usize = 10;

record! {
    /// What is blended along the pixels' rays.
    pub struct RayLayers {
        /// `[N, 7]`, packed by `project`.
        projected,
        /// `[N, 3]`, of `depth_slope`.
        depth_slope,
        /// `[N, C]`.
        features,
        /// `[C]`.
        background,
        /// The probe of AbsGrad, as that of `rasterize`.
        mean2d_abs,
    }
}
