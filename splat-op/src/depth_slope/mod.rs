//! 3D Gaussians → how each leans in depth, for pixels that look along their rays. Differentiable.
//!
//! With the camera at `(0, 0, −1)`, in coordinates (px from the centre, px from the centre, depth relative to the centre's),
//! which are a linear map of the camera's frame, the pinhole's ray through the pixel at the offset `d` is `λ(d, 1)` from the
//! camera, `λ` the camera z by that of the centre. A Gaussian with the blur on the picture has there the covariance
//!
//! ```text
//! C = | m0 √ε 0 | | m0 √ε 0 |ᵀ        m0, m1: rows of J W R diag(s), px      mz = (last row of W R diag(s)) / z
//!     | m1 0 √ε | | m1 0 √ε |
//!     | mz 0  0 | | mz 0  0 |
//! ```
//!
//! whose triangular factor is that of `project` with one more row, `(depth_slope_u, depth_slope_v, thickness)`. So written, no term is a
//! difference of others and all are lengths or products of vectors no longer than `|mz|`:
//!
//! ```text
//! n = m0 / sigma_u    bᵤ = √ε / sigma_u    p = n × m1 / sigma_v    a = √ε m1 / (sigma_u sigma_v)    b = √ε / sigma_v
//! depth_slope_u    = mz·n
//! depth_slope_v    = p·c + bᵤ a·mz                                   c = n × mz
//! thickness = |(mz·p, b c, a × mz, b bᵤ mz)|                  = √det C / (sigma_u sigma_v): all 3×3 minors of M, squared
//! ```
//!
//! `depth_slope` is by how much the Gaussian's depth changes with the whitened `(u, v)` of `project`, and `thickness` its standard
//! deviation in depth where `u, v` are known, all relative to the centre's depth: `1/thickness` is the camera's distance in
//! standard deviations. The derivation is ours; what `rasterize_rays` makes of it is that of a maximum along a ray (Keselman and Hebert
//! 2022; Radl et al. 2024, StopThePop).
//!
//! Beyond a thickness of `THICKNESS_MAX` the Gaussian is the same everywhere, and the thickness is held; a row that is not
//! finite, of a Gaussian 1e30 times as long as it is far, is zero, which is the affine projection.
//!
//! # Bounds
//!
//! `u² + v² <= τ (s² + thickness² (u² + v²))`, `s = 1 − depth_slope·(u, v) > 0`, is where an alpha reaches `alpha_min`, with
//! `τ = 2 ln(opacity / alpha_min)`. In polar coordinates that is `r <= c (1 − |depth_slope| r cos φ)`, `c² = τ / (1 − τ thickness²)`: a
//! conic with a focus in the centre and the eccentricity `e = c |depth_slope|`. Where it is an ellipse, with `t = depth_slope / |depth_slope|`,
//!
//! ```text
//! half-axes   c / (1 − e²) along t,  c / √(1 − e²) across        middle   −t e c / (1 − e²)
//! ```
//!
//! the factor of `project` gets the column `L t e / √(1 − e²)` and is scaled. The stage `intersect`, which reads a row's opacity for
//! the reach alone, is given one for which that is `EXTENT`. Elsewhere a row covers the whole picture.
//!
//! Shapes: as `project` → `[N, 3]`; packed `[N, 7]` and those → bounds `[N, 7]`, not differentiable, for `intersect` alone. Rows of
//! what `project` culls mean nothing, and have no gradient.

#[cfg(feature = "cube")]
mod backward;
mod bounds;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(test)]
mod tests;

pub(crate) use bounds::bounds_cpu;

/// Columns of the output.
pub(crate) const DEPTH_SLOPE: usize = 3;

/// From a camera that is a billionth of a standard deviation from a centre, the Gaussian is one to the last digit of an f64.
pub(crate) const THICKNESS_MAX: f64 = 1e9;

/// `√(u² + v²)` at which the alpha of a bound's row is `alpha_min`.
pub(crate) const EXTENT: f64 = 2.0;

/// By how much a bound's `τ` is too large, relatively and absolutely: more than all rounding on the way.
pub(crate) const SLACK: [f64; 2] = [1e-3, 1e-3];

/// The least `1 − e²` and `1 − τ thickness²` of which rounding leaves enough.
pub(crate) const LEAST: f64 = 1e-3;
