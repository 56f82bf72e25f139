//! The projection of eight Gaussians at a time and its gradient, one per SIMD lane. Values in the lanes of culled Gaussians are
//! meaningless and are masked before they are stored.

use fearless_simd::prelude::*;

use super::lens_simd::{DistortionSimd, LensProjectionGrad, LensProjectionSimd};
use super::{COMPENSATION_MIN, Ellipse, ProjectSpec, RADIUS_SIGMAS};
use crate::linalg::{Matrix3, add, cross, dot, hadamard, matmul, matvec, rotation_of, scale, sub, transposed_matvec};
use crate::simd::each;
use crate::simd::real::Real;

/// The camera, as numbers or broadcast to all lanes.
pub(crate) struct ProjectCameraSimd<L> {
    pub rotation: Matrix3<L>,
    pub translation: [L; 3],
    pub focal: [L; 2],
    principal: [L; 2],
    /// Limits to which `x/z` and `y/z` are clamped for the Jacobian.
    pub low: [L; 2],
    pub high: [L; 2],
    pub near: L,
    far: L,
    /// Standard deviation up to which splats are culled, px; `None` for none.
    clip_sigma: Option<L>,
    /// `√blur`
    pub blur_sigma: L,
    antialias: bool,
    /// `None` for a pinhole.
    pub distortion: Option<DistortionSimd<L>>,
}

impl<F: Real> ProjectCameraSimd<F> {
    pub fn new(cam_from_world: &[F], spec: &ProjectSpec) -> Self {
        let (camera, options) = (&spec.intrinsics, &spec.options);
        let limits = camera.slope_limits(options.jacobian_margin);
        let p = cam_from_world;
        Self {
            rotation: [[p[0], p[1], p[2]], [p[4], p[5], p[6]], [p[8], p[9], p[10]]],
            translation: [p[3], p[7], p[11]],
            focal: [F::of(camera.fx), F::of(camera.fy)],
            principal: [F::of(camera.cx), F::of(camera.cy)],
            low: limits.map(|[low, _]| F::of(low)),
            high: limits.map(|[_, high]| F::of(high)),
            near: F::of(options.near),
            far: F::of(options.far).min_of(F::MAX),
            clip_sigma: (options.radius_clip > 0.0).then(|| F::of(options.radius_clip / RADIUS_SIGMAS)),
            blur_sigma: F::of(options.blur).sqrt(),
            antialias: options.antialias,
            distortion: DistortionSimd::new(camera),
        }
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, simd: S) -> ProjectCameraSimd<F::Lanes<S>> {
        let lanes = |value: F| F::Lanes::<S>::splat(simd, value);
        ProjectCameraSimd {
            rotation: each!(self.rotation, |row| each!(row, |value| lanes(value))),
            translation: each!(self.translation, |value| lanes(value)),
            focal: each!(self.focal, |value| lanes(value)),
            principal: each!(self.principal, |value| lanes(value)),
            low: each!(self.low, |value| lanes(value)),
            high: each!(self.high, |value| lanes(value)),
            near: lanes(self.near),
            far: lanes(self.far),
            #[allow(clippy::manual_map, reason = "a closure may be left out of line, without vector instructions")]
            clip_sigma: match self.clip_sigma {
                Some(sigma) => Some(lanes(sigma)),
                None => None,
            },
            blur_sigma: lanes(self.blur_sigma),
            antialias: self.antialias,
            #[allow(clippy::manual_map, reason = "a closure may be left out of line, without vector instructions")]
            distortion: match &self.distortion {
                Some(distortion) => Some(distortion.lanes(simd)),
                None => None,
            },
        }
    }
}

/// Parameters, or their gradients.
pub(crate) struct GaussiansSimd<L> {
    pub mean: [L; 3],
    pub rotation: [L; 4],
    pub scale: [L; 3],
    pub opacity: L,
}

impl<L: Copy> GaussiansSimd<L> {
    #[inline(always)]
    fn all<S: Simd, F: Real<Lanes<S> = L>>(&self, mut holds: impl FnMut(L) -> MaskOf<S, F>) -> MaskOf<S, F>
    where
        L: SimdFloat<S, Element = F>,
    {
        let mut all = holds(self.opacity);
        for value in self.mean.into_iter().chain(self.rotation).chain(self.scale) {
            all &= holds(value);
        }
        all
    }
}

pub(crate) type MaskOf<S, F> = <<F as Real>::Lanes<S> as SimdBase<S>>::Mask;
pub(crate) type Vector<S, F> = [<F as Real>::Lanes<S>; 3];

