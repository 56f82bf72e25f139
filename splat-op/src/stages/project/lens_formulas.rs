//! The formulas of lenses, both passes, for the kernels and the CPU twin: the contract in `lens.rs`. Values of culled Gaussians are
//! meaningless; both mask them.

use super::lens::{HALF_ANGLE_F32, HALF_ANGLE_F64};
use crate::camera::{CameraModel, Intrinsics};
use crate::linalg::{Matrix3, Number, add, dot, dot2, scale, sub};
use crate::simd::{Real, each};

/// A lens's planar map.
#[derive(Clone, Copy)]
pub(crate) struct Distortion<N> {
    pub model: CameraModel,
    /// Coefficients of the numerator and of the denominator of `g`; the last ones of some models are zero and are not read.
    pub radial: [N; 4],
    pub denominator: [N; 3],
    /// `P` and `P + S` of the contract.
    pub tangential: [N; 2],
    pub outward: [N; 2],
    /// Square of the radius of the lens's domain; Gaussians at or beyond that radius are culled.
    pub max_radius_squared: N,
}

impl<F: Real> Distortion<F> {
    /// `None` for a pinhole.
    pub fn new(camera: &Intrinsics) -> Option<Self> {
        let found = camera.coefficients();
        let [tangential, prism] = [found.tangential, found.prism].map(|pair| pair.map(F::of));
        (camera.model != CameraModel::Pinhole).then(|| Self {
            model: camera.model,
            radial: found.radial.map(F::of),
            denominator: found.denominator.map(F::of),
            tangential,
            outward: [tangential[0] + prism[0], tangential[1] + prism[1]],
            // Compilers of shaders may assume that infinity does not occur.
            max_radius_squared: F::of(camera.max_radius().powi(2)).min_of(F::MAX),
        })
    }
}

impl<N: Copy> Distortion<N> {
    #[inline(always)]
    pub fn map<T: Copy>(&self, to: impl Fn(N) -> T) -> Distortion<T> {
        Distortion {
            model: self.model,
            radial: each!(self.radial, |value| to(value)),
            denominator: each!(self.denominator, |value| to(value)),
            tangential: each!(self.tangential, |value| to(value)),
            outward: each!(self.outward, |value| to(value)),
            max_radius_squared: to(self.max_radius_squared),
        }
    }
}

/// The planar map and its derivatives at one position.
#[derive(Clone, Copy)]
struct PlanarMap<N> {
    s: [N; 2],
    value: [N; 2],
    /// `A` of the contract, row by row.
    by: [[N; 2]; 2],
    /// `g'` and `g''`.
    slope: N,
    bend: N,
}

impl<N: Number> Distortion<N> {
    /// `g`, `g'` and `g''` at `w`.
    #[inline(always)]
    fn radial(&self, w: N) -> [N; 3] {
        let [k1, k2, k3, k4] = self.radial;
        let [mut n, mut n_slope, mut n_bend] = [k2, k2 * 2.0, k2 * 2.0];
        if !matches!(self.model, CameraModel::OpenCv | CameraModel::Orthographic) {
            let [mut rest, mut slope, mut bend] = [k3, k3 * 3.0, k3 * 6.0];
            if self.model != CameraModel::FullOpenCv {
                (rest, slope, bend) = (rest + w * k4, slope + w * (k4 * 4.0), bend + w * (k4 * 12.0));
            }
            (n, n_slope, n_bend) = (n + w * rest, n_slope + w * slope, n_bend + w * bend);
        }
        (n, n_slope) = (w * (k1 + w * n) + 1.0, k1 + w * n_slope);
        if self.model != CameraModel::FullOpenCv {
            return [n, n_slope, n_bend];
        }
        let [k4, k5, k6] = self.denominator;
        let d = w * (k4 + w * (k5 + w * k6)) + 1.0;
        let d_slope = k4 + w * (k5 * 2.0 + w * (k6 * 3.0));
        let d_bend = k5 * 2.0 + w * (k6 * 6.0);
        let g = n / d;
        let slope = (n_slope - g * d_slope) / d;
        [g, slope, (n_bend - slope * d_slope * 2.0 - g * d_bend) / d]
    }

    #[inline(always)]
    fn at(&self, s: [N; 2]) -> PlanarMap<N> {
        let (p, outward) = (self.tangential, self.outward);
        let w = dot2(s, s);
        let [g, slope, bend] = self.radial(w);
        let along = dot2(p, s);
        let diagonal = g + along + along;
        let inward = each!([0, 1], |j| slope * s[j] + p[j]);
        let mut by = [[diagonal; 2]; 2];
        for i in 0..2 {
            for j in 0..2 {
                let half = s[i] * inward[j] + outward[i] * s[j];
                by[i][j] = if i == j { diagonal + half + half } else { half + half };
            }
        }
        PlanarMap { s, value: each!([0, 1], |i| s[i] * diagonal + outward[i] * w), by, slope, bend }
    }

