//! Lenses for eight Gaussians at a time, one per SIMD lane: the arithmetic of the contract in `lens.rs`, both passes.

use burn::tensor::DType;
use fearless_simd::prelude::*;

use super::lens::{HALF_ANGLE_F32, HALF_ANGLE_F64};
use crate::camera::{CameraModel, Intrinsics};
use crate::linalg::{Entry, Matrix3, add, dot, scale, sub};
use crate::simd::each;
use crate::simd::lanes::{Lanes, MaskOf, Vector, norm};
use crate::simd::real::Real;

/// A lens's planar map, as numbers or broadcast to all lanes.
#[derive(Clone, Copy)]
pub(crate) struct DistortionSimd<L> {
    model: CameraModel,
    radial: [L; 4],
    denominator: [L; 3],
    /// `P` and `S` of the contract.
    tangential: [L; 2],
    prism: [L; 2],
    /// Square of the radius of the lens's domain; Gaussians at or beyond that radius are culled.
    max_radius_squared: L,
}

impl<F: Real> DistortionSimd<F> {
    /// `None` for a pinhole.
    pub fn new(camera: &Intrinsics) -> Option<Self> {
        let found = camera.coefficients();
        (camera.model != CameraModel::Pinhole).then(|| Self {
            model: camera.model,
            radial: found.radial.map(F::of),
            denominator: found.denominator.map(F::of),
            tangential: found.tangential.map(F::of),
            prism: found.prism.map(F::of),
            max_radius_squared: F::of(camera.max_radius().powi(2)).min_of(F::MAX),
        })
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, simd: S) -> DistortionSimd<F::Lanes<S>> {
        let lanes = |value: F| F::Lanes::<S>::splat(simd, value);
        DistortionSimd {
            model: self.model,
            radial: each!(self.radial, |value| lanes(value)),
            denominator: each!(self.denominator, |value| lanes(value)),
            tangential: each!(self.tangential, |value| lanes(value)),
            prism: each!(self.prism, |value| lanes(value)),
            max_radius_squared: lanes(self.max_radius_squared),
        }
    }
}

/// The planar map and its derivatives at one position.
struct PlanarMapSimd<L> {
    s: [L; 2],
    value: [L; 2],
    /// `A` of the contract, row by row.
    by: [[L; 2]; 2],
    /// `2g'` and `4g''`.
    twice_slope: L,
    four_bend: L,
}

impl<L: Copy> DistortionSimd<L> {
    /// `g`, `g'` and `g''` at `w`.
    #[inline(always)]
    fn radial<S: Simd, F: Real<Lanes<S> = L>>(&self, w: L) -> [L; 3]
    where
        L: SimdFloat<S, Element = F>,
    {
        let times = |value: L, factor: f64| value * F::of(factor);
        let [k1, k2, k3, k4] = self.radial;
        let n = w * (k1 + w * (k2 + w * (k3 + w * k4))) + F::ONE;
        let n_slope = k1 + w * (times(k2, 2.0) + w * (times(k3, 3.0) + w * times(k4, 4.0)));
        let n_bend = times(k2, 2.0) + w * (times(k3, 6.0) + w * times(k4, 12.0));
        if self.model != CameraModel::FullOpenCv {
            return [n, n_slope, n_bend];
        }
        let [k4, k5, k6] = self.denominator;
        let d = w * (k4 + w * (k5 + w * k6)) + F::ONE;
        let d_slope = k4 + w * (times(k5, 2.0) + w * times(k6, 3.0));
        let d_bend = times(k5, 2.0) + w * times(k6, 6.0);
        let g = n / d;
        let slope = (n_slope - g * d_slope) / d;
        [g, slope, (n_bend - times(slope * d_slope, 2.0) - g * d_bend) / d]
    }

    #[inline(always)]
    fn at<S: Simd, F: Real<Lanes<S> = L>>(&self, s: [L; 2]) -> PlanarMapSimd<L>
    where
        L: SimdFloat<S, Element = F>,
    {
        let (p, both) = (self.tangential, each!([0, 1], |i| self.tangential[i] + self.prism[i]));
        let w = s[0] * s[0] + s[1] * s[1];
        let [g, slope, bend] = self.radial::<S, F>(w);
        let along = p[0] * s[0] + p[1] * s[1];
        let factor = g + along + along;
        let twice_slope = slope + slope;
        let mut by = [[factor; 2]; 2];
        for i in 0..2 {
            for j in 0..2 {
                let half = s[i] * (slope * s[j] + p[j]) + both[i] * s[j];
                by[i][j] = if i == j { factor + half + half } else { half + half };
            }
        }
        PlanarMapSimd {
            s,
            value: [s[0] * factor + both[0] * w, s[1] * factor + both[1] * w],
            by,
            twice_slope,
            four_bend: (bend + bend) + (bend + bend),
        }
    }