/// Intermediate values of the forward pass that the backward pass needs.
pub(crate) struct ProjectionTermsSimd<S: Simd, F: Real> {
    simd: S,
    /// Whether each Gaussian is visible: finite, with a rotation, and in front of the near plane.
    pub seen: MaskOf<S, F>,
    pub mean_cam: Vector<S, F>,
    /// `x/z, y/z`, or their distorted values with a lens; the slopes at which the Jacobian is evaluated; whether each slope is free
    /// (not clamped).
    ratio: [F::Lanes<S>; 2],
    pub slope: [F::Lanes<S>; 2],
    slope_free: [MaskOf<S, F>; 2],
    quaternion: [F::Lanes<S>; 4],
    quaternion_length: F::Lanes<S>,
    world_from_gaussian: Matrix3<F::Lanes<S>>,
    pub cam_from_gaussian: Matrix3<F::Lanes<S>>,
    /// `j0, j1`: rows of `J W R`; `m0, m1`: those rows times the scales.
    pub j: [Vector<S, F>; 2],
    pub m: [Vector<S, F>; 2],
    /// `n = m0 / sigma_u`, `along = m1 / sigma_u`, `p = n × m1`.
    pub n: Vector<S, F>,
    pub along: Vector<S, F>,
    pub p: Vector<S, F>,
    pub sigma_u: F::Lanes<S>,
    pub shear: F::Lanes<S>,
    pub sigma_v: F::Lanes<S>,
    /// Factor of the opacity, and whether it is free (not at its lower limit). Without anti-aliasing the factor is one.
    compensation: F::Lanes<S>,
    compensation_free: MaskOf<S, F>,
    /// Terms of a lens; `None` in the code that is compiled for pinholes.
    bent: Option<LensProjectionSimd<S, F>>,
}

impl<S: Simd, F: Real> ProjectionTermsSimd<S, F> {
    /// Projects eight Gaussians. `BENDS` says whether the camera has a lens; it keeps lenses out of the code for pinholes.
    #[inline(always)]
    pub fn new<const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> Self {
        let lanes = |value: F| F::Lanes::<S>::splat(simd, value);
        let (zero, one, largest) = (lanes(F::ZERO), lanes(F::ONE), lanes(F::MAX));
        let finite = |value: F::Lanes<S>| value.abs().simd_le(largest);

        let mean_cam = add(matvec(&camera.rotation, g.mean), camera.translation);
        let [x, y, z] = mean_cam;
        let mut ratio = [x / z, y / z];
        let (quaternion, quaternion_length) = unit_quaternion::<S, F>(simd, g.rotation);
        let mut seen = g.all(finite) & z.simd_gt(camera.near) & z.simd_gt(zero) & z.simd_lt(camera.far) & finite(z);
        let world_from_gaussian = rotation_of(one, quaternion);
        let cam_from_gaussian = matmul(&camera.rotation, &world_from_gaussian);

        let slope = [ratio[0].max(camera.low[0]).min(camera.high[0]), ratio[1].max(camera.low[1]).min(camera.high[1])];
        let slope_free = [slope[0].simd_eq(ratio[0]), slope[1].simd_eq(ratio[1])];
        let mut j = each!([0, 1], |axis| {
            let leaning = sub(cam_from_gaussian[axis], scale(cam_from_gaussian[2], slope[axis]));
            scale(leaning, camera.focal[axis] / z)
        });
        let mut bent = None;
        if BENDS && let Some(distortion) = &camera.distortion {
            let found =
                LensProjectionSimd::<S, F>::new(distortion, mean_cam, &cam_from_gaussian, [camera.low, camera.high]);
            (ratio, j) = (found.seen_at(), found.rows(camera.focal));
            seen &= found.within;
            bent = Some(found);
        }
        seen = seen & finite(ratio[0]) & finite(ratio[1]) & quaternion_length.simd_gt(zero);
        let m = [hadamard(j[0], g.scale), hadamard(j[1], g.scale)];

        let sigma_u = norm::<S, F>(simd, [norm::<S, F>(simd, m[0]), camera.blur_sigma, zero]);
        let n = scale(m[0], one / sigma_u);
        let along = scale(m[1], one / sigma_u);
        let p = cross(n, m[1]);
        let p_norm = norm::<S, F>(simd, p);
        let sigma_v = norm::<S, F>(simd, [camera.blur_sigma, p_norm, camera.blur_sigma * norm::<S, F>(simd, along)]);
        let shear = dot(n, along);
        seen = seen & sigma_u.simd_gt(zero) & finite(sigma_u) & sigma_v.simd_gt(zero) & finite(sigma_v) & finite(shear);
        if let Some(clip) = camera.clip_sigma {
            let vertical = norm::<S, F>(simd, [shear * sigma_u, sigma_v, zero]);
            seen &= sigma_u.simd_gt(clip) | vertical.simd_gt(clip);
        }
        let (compensation, compensation_free) = if camera.antialias {
            let (areas, floor) = (p_norm / sigma_v, lanes(F::of(COMPENSATION_MIN)));
            let free = areas.simd_gt(floor);
            (free.select(areas, floor), free)
        } else {
            (one, zero.simd_gt(zero))
        };
        Self {
            simd,
            seen,
            mean_cam,
            ratio,
            slope,
            slope_free,
            quaternion,
            quaternion_length,
            world_from_gaussian,
            cam_from_gaussian,
            j,
            m,
            n,
            along,
            p,
            sigma_u,
            shear,
            sigma_v,
            compensation,
            compensation_free,
            bent,
        }
    }

