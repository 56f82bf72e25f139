//! Gaussians in ray space: 3D Gaussians → depth slope, thickness, centre and factor of each, for per-ray rasterization. Differentiable.
//!
//! The stage works in the coordinates (px from the origin, px from the origin, depth relative to the centre's depth), a linear map of the
//! camera frame. The origin is the centre in the picture, or the picture's point next to a centre beyond the picture, `away` px from it. In
//! these coordinates the pinhole's ray through the pixel at the offset `d` is `λ(d, 1)` from the camera, where `λ` is the camera z divided
//! by the camera z of the centre, and the centre is `(away, 1)`. A Gaussian with the image-plane blur has the covariance
//!
//! ```text
//! C = | m0 √ε 0 | | m0 √ε 0 |ᵀ        m0, m1: rows of J W R diag(s), px      mz = (last row of W R diag(s)) / z
//!     | m1 0 √ε | | m1 0 √ε |
//!     | mz 0  0 | | mz 0  0 |
//! ```
//!
//! The triangular factor of `C` is the factor of `project` with one more row, `(depth_slope_u, depth_slope_v, thickness)`. In the
//! following form no term is a difference of other terms; every term is a length or a product of vectors no longer than `|mz|`:
//!
//! ```text
//! n = m0 / sigma_u    bᵤ = √ε / sigma_u    p = n × m1 / sigma_v    a = √ε m1 / (sigma_u sigma_v)    b = √ε / sigma_v
//! depth_slope_u    = mz·n
//! depth_slope_v    = p·c + bᵤ a·mz                                   c = n × mz
//! thickness = |(mz·p, b c, a × mz, b bᵤ mz)|                  = √det C / (sigma_u sigma_v): all 3×3 minors of M, squared
//! ```
//!
//! `depth_slope` is the change of the Gaussian's depth per unit of the whitened `(u, v)` of `project`. `thickness` is the
//! standard deviation of its depth at known `u, v`. Both are relative to the centre's depth, so `1/thickness` is the distance
//! to the camera in standard deviations. The derivation is ours; the maximum along a ray, for which `rasterize` uses it,
//! is due to Keselman and Hebert 2022 and Radl et al. 2024 (StopThePop).
//!
//! Beyond a thickness of `THICKNESS_MAX` the Gaussian has the same value everywhere, and the thickness is clamped. A row that is
//! not finite, or whose Gaussian is over 1e30 times as long as it is far, is set to zero, which is the affine projection.
//!
//! The row of a Gaussian is `depth_slope`, `thickness`, the centre's relative depth 1 and `away`, and the factor of `project`, which has
//! the same origin.
//!
//! # Gradient
//!
//! What a ray sees of a Gaussian depends neither on the origin nor on the linear map: both only say in which coordinates the row is
//! given. So the gradient of the row is taken with both held fixed, and it is the gradient of a step of the centre in them, which is a step in the
//! camera's frame, and of the covariance. With the rows `G (1, −t) / z` and `(0, 0, 1) / z` of the map (a pinhole's `G` is its focal lengths), for
//! `g` the gradient of `away` and `g_z` that of the relative depth,
//!
//! ```text
//! ∂(x, y) = Gᵀ g / z                   ∂z = (g_z + B₀₀ + B₁₁) / z − t·∂(x, y)               ∂G = −B G⁻ᵀ
//! ```
//!
//! The blur alone is given in px, and in the scene it grows with `z` and shrinks with `G`. `B` is its gradient times `√ε`, with one row
//! per axis of the picture. No term is much larger than the sum. (Taken with the map moving along, `∂z` is a sum of eight terms, one from each number
//! of the row, and beside the view they are up to 20,000 times as large as the sum.)
//!
//! The gradient of the rows `m` of the covariance, including the blur, is that of the triangular factor `F` with `C = F Fᵀ`. The
//! matrix `N = F⁻¹ m` has the rows
//!
//! ```text
//! n, bᵤ      p × n + bᵤ a, √ε (−shear, 1) / sigma_v      (p (mz·p) + b² c × n + (a × mz) × a + b² bᵤ² mz, …) / thickness
//! ```
//!
//! of length one, written here without and with their components along the blur of x and y, and
//!
//! ```text
//! ∂mz = ∂depth_slope_u N₀ + ∂depth_slope_v N₁ + ∂thickness N₂
//! ∂m1 = ∂shear / sigma_u N₀ + ∂sigma_v N₁ + w N₂                       w = (∂depth_slope_v thickness − ∂thickness depth_slope_v) / sigma_v
//! ∂m0 = (∂sigma_u − ∂shear shear / sigma_u) N₀ + ((∂depth_slope_u thickness − ∂thickness depth_slope_u) / sigma_u − w shear) N₂
//!     + ((∂shear sigma_v / sigma_u + ∂depth_slope_u depth_slope_v − ∂depth_slope_v depth_slope_u) / sigma_u − ∂sigma_v shear) N₁
//! ```
//!
//! # Bounds
//!
//! Bounds take the ellipse and the depth slope in the coordinates whose origin is the centre. There the rows `x, y, z` of the
//! triangular factor become `x − away_x z`, `y − away_y z` and `z`, which are factored again. An alpha reaches `alpha_min` where
//! `u² + v² <= τ (s² + thickness² (u² + v²))`, `s = 1 − depth_slope·(u, v) > 0`, with `τ = 2 ln(opacity / alpha_min)`. In polar coordinates the region is `r <= c (1 − |depth_slope| r cos φ)`,
//! `c² = τ / (1 − τ thickness²)`: a conic with a focus at the centre and the eccentricity `e = c |depth_slope|`. Where it is an
//! ellipse, with `t = depth_slope / |depth_slope|`,
//!
//! ```text
//! half-axes   c / (1 − e²) along t,  c / √(1 − e²) across        middle   −t e c / (1 − e²)
//! ```
//!
//! the factor of `project` gains the column `L t e / √(1 − e²)` and is scaled. `intersect` reads the opacity of a row only for
//! the extent, so the row gets the opacity for which the extent is `EXTENT`.
//!
//! Beside the camera the conic is a branch of a hyperbola, or an ellipse far larger than the picture. There a bound takes the part
//! in the picture. `s` is linear, so the corners of the picture bound it, `s₀ <= s <= s₁`, and `(s − s₀)(s₁ − s) >= 0` turns
//! `u² + v² <= c² s²` into a disc with the middle `−½ c² (s₀ + s₁) depth_slope`:
//!
//! ```text
//! u² + v² <= c² ((s₀ + s₁) s − s₀ s₁)        radius² = c² (s₀ + s₁ − s₀ s₁) + |middle|²
//! ```
//!
//! Where `s₁ <= 0` or `radius² < 0`, the Gaussian shows nowhere in the picture, and its row has no opacity. Otherwise the
//! row is the smaller of ellipse and disc. Only a Gaussian that holds the camera, `τ thickness² >= 1`, covers the whole picture.
//!
//! # Lenses
//!
//! The slopes `t = (x/z, y/z)` of a camera with a lens are those of a pinhole, in whose picture rays are straight. With the slopes
//! `t₀` of the centre and the Jacobian `G` of the lens, px per slope, at the centre, `d = G (t − t₀)` takes the place of a pixel's
//! offset: `J W R` has the rows of `project` for the lens, `(d, 1) λ` is exactly the ray with the slopes `t`, and the blur is that of
//! the lens's picture around the centre. Everything above holds with this `d`. (For a pinhole `G` is diagonal and `d` the offset.)
//! The rows of the output gain the columns `t₀` and `G`, row by row, which say in which coordinates a row is given and have no gradient.
//!
//! Nothing at 90° from the axis or beyond has slopes, and nothing is seen there.
//!
//! `intersect` needs bounds in the picture. The lens maps the slopes `t₀ + G⁻¹ d` to `mean_px + d + r` with
//! `|r| <= δ = ½ K |t − t₀|²` for an upper bound `K` of the second derivative, so the bounds are the row above and `δ` px all around it.
//! `K` holds up to a quarter (fisheyes: half) of the picture's radius beyond it; rows of centres farther out cover the picture, unless
//! their slopes miss those of the picture. A fisheye maps slopes to angles `a(t)` first, whose second derivative falls towards the border:
//! for `h = (hᵣ, hₜ)` along and across the direction from the axis, at the distance `r` from it, with `θ = atan r`,
//!
//! ```text
//! a'' = (θ'' hᵣ² + (θ/r)' hₜ², 2 (θ/r)' hᵣ hₜ)     |θ''| <= min(0.65, 2/r³)     |(θ/r)'| <= min(0.3, π/(2r²))
//! ```
//!
//! Shapes: inputs as in `project` → `[N, 9]`, with a lens `[N, 15]`; packed ellipses `[N, 7]` and these rows → bounds
//! `[N, 7]`, not differentiable, for `intersect` only. Rows of Gaussians that `project` culls are undefined and have no gradient.