    /// The second derivative, contracted with a matrix.
    #[inline(always)]
    fn second(&self, at: &PlanarMap<N>, m: &[[N; 2]; 2]) -> [N; 2] {
        let (s, p) = (at.s, self.tangential);
        let trace = m[0][0] + m[1][1];
        let turned = [[m[0][0], m[1][0]], [m[0][1], m[1][1]]];
        let (of_s, of_s_turned) = (matvec2(m, s), matvec2(&turned, s));
        let (of_p, of_outward) = (matvec2(m, p), matvec2(&turned, self.outward));
        let (twice_slope, bent) = (at.slope * 2.0, at.bend * 4.0 * dot2(s, of_s));
        each!([0, 1], |i| {
            let radial = twice_slope * (trace * s[i] + of_s[i] + of_s_turned[i]);
            let decentred = trace * p[i] + of_p[i] + of_outward[i];
            radial + bent * s[i] + decentred + decentred
        })
    }
}

/// `m v`
#[inline(always)]
fn matvec2<N: Number>(m: &[[N; 2]; 2], v: [N; 2]) -> [N; 2] {
    [dot2(m[0], v), dot2(m[1], v)]
}

/// Intermediate values of the first step of a perspective lens.
struct Perspective<N: Number> {
    ratio: [N; 2],
    slope: [N; 2],
    slope_free: [N::Mask; 2],
    inverse_z: N,
}

/// Intermediate values of the first step of a fisheye, under the names of the contract.
struct Fisheye<N> {
    p: [N; 2],
    c: N,
    alpha: N,
    beta: N,
    delta: N,
    /// `β p·row − last`
    lean: [N; 3],
    /// `p·row`
    across: [N; 3],
    inverse_length: N,
}

enum FirstStep<N: Number> {
    Orthographic,
    Perspective(Perspective<N>),
    Fisheye(Fisheye<N>),
}

/// Projection of a centre through a lens, with the intermediate values that the gradient needs.
pub(crate) struct LensProjection<N: Number> {
    distortion: Distortion<N>,
    focal: [N; 2],
    first: FirstStep<N>,
    /// Whether the centre lies within the lens's domain.
    pub within: N::Mask,
    /// The planar map at the centre, and at the position at which the Jacobian is evaluated.
    centre: PlanarMap<N>,
    held: PlanarMap<N>,
    /// `b₀, b₁`
    base: [[N; 3]; 2],
    rows: Matrix3<N>,
}

/// Gradients of the centre in the camera's frame and of `W R`.
pub(crate) struct LensProjectionGrad<N> {
    pub mean_cam: [N; 3],
    pub rows: Matrix3<N>,
}

impl<N: Number> LensProjection<N> {
    /// Projects through the lens, from the centre, the rows of `W R`, and the limits to which a perspective lens's slopes are clamped.
    #[inline(always)]
    pub fn new(
        distortion: Distortion<N>,
        focal: [N; 2],
        mean_cam: [N; 3],
        rows: Matrix3<N>,
        limits: [[N; 2]; 2],
    ) -> Self {
        let (first, s, base) = if distortion.model == CameraModel::Orthographic {
            (FirstStep::Orthographic, [mean_cam[0], mean_cam[1]], [rows[0], rows[1]])
        } else if distortion.model.is_fisheye() {
            let step = Fisheye::new(mean_cam, &rows);
            let (s, base) = ([step.alpha * step.p[0], step.alpha * step.p[1]], step.base(&rows));
            (FirstStep::Fisheye(step), s, base)
        } else {
            let step = Perspective::new(mean_cam, limits);
            let (ratio, base) = (step.ratio, step.base(&rows));
            (FirstStep::Perspective(step), ratio, base)
        };
        let centre = distortion.at(s);
        let held = match &first {
            FirstStep::Perspective(step) => distortion.at(step.slope),
            _ => centre,
        };
        let within = dot2(s, s).lt(distortion.max_radius_squared);
        Self { distortion, focal, first, within, centre, held, base, rows }
    }

    /// Distorted position of the centre, in units of the focal length.
    #[inline(always)]
    pub fn seen_at(&self) -> [N; 2] {
        self.centre.value
    }

    /// The rows of `J W R`.
    #[inline(always)]
    pub fn rows(&self) -> [[N; 3]; 2] {
        let (base, by) = (&self.base, &self.held.by);
        each!([0, 1], |i| scale(add(scale(base[0], by[i][0]), scale(base[1], by[i][1])), self.focal[i]))
    }