    #[inline(always)]
    fn lanes(&self, value: F) -> F::Lanes<S> {
        F::Lanes::<S>::splat(self.simd, value)
    }

    #[inline(always)]
    pub fn ellipse(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        g: &GaussiansSimd<F::Lanes<S>>,
    ) -> Ellipse<F::Lanes<S>> {
        let (zero, one) = (self.lanes(F::ZERO), self.lanes(F::ONE));
        let (focal, principal) = (camera.focal, camera.principal);
        let mean_px = each!([0, 1], |axis| self.seen.select(focal[axis] * self.ratio[axis] + principal[axis], zero));
        Ellipse {
            mean_px,
            sigma_u: self.seen.select(self.sigma_u, one),
            shear: self.seen.select(self.shear, zero),
            sigma_v: self.seen.select(self.sigma_v, one),
            depth: self.seen.select(self.mean_cam[2], zero),
            opacity: self.seen.select(g.opacity * self.compensation, zero),
        }
    }

    /// Returns the distance of the centre from the point of the picture at which the Jacobian is evaluated, px, for a pinhole.
    #[inline(always)]
    pub fn away(&self, camera: &ProjectCameraSimd<F::Lanes<S>>) -> [F::Lanes<S>; 2] {
        each!([0, 1], |axis| camera.focal[axis] * (self.ratio[axis] - self.slope[axis]))
    }

    /// Gradients of `m0, m1` and of the opacity from those of the ellipse.
    #[inline(always)]
    fn factor_backward(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        opacity: F::Lanes<S>,
        grad: &Ellipse<F::Lanes<S>>,
    ) -> ([Vector<S, F>; 2], F::Lanes<S>) {
        let zero = self.lanes(F::ZERO);
        let mut grad_p = [zero; 3];
        let mut grad_along = scale(self.n, grad.shear);
        if camera.antialias {
            // With P = |p| and S = sigma_v, whose square is ε + P² + ε |along|²:
            // d(P/S) = (ε + ε |along|²)/S² dP/S − P/S ε along·d along / S². Without blur every term is exactly zero; there is
            // no difference of almost equal numbers.
            let (simd, one) = (self.simd, self.lanes(F::ONE));
            let grad_compensation = grad.opacity * opacity;
            let blurred = camera.blur_sigma / self.sigma_v;
            let lost = blurred * norm::<S, F>(simd, [one, norm::<S, F>(simd, self.along), zero]);
            let unit = scale(self.p, one / norm::<S, F>(simd, self.p));
            let through_p = scale(unit, grad_compensation * lost * lost / self.sigma_v);
            let through_along = scale(self.along, grad_compensation * self.compensation * blurred * blurred);
            for axis in 0..3 {
                grad_p[axis] = self.compensation_free.select(through_p[axis], zero);
                grad_along[axis] -= self.compensation_free.select(through_along[axis], zero);
            }
        }
        // `p` and the blur along are divided by `sigma_v` first: a gradient that is divided by a standard deviation again may leave
        // the range of the float.
        let inverse_v = self.lanes(F::ONE) / self.sigma_v;
        grad_p = add(grad_p, scale(scale(self.p, inverse_v), grad.sigma_v));
        let blur_along = scale(self.along, camera.blur_sigma * inverse_v);
        grad_along = add(grad_along, scale(blur_along, camera.blur_sigma * grad.sigma_v));
        let grad_n = add(scale(self.along, grad.shear), cross(self.m[1], grad_p));
        let inverse = self.lanes(F::ONE) / self.sigma_u;
        let grad_sigma_u = grad.sigma_u - (dot(grad_along, self.along) + dot(grad_n, self.n)) * inverse;
        let grad_m0 = add(scale(grad_n, inverse), scale(self.n, grad_sigma_u));
        let grad_m1 = add(cross(grad_p, self.n), scale(grad_along, inverse));
        ([grad_m0, grad_m1], grad.opacity * self.compensation)
    }

