//! The splat of [`Projection::RayMax`](crate::Projection) for `rasterize`: the largest value of a Gaussian along the pixel's ray.
//! Differentiable.
//!
//! A pixel evaluates a Gaussian at the whitened coordinates `(u, v)` of `project`. With `ρ² = u² + v²` and the Gaussian's
//! `depth_slope` and `thickness` (see `ray_space/`):
//!
//! ```text
//! s = 1 − depth_slope·(u, v)    D = s² + thickness² ρ²    λ = s / D    g = exp(−E),  E = ρ²/(2D),  where s > 0
//! ```
//!
//! Along the pixel's ray the Gaussian is greatest at the camera z `λ z`, where `z` is the camera z of its centre. With the blur
//! taken as a widening of the Gaussian across the ray through its centre, `g` equals this maximum exactly. (In whitened
//! coordinates the points of the ray are `λ(u, v)` and `(λs − 1)/thickness` from the centre, and the minimum over `λ` of
//! `λ²ρ² + (λs − 1)²/thickness²` is `2E`.) Where `s <= 0` the maximum is at the camera or behind it, and the Gaussian does not
//! contribute. The affine projection is the case `depth_slope = thickness = 0`: a Gaussian that is small compared with its
//! distance.
//!
//! # Centres beyond the picture
//!
//! Seen from a centre far outside, the pixels' `u`, `v` and `s` are small differences of large numbers. The origin of
//! `(u, v)`, and of the factor and the depth slope, is therefore the picture's point next to the centre. The centre lies at the
//! whitened coordinates `(α, β)`, with `γ = 1 − depth_slope·(α, β)`. The point `λ` of a ray is then `(a, b) = λ(u, v) − (α, β)` and
//! `(λs − γ)/thickness` from the centre, which for `α = β = 0` is the case above:
//!
//! ```text
//! λ = (sγ + thickness² (uα + vβ)) / D           a = λu − α    b = λv − β    c = (γρ² − s (uα + vβ)) / D
//! 2E = a² + b² + thickness² c²,  where λ > 0    (c = (γ − λs)/thickness², without the cancellation; 2E if the centre is the origin)
//! ```
//!
//! All else is as for ellipses. The depth plane is `Σ wᵢ λᵢ zᵢ`.
//!
//! # Gradient
//!
//! The row of `ray_space` is the Gaussian, and what the row is relative to stays: the origin, the camera z `z` by which
//! depths are divided, and the map of a lens. Only the row has a gradient, and of the ellipse the opacity. With `φ = thickness²/D`,
//! the gradients by the centre `(α, β, γ)` and by the factor are
//!
//! ```text
//! r = (a, b) + c depth_slope     ∂E/∂(α, β) = −r at a fixed relative depth of the centre            ∂E/∂γ = c
//!                                ∂λ/∂(α, β) = φ (u, v) − s/D depth_slope                             ∂λ/∂γ = s/D
//! ∂E/∂depth_slope = c (a, b)     ∂λ/∂depth_slope = s/D (a, b) − φ c (u, v)
//! ∂E/∂thickness = −thickness c²  ∂λ/∂thickness = −2 thickness c s/D
//! ```
//!
//! `(α, β)` and `(u, v)` are whitened by the same factor. So a change of the factor moves `E` by the products of `r` and `(a, b)`, as in `rasterize` by
//! those of `(u, v)` with itself, and `λ` besides by those of `φ r` and `(u, v)`.
//!
//! No term divides by `1 − α`, and a term divides by `s` or `D` only where the value itself does.
//!
//! # Lenses
//!
//! With a lens, a pixel's ray has the slopes `t`, which the host computes once for a camera, and `(u, v)` are the whitened `G (t − t₀)` of
//! `ray_space` in place of the pixel's offset. A pixel without a ray shows the background.
//!
//! Shapes: packed ellipses `[N, 7]`, rows of `ray_space` `[N, 9]`, with a lens `[N, 15]`.

#[cfg(test)]
mod chain_tests;
pub(crate) mod footprint;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod layer;
#[cfg(test)]
mod lens_tests;
#[cfg(feature = "cube")]
mod pair_sums;
#[cfg(test)]
mod tests;

/// Limit of the whitened coordinates; `|s|` is limited to its square, so that no product overflows. A Gaussian beyond this limit
/// is invisible or rendered as if it were infinitely long.
pub(crate) const WHITENED_MAX: f64 = 1e9;

/// Largest `D` that counts as zero: the ray lies in the plane of a flat Gaussian, `1/D` is unusable, and `λ` is set to zero.
pub(crate) const D_MIN: f64 = 1e-30;