    /// The second derivative, contracted with a matrix.
    #[inline(always)]
    fn second<S: Simd, F: Real<Lanes<S> = L>>(&self, at: &PlanarMapSimd<L>, m: &[[L; 2]; 2]) -> [L; 2]
    where
        L: SimdFloat<S, Element = F>,
    {
        let (s, p, both) = (at.s, self.tangential, each!([0, 1], |i| self.tangential[i] + self.prism[i]));
        let trace = m[0][0] + m[1][1];
        let turned = [[m[0][0], m[1][0]], [m[0][1], m[1][1]]];
        let of_s = matvec2(m, s);
        let (of_s_turned, of_p, of_both) = (matvec2(&turned, s), matvec2(m, p), matvec2(&turned, both));
        let quadratic = s[0] * of_s[0] + s[1] * of_s[1];
        each!([0, 1], |i| {
            let radial = at.twice_slope * (trace * s[i] + of_s[i] + of_s_turned[i]);
            let decentred = trace * p[i] + of_p[i] + of_both[i];
            radial + at.four_bend * quadratic * s[i] + decentred + decentred
        })
    }
}

/// `m v`
#[inline(always)]
fn matvec2<L: Entry>(m: &[[L; 2]; 2], v: [L; 2]) -> [L; 2] {
    [m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]]
}

/// Intermediate values of the first step of a perspective lens.
struct PerspectiveSimd<S: Simd, F: Real> {
    z: Lanes<S, F>,
    ratio: [Lanes<S, F>; 2],
    slope_free: [MaskOf<S, F>; 2],
}

/// Intermediate values of the first step of a fisheye, under the names of the contract.
struct FisheyeSimd<S: Simd, F: Real> {
    length: Lanes<S, F>,
    p: [Lanes<S, F>; 2],
    c: Lanes<S, F>,
    alpha: Lanes<S, F>,
    beta: Lanes<S, F>,
    delta: Lanes<S, F>,
    /// `β p·row − last`
    lean: Vector<S, F>,
    /// `p·row`
    across: Vector<S, F>,
}

enum FirstStep<S: Simd, F: Real> {
    Orthographic,
    Perspective(PerspectiveSimd<S, F>),
    Fisheye(FisheyeSimd<S, F>),
}

/// Projection of eight centres through a lens, with the intermediate values that the gradient needs.
pub(crate) struct LensProjectionSimd<S: Simd, F: Real> {
    first: FirstStep<S, F>,
    /// Whether each centre lies within the lens's domain.
    pub within: MaskOf<S, F>,
    /// The planar map at the centre, and at the position at which the Jacobian is evaluated.
    centre: PlanarMapSimd<Lanes<S, F>>,
    held: PlanarMapSimd<Lanes<S, F>>,
    /// `b₀, b₁`
    base: [Vector<S, F>; 2],
    rows: Matrix3<Lanes<S, F>>,
}

/// Gradients of the centre in the camera's frame and of `W R`.
pub(crate) struct LensProjectionGrad<L> {
    pub mean_cam: [L; 3],
    pub rows: Matrix3<L>,
}

