//! The contract of lenses: the equations of `project` for cameras that are not pinholes. `lens_formulas.rs` computes them
//! for kernels and twins; the models' equations are those of [`CameraModel`](crate::CameraModel).
//!
//! A lens has two steps. The first maps the centre `(x, y, z)` in the camera's frame to slopes or angles `s`. The rows of its
//! Jacobian times `W R` are `bₖ`, with the rows `rowₖ` and `last` of `W R`:
//!
//! ```text
//! perspective   s = (x, y)/z     bₖ = (rowₖ − sₖ last) / z
//! orthographic  s = (x, y)       bₖ = rowₖ
//! fisheye       s = α p          bₖ = (α rowₖ + pₖ (β p·row − last)) / R       (p, c) = (x, y, z)/R,  R = |(x, y, z)|
//!                                   = (c rowₖ − β p⊥ₖ p⊥·row − pₖ last) / R      p⊥ = (−p_y, p_x)
//! ```
//!
//! The last line is what is computed. Away from the axis a fisheye shrinks the picture along `p` by `c = α + β |p|²`, which near 90° is a
//! small difference of `α` and `−β |p|²`.
//!
//! The second is the planar map `d(s)`, with the Jacobian `A` and, contracted with any 2×2 matrix `M`, the second derivative
//!
//! ```text
//! A = (g + 2 P·s) I + 2g' s sᵀ + 2 s Pᵀ + 2 (P + S) sᵀ                             g and its derivatives at w = |s|²
//! Σᵢⱼ Mᵢⱼ ∂Aᵢⱼ/∂s = 2g' (tr M s + M s + Mᵀs) + 4g'' (sᵀM s) s + 2 (tr M P + M P + Mᵀ(P + S))
//! ```
//!
//! The rows of `J W R` are `jᵢ = fᵢ Σₖ Aᵢₖ bₖ`. As for a pinhole, the slopes at which a perspective lens's `A` and `b` are evaluated
//! are clamped near the picture. The angles of a fisheye are not clamped, because its Jacobian is exact everywhere. An orthographic
//! camera has no planar map, and its centre's z gets no gradient but that of the depth.
//!
//! For the angle `θ` from the axis, `α = θ/sin θ`, `β = (cos θ − α)/sin² θ` and, for the gradient, `δ = −(2 cos θ + 3β)/sin² θ`. They are
//! smooth, but these forms are 0/0 on the axis and differences of almost equal numbers near it. With `v = tan²(θ/2) = |p|²/(1 + c)²`, at
//! most one in front of the camera, and the smooth `h(v) = (atan(√v)/√v − 1 + v/3)/v²` they are
//!
//! ```text
//! α = (1 + v)(1 + v a)                     a = v h − 1/3
//! β = −(1 + v)(3 + v + (1 + v)² a)/4
//! δ = (1 + v)(25 + 9v − v² − v³ + 3 (1 + v)⁴ h)/16
//! ```
//!
//! These forms contain no cancellation and no division. `h` is computed by a polynomial, fitted below.
//!
//! The gradient of the first step of a fisheye, given `Gₖ`, the gradients of `bₖ` over `R`, and `e`, the gradient of `s`, with
//! `Σ = Σₖ pₖ Gₖ`, `q = p·row`, `u = Σₖ Gₖ·rowₖ`, `m = Σ·q`, `l = Σ·last`, is
//!
//! ```text
//! grad rowₖ = α Gₖ + β pₖ Σ        grad last = −Σ
//! grad pₖ   = Gₖ·(β q − last) + β Σ·rowₖ + pₖ (β u + δ m + 2 l) + α eₖ + β pₖ p·e
//! grad c    = −u + 2 m + 2 c l − p·e
//! ```
//!
//! The gradients of `p` and `c` over `R` are those of `(x, y, z)`. `R` counts as a constant here: the rows are homogeneous of
//! degree −1 in `(x, y, z)`, so they are those of `(p, c)` over `R` for any constant `R`. The length `|(x, y, z)|` is the
//! constant that keeps all numbers near one.

/// Coefficients of `h` for `0 <= v <= 1`, in f32, highest power first: within 3.6e-10 (a fit at Chebyshev points).
pub(super) const HALF_ANGLE_F32: [f64; 11] = [
    8.395_352_4e-4,
    -5.553_743_3e-3,
    1.717_368_4e-2,
    -3.397_918_4e-2,
    5.059_253e-2,
    -6.417_259e-2,
    7.643_183_6e-2,
    -9.085_104e-2,
    1.111_075_2e-1,
    -1.428_570_6e-1,
    0.2,
];

/// Coefficients of `h` for `0 <= v <= 1`, in f64, highest power first: within 5e-18.
pub(super) const HALF_ANGLE_F64: [f64; 21] = [
    1.112_771_540_375_668_2e-5,
    -1.286_735_171_570_008_6e-4,
    7.064_724_175_446_074e-4,
    -2.463_081_237_131_339_5e-3,
    6.169_285_162_279_093e-3,
    -1.195_265_193_517_671_2e-2,
    1.892_972_943_813_042_4e-2,
    -2.571_931_329_402_559e-2,
    3.137_615_770_963_314e-2,
    -3.583_375_154_538_026e-2,
    3.962_496_306_867_305e-2,
    -4.338_554_783_545_28e-2,
    4.760_118_265_744_453e-2,
    -5.262_895_468_205_042e-2,
    5.882_324_405_222_66e-2,
    -6.666_664_460_278_278e-2,
    7.692_307_577_776_057e-2,
    -9.090_909_087_250_795e-2,
    1.111_111_111_104_893_7e-1,
    -1.428_571_428_571_386_4e-1,
    0.2,
];