    /// Gradients of the centre in the camera's frame and of `W R` from those of the rows of `J W R`, and of the centre and the depth
    /// of the ellipse. `BENDS` as in [`Self::new`].
    #[inline(always)]
    pub fn rows_backward<const BENDS: bool>(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        grad_j: [Vector<S, F>; 2],
        grad: &Ellipse<F::Lanes<S>>,
    ) -> LensProjectionGrad<F::Lanes<S>> {
        if BENDS && let (Some(bent), Some(distortion)) = (&self.bent, &camera.distortion) {
            let grad_seen_at = [grad.mean_px[0] * camera.focal[0], grad.mean_px[1] * camera.focal[1]];
            let mut out = bent.backward(distortion, camera.focal, grad_j, grad_seen_at);
            out.mean_cam[2] += grad.depth;
            return out;
        }
        let zero = self.lanes(F::ZERO);
        let inverse_z = self.lanes(F::ONE) / self.mean_cam[2];
        let mut out = LensProjectionGrad { mean_cam: [zero, zero, grad.depth], rows: [[zero; 3]; 3] };
        for axis in 0..2 {
            // j = (focal / z) (row - slope · last row)
            let grad_leaning = scale(grad_j[axis], camera.focal[axis] * inverse_z);
            out.rows[axis] = grad_leaning;
            out.rows[2] = sub(out.rows[2], scale(grad_leaning, self.slope[axis]));
            out.mean_cam[2] -= dot(grad_j[axis], self.j[axis]) * inverse_z;
            let through_slope = dot(grad_leaning, self.cam_from_gaussian[2]);
            let grad_ratio =
                grad.mean_px[axis] * camera.focal[axis] - self.slope_free[axis].select(through_slope, zero);
            out.mean_cam[axis] = grad_ratio * inverse_z;
            out.mean_cam[2] -= grad_ratio * self.ratio[axis] * inverse_z;
        }
        out
    }