impl<S: Simd, F: Real> LensProjectionSimd<S, F> {
    /// Projects through the lens, from the centre, the rows of `W R`, and the limits to which a perspective lens's slopes are clamped.
    #[inline(always)]
    pub fn new(
        distortion: &DistortionSimd<Lanes<S, F>>,
        mean_cam: Vector<S, F>,
        rows: &Matrix3<Lanes<S, F>>,
        [low, high]: [[Lanes<S, F>; 2]; 2],
    ) -> Self {
        let (first, s, slope, base) = if distortion.model == CameraModel::Orthographic {
            let s = [mean_cam[0], mean_cam[1]];
            (FirstStep::Orthographic, s, s, [rows[0], rows[1]])
        } else if distortion.model.is_fisheye() {
            let step = FisheyeSimd::new(mean_cam, rows);
            let (s, base) = ([step.alpha * step.p[0], step.alpha * step.p[1]], step.rows(rows));
            (FirstStep::Fisheye(step), s, s, base)
        } else {
            let [x, y, z] = mean_cam;
            let ratio = [x / z, y / z];
            let slope = each!([0, 1], |k| ratio[k].max(low[k]).min(high[k]));
            let slope_free = [slope[0].simd_eq(ratio[0]), slope[1].simd_eq(ratio[1])];
            let inverse_z = F::Lanes::<S>::splat(z.token(), F::ONE) / z;
            let base = each!([0, 1], |k| scale(sub(rows[k], scale(rows[2], slope[k])), inverse_z));
            (FirstStep::Perspective(PerspectiveSimd { z, ratio, slope_free }), ratio, slope, base)
        };
        Self {
            first,
            within: (s[0] * s[0] + s[1] * s[1]).simd_lt(distortion.max_radius_squared),
            centre: distortion.at::<S, F>(s),
            held: distortion.at::<S, F>(slope),
            base,
            rows: *rows,
        }
    }

    /// Distorted position of the centre, in units of the focal length.
    #[inline(always)]
    pub fn seen_at(&self) -> [Lanes<S, F>; 2] {
        self.centre.value
    }

    /// The rows of `J W R`.
    #[inline(always)]
    pub fn rows(&self, focal: [Lanes<S, F>; 2]) -> [Vector<S, F>; 2] {
        let by = &self.held.by;
        each!([0, 1], |i| scale(add(scale(self.base[0], by[i][0]), scale(self.base[1], by[i][1])), focal[i]))
    }

    /// Gradients of the centre and of `W R` from those of the rows of `J W R` and of the distorted position.
    #[inline(always)]
    pub fn backward(
        &self,
        distortion: &DistortionSimd<Lanes<S, F>>,
        focal: [Lanes<S, F>; 2],
        grad_j: [Vector<S, F>; 2],
        grad_seen_at: [Lanes<S, F>; 2],
    ) -> LensProjectionGrad<Lanes<S, F>> {
        let grad = [scale(grad_j[0], focal[0]), scale(grad_j[1], focal[1])];
        let by = &self.held.by;
        let grad_base = each!([0, 1], |k| add(scale(grad[0], by[0][k]), scale(grad[1], by[1][k])));
        let grad_by = each!([0, 1], |i| [dot(grad[i], self.base[0]), dot(grad[i], self.base[1])]);
        let grad_slope = distortion.second::<S, F>(&self.held, &grad_by);
        let by = &self.centre.by;
        let grad_s = each!([0, 1], |k| grad_seen_at[0] * by[0][k] + grad_seen_at[1] * by[1][k]);
        match &self.first {
            FirstStep::Orthographic => {
                let zero = F::Lanes::<S>::splat(grad_s[0].token(), F::ZERO);
                let [x, y] = grad_base;
                LensProjectionGrad { mean_cam: [grad_s[0], grad_s[1], zero], rows: [x, y, [zero; 3]] }
            }
            FirstStep::Perspective(step) => step.backward(self, grad_base, grad_slope, grad_s),
            FirstStep::Fisheye(step) => {
                step.backward(&self.rows, grad_base, [grad_s[0] + grad_slope[0], grad_s[1] + grad_slope[1]])
            }
        }
    }
}

impl<S: Simd, F: Real> PerspectiveSimd<S, F> {
    #[inline(always)]
    fn backward(
        &self,
        bent: &LensProjectionSimd<S, F>,
        grad_base: [Vector<S, F>; 2],
        grad_slope: [Lanes<S, F>; 2],
        grad_s: [Lanes<S, F>; 2],
    ) -> LensProjectionGrad<Lanes<S, F>> {
        let lanes = |value: F| F::Lanes::<S>::splat(self.z.token(), value);
        let (zero, inverse_z) = (lanes(F::ZERO), lanes(F::ONE) / self.z);
        let mut out = LensProjectionGrad { mean_cam: [zero; 3], rows: [[zero; 3]; 3] };
        for k in 0..2 {
            let grad_row = scale(grad_base[k], inverse_z);
            out.rows[k] = grad_row;
            out.rows[2] = sub(out.rows[2], scale(grad_row, bent.held.s[k]));
            let through_slope = grad_slope[k] - dot(grad_row, bent.rows[2]);
            let grad_ratio = grad_s[k] + self.slope_free[k].select(through_slope, zero);
            out.mean_cam[k] = grad_ratio * inverse_z;
            out.mean_cam[2] -= (dot(grad_base[k], bent.base[k]) + grad_ratio * self.ratio[k]) * inverse_z;
        }
        out
    }
}