#[cfg(feature = "cube")]
mod backward;
mod bounds;
#[cfg(feature = "cube")]
mod bounds_kernel;
pub(crate) mod cpu;
mod formulas;
#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod lens_bounds;
#[cfg(test)]
mod lens_tests;
pub(crate) mod operation;
mod simd;
#[cfg(test)]
mod tests;

pub(crate) use cpu::{beyond, bounds_cpu};
#[cfg(feature = "cube")]
pub(crate) use forward::KernelFrame;
pub(crate) use lens_bounds::{LensFrame, LensLimits};

use crate::camera::{CameraModel, Intrinsics};

/// Number of columns of the depth slope and the thickness.
pub(crate) const DEPTH_SLOPE: usize = 3;

/// Number of columns of the depth slope, the thickness and the relative depth of the centre.
pub(crate) const SLOPES: usize = DEPTH_SLOPE + 1;

/// Number of columns of the offset of the centre from the origin, px, `sigma_u`, the shear and `sigma_v`: the first ones of a packed
/// ellipse.
pub(crate) const SHAPE: usize = 5;

/// Number of columns of the output without those of a lens.
pub(crate) const RAY_SPACE: usize = SLOPES + SHAPE;

/// Number of columns of a lens: the slopes of the centre, and `G` row by row.
pub(crate) const LENS_FRAME: usize = 6;

/// Number of columns of the output with a lens.
pub(crate) const LENS_COLUMNS: usize = RAY_SPACE + LENS_FRAME;

/// Number of columns of the output.
pub(crate) fn columns(camera: &Intrinsics) -> usize {
    if camera.model == CameraModel::Pinhole { RAY_SPACE } else { LENS_COLUMNS }
}

/// Largest thickness. With the camera a billionth of a standard deviation from the centre, the Gaussian is one to the last digit of an f64.
pub(crate) const THICKNESS_MAX: f64 = 1e9;

/// `√(u² + v²)` at which the alpha of a bounds row is `alpha_min`.
pub(crate) const EXTENT: f64 = 2.0;

/// Relative and absolute excess of the `τ` of bounds: more than the accumulated rounding errors.
pub(crate) const SLACK: [f64; 2] = [1e-3, 1e-3];

/// Relative rounding error of a disc: more than its terms accumulate in f32. Both twins and both floats take this one, so that their
/// discs agree.
pub(crate) const ROUNDING: f64 = 64.0 * f32::EPSILON as f64;

/// Smallest `1 − e²` and `1 − τ thickness²` that keep enough digits after rounding.
pub(crate) const LEAST_REMAINDER: f64 = 1e-3;