    /// Gradients of the centre and of `W R` from those of the rows of `J W R` and of the projected centre, per px.
    #[inline(always)]
    pub fn backward(&self, grad_j: [[N; 3]; 2], grad_px: [N; 2]) -> LensProjectionGrad<N> {
        let grad = each!([0, 1], |i| scale(grad_j[i], self.focal[i]));
        let grad_seen_at = each!([0, 1], |i| grad_px[i] * self.focal[i]);
        let by = &self.held.by;
        let grad_base = each!([0, 1], |k| add(scale(grad[0], by[0][k]), scale(grad[1], by[1][k])));
        let grad_by = each!([0, 1], |i| [dot(grad[i], self.base[0]), dot(grad[i], self.base[1])]);
        let grad_slope = self.distortion.second(&self.held, &grad_by);
        let by = &self.centre.by;
        let grad_s = each!([0, 1], |k| grad_seen_at[0] * by[0][k] + grad_seen_at[1] * by[1][k]);
        match &self.first {
            FirstStep::Orthographic => {
                let zero = grad_s[0].constant(0.0);
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

impl<N: Number> Perspective<N> {
    #[inline(always)]
    fn new([x, y, z]: [N; 3], [low, high]: [[N; 2]; 2]) -> Self {
        let ratio = [x / z, y / z];
        let slope = each!([0, 1], |k| ratio[k].max(low[k]).min(high[k]));
        let slope_free = [slope[0].eq(ratio[0]), slope[1].eq(ratio[1])];
        Self { ratio, slope, slope_free, inverse_z: z.constant(1.0) / z }
    }

    /// `b₀, b₁`
    #[inline(always)]
    fn base(&self, rows: &Matrix3<N>) -> [[N; 3]; 2] {
        each!([0, 1], |k| scale(sub(rows[k], scale(rows[2], self.slope[k])), self.inverse_z))
    }

    #[inline(always)]
    fn backward(
        &self,
        bent: &LensProjection<N>,
        grad_base: [[N; 3]; 2],
        grad_slope: [N; 2],
        grad_s: [N; 2],
    ) -> LensProjectionGrad<N> {
        let (zero, inverse_z) = (self.inverse_z.constant(0.0), self.inverse_z);
        let mut out = LensProjectionGrad { mean_cam: [zero; 3], rows: [[zero; 3]; 3] };
        for k in 0..2 {
            let grad_row = scale(grad_base[k], inverse_z);
            out.rows[k] = grad_row;
            out.rows[2] = add(out.rows[2], scale(grad_row, -self.slope[k]));
            let through_slope = grad_slope[k] - dot(grad_row, bent.rows[2]);
            let grad_ratio = grad_s[k] + N::select(self.slope_free[k], through_slope, zero);
            out.mean_cam[k] = grad_ratio * inverse_z;
            let shrinking = (dot(grad_base[k], bent.base[k]) + grad_ratio * self.ratio[k]) * inverse_z;
            out.mean_cam[2] = out.mean_cam[2] - shrinking;
        }
        out
    }
}

impl<N: Number> Fisheye<N> {
    #[inline(always)]
    fn new([x, y, z]: [N; 3], rows: &Matrix3<N>) -> Self {
        let length = N::length([x, y, z]);
        let (p, c) = ([x / length, y / length], z / length);
        let v = dot2(p, p) / ((c + 1.0) * (c + 1.0));
        let h = half_angle(v);
        let a = v * h - 1.0 / 3.0;
        let more = v + 1.0;
        let squared = more * more;
        let alpha = more * (v * a + 1.0);
        let beta = more * (v + 3.0 + squared * a) * -0.25;
        let series = v.constant(25.0) + v * (v.constant(9.0) - v * more);
        let delta = more * (series + squared * squared * h * 3.0) * (1.0 / 16.0);
        let across = add(scale(rows[0], p[0]), scale(rows[1], p[1]));
        let lean = sub(scale(across, beta), rows[2]);
        Self { p, c, alpha, beta, delta, lean, across, inverse_length: length.constant(1.0) / length }
    }

    /// `b₀, b₁`
    #[inline(always)]
    fn base(&self, rows: &Matrix3<N>) -> [[N; 3]; 2] {
        let [x, y] = self.p;
        let aside = scale(sub(scale(rows[1], x), scale(rows[0], y)), self.beta);
        let turned = [scale(aside, y), scale(aside, -x)];
        each!([0, 1], |k| {
            let row = sub(add(scale(rows[k], self.c), turned[k]), scale(rows[2], self.p[k]));
            scale(row, self.inverse_length)
        })
    }

    #[inline(always)]
    fn backward(&self, rows: &Matrix3<N>, grad_base: [[N; 3]; 2], grad_s: [N; 2]) -> LensProjectionGrad<N> {
        let (p, beta, inverse) = (self.p, self.beta, self.inverse_length);
        let grad = [scale(grad_base[0], inverse), scale(grad_base[1], inverse)];
        let sum = add(scale(grad[0], p[0]), scale(grad[1], p[1]));
        let u = dot(grad[0], rows[0]) + dot(grad[1], rows[1]);
        let (m, last) = (dot(sum, self.across), dot(sum, rows[2]));
        let along = dot2(p, grad_s);
        let common = beta * (u + along) + self.delta * m + last * 2.0;
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
fn half_angle<N: Number>(v: N) -> N {
    let coefficients: &[f64] = if N::DOUBLE { &HALF_ANGLE_F64 } else { &HALF_ANGLE_F32 };
    let mut sum = v.constant(coefficients[0]);
    for coefficient in &coefficients[1..] {
        sum = sum.mul_add(v, v.constant(*coefficient));
    }
    sum
}