impl<S: Simd, F: Real> FisheyeSimd<S, F> {
    #[inline(always)]
    fn new([x, y, z]: Vector<S, F>, rows: &Matrix3<Lanes<S, F>>) -> Self {
        let lanes = |value: f64| F::Lanes::<S>::splat(z.token(), F::of(value));
        let length = norm::<S, F>(z.token(), [x, y, z]);
        let (p, c) = ([x / length, y / length], z / length);
        let v = (p[0] * p[0] + p[1] * p[1]) / ((c + F::ONE) * (c + F::ONE));
        let h = half_angle::<S, F>(v);
        let a = v * h - F::of(1.0 / 3.0);
        let more = v + F::ONE;
        let squared = more * more;
        let alpha = more * (v * a + F::ONE);
        let beta = -(more * (v + F::of(3.0) + squared * a)) * F::of(0.25);
        let series = lanes(25.0) + v * (lanes(9.0) - v * more);
        let delta = more * (series + squared * squared * h * F::of(3.0)) * F::of(1.0 / 16.0);
        let across = add(scale(rows[0], p[0]), scale(rows[1], p[1]));
        let lean = sub(scale(across, beta), rows[2]);
        Self { length, p, c, alpha, beta, delta, lean, across }
    }

    /// `b₀, b₁`
    #[inline(always)]
    fn rows(&self, rows: &Matrix3<Lanes<S, F>>) -> [Vector<S, F>; 2] {
        let inverse = F::Lanes::<S>::splat(self.c.token(), F::ONE) / self.length;
        let [x, y] = self.p;
        let aside = scale(sub(scale(rows[1], x), scale(rows[0], y)), self.beta);
        let turned = [scale(aside, y), scale(aside, -x)];
        each!([0, 1], |k| {
            let row = sub(add(scale(rows[k], self.c), turned[k]), scale(rows[2], self.p[k]));
            scale(row, inverse)
        })
    }

    #[inline(always)]
    fn backward(
        &self,
        rows: &Matrix3<Lanes<S, F>>,
        grad_base: [Vector<S, F>; 2],
        grad_s: [Lanes<S, F>; 2],
    ) -> LensProjectionGrad<Lanes<S, F>> {
        let (p, beta) = (self.p, self.beta);
        let inverse = F::Lanes::<S>::splat(self.c.token(), F::ONE) / self.length;
        let grad = [scale(grad_base[0], inverse), scale(grad_base[1], inverse)];
        let sum = add(scale(grad[0], p[0]), scale(grad[1], p[1]));
        let u = dot(grad[0], rows[0]) + dot(grad[1], rows[1]);
        let (m, last) = (dot(sum, self.across), dot(sum, rows[2]));
        let along = p[0] * grad_s[0] + p[1] * grad_s[1];
        let common = beta * (u + along) + self.delta * m + (last + last);
        let grad_p = each!([0, 1], |k| dot(grad[k], self.lean)
            + beta * dot(sum, rows[k])
            + self.alpha * grad_s[k]
            + p[k] * common);
        let half_c = m + self.c * last;
        let grad_c = (half_c + half_c) - u - along;
        let of_rows = each!([0, 1], |k| add(scale(grad[k], self.alpha), scale(sum, beta * p[k])));
        LensProjectionGrad {
            mean_cam: [grad_p[0] * inverse, grad_p[1] * inverse, grad_c * inverse],
            rows: [of_rows[0], of_rows[1], [-sum[0], -sum[1], -sum[2]]],
        }
    }
}

/// `h` of the contract, for `0 <= v <= 1`.
#[inline(always)]
fn half_angle<S: Simd, F: Real>(v: Lanes<S, F>) -> Lanes<S, F> {
    let coefficients: &[f64] = if F::DTYPE == DType::F32 { &HALF_ANGLE_F32 } else { &HALF_ANGLE_F64 };
    let mut sum = F::Lanes::<S>::splat(v.token(), F::ZERO);
    for coefficient in coefficients {
        sum = sum.mul_add(v, F::Lanes::<S>::splat(v.token(), F::of(*coefficient)));
    }
    sum
}