    /// Gradients of the Gaussians from those of their ellipses; zero if those are zero. Adds the pose's gradient, row by row, to
    /// `pose`. `BENDS` as in [`Self::new`].
    #[inline(always)]
    pub(super) fn backward<const BENDS: bool>(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        g: &GaussiansSimd<F::Lanes<S>>,
        grad: &Ellipse<F::Lanes<S>>,
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GradientsSimd<F::Lanes<S>> {
        let zero = self.lanes(F::ZERO);
        let takes_part = self.seen & any_not_zero::<S, F>(&grad.to_row());
        let (grad_m, opacity) = self.factor_backward(camera, g.opacity, grad);
        let scales = add(hadamard(grad_m[0], self.j[0]), hadamard(grad_m[1], self.j[1]));
        let grad_j = [hadamard(grad_m[0], g.scale), hadamard(grad_m[1], g.scale)];
        let through = self.rows_backward::<BENDS>(camera, grad_j, grad);
        GradientsSimd {
            parameters: self.parameters_backward(camera, g, takes_part, &through, (scales, opacity), pose),
            mean2d: each!(grad.mean_px, |value| takes_part.select(value, zero)),
        }
    }

    /// Gradients of the Gaussians that take part from those of the centre in the camera's frame and of `W R`, of the scales and of the
    /// opacity; zero for the others. Adds the pose's gradient, row by row, to `pose`.
    #[inline(always)]
    pub fn parameters_backward(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        g: &GaussiansSimd<F::Lanes<S>>,
        takes_part: MaskOf<S, F>,
        through: &LensProjectionGrad<F::Lanes<S>>,
        (scales, opacity): (Vector<S, F>, F::Lanes<S>),
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GaussiansSimd<F::Lanes<S>> {
        let zero = self.lanes(F::ZERO);
        // cam_from_gaussian = pose rotation · world_from_gaussian
        if let Some(pose) = pose {
            for (axis, pose) in pose.chunks_exact_mut(4).enumerate() {
                let through_rotation = matvec(&self.world_from_gaussian, through.rows[axis]);
                let row = add(through_rotation, scale(g.mean, through.mean_cam[axis]));
                for (sum, value) in pose.iter_mut().zip(row.into_iter().chain([through.mean_cam[axis]])) {
                    *sum += takes_part.select(value, zero);
                }
            }
        }
        let mut grad_world_from_gaussian = [[zero; 3]; 3];
        for column in 0..3 {
            let of_camera = each!([0, 1, 2], |row| through.rows[row][column]);
            let of_world = transposed_matvec(&camera.rotation, of_camera);
            for row in 0..3 {
                grad_world_from_gaussian[row][column] = of_world[row];
            }
        }
        let rotation = self.quaternion_backward(&grad_world_from_gaussian);
        let kept = |value: F::Lanes<S>| takes_part.select(value, zero);
        GaussiansSimd {
            mean: each!(transposed_matvec(&camera.rotation, through.mean_cam), |value| kept(value)),
            rotation: each!(rotation, |value| kept(value)),
            scale: each!(scales, |value| kept(value)),
            opacity: kept(opacity),
        }
    }

    /// Gradient of a quaternion of any length from that of its rotation matrix: through [`rotation_of`], then through the
    /// normalisation `q / |q|`, which leaves only the component normal to the unit quaternion. If the length is so short that the
    /// gradient exceeds the float's range, the gradient is clamped to that range.
    #[inline(always)]
    fn quaternion_backward(&self, g: &Matrix3<F::Lanes<S>>) -> [F::Lanes<S>; 4] {
        let [w, x, y, z] = self.quaternion;
        let two = F::of(2.0);
        // The antisymmetric part of `g`, and its symmetric sums.
        let (ax, ay, az) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
        let (sx, sy, sz) = (g[2][1] + g[1][2], g[0][2] + g[2][0], g[1][0] + g[0][1]);
        let grad_unit = [
            (x * ax + y * ay + z * az) * two,
            (w * ax + y * sz + z * sy - x * (g[1][1] + g[2][2]) * two) * two,
            (w * ay + x * sz + z * sx - y * (g[0][0] + g[2][2]) * two) * two,
            (w * az + x * sy + y * sx - z * (g[0][0] + g[1][1]) * two) * two,
        ];
        let radial = grad_unit[0] * w + grad_unit[1] * x + grad_unit[2] * y + grad_unit[3] * z;
        let (low, high) = (self.lanes(-F::MAX), self.lanes(F::MAX));
        let mut out = grad_unit;
        for (out, unit) in out.iter_mut().zip(self.quaternion) {
            // Comparisons in this form keep NaN, so that it is found later.
            let value = (*out - unit * radial) / self.quaternion_length;
            let value = value.simd_lt(low).select(low, value);
            *out = value.simd_gt(high).select(high, value);
        }
        out
    }
}

/// Gradients of eight Gaussians.
pub(crate) struct GradientsSimd<L> {
    pub parameters: GaussiansSimd<L>,
    /// Gradients of the projected centres, per px.
    pub mean2d: [L; 2],
}

/// Whether any of some values is not zero, or not a number.
#[inline(always)]
pub(crate) fn any_not_zero<S: Simd, F: Real>(values: &[F::Lanes<S>]) -> MaskOf<S, F> {
    let zero = F::Lanes::<S>::splat(values[0].token(), F::ZERO);
    let mut any = !values[0].simd_eq(zero);
    for value in &values[1..] {
        any |= !value.simd_eq(zero);
    }
    any
}

/// Length of vectors, without intermediate overflow or underflow.
#[inline(always)]
pub(crate) fn norm<S: Simd, F: Real>(simd: S, v: Vector<S, F>) -> F::Lanes<S> {
    let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
    let squared = dot(v, v);
    // Within these bounds no square has overflowed, and squares that underflowed are negligible.
    let in_range = squared.simd_gt(lanes(1e-20)) & squared.simd_lt(lanes(1e30));
    let plain = squared.sqrt();
    if in_range.all_true() {
        return plain;
    }
    let largest = v[0].abs().max(v[1].abs()).max(v[2].abs());
    let unit = [v[0] / largest, v[1] / largest, v[2] / largest];
    let scaled = largest.simd_gt(lanes(0.0)).select(largest * dot(unit, unit).sqrt(), largest);
    in_range.select(plain, scaled)
}

/// Normalised quaternions and the lengths of the given ones; NaN for a length of zero. The components are scaled first, so that no
/// length that the float type can represent overflows or underflows.
#[inline(always)]
fn unit_quaternion<S: Simd, F: Real>(simd: S, q: [F::Lanes<S>; 4]) -> ([F::Lanes<S>; 4], F::Lanes<S>) {
    let largest = q[0].abs().max(q[1].abs()).max(q[2].abs().max(q[3].abs()));
    let scaled = each!(q, |c| c / largest);
    let [w, x, y, z] = scaled;
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let zero = F::Lanes::<S>::splat(simd, F::ZERO);
    let whole = largest.simd_gt(zero).select(length * largest, zero);
    (each!(scaled, |c| c / length), whole)
}
