//! The projection of eight Gaussians at a time, one per SIMD lane. Values in the lanes of culled Gaussians are
//! meaningless and are masked before they are stored.

use fearless_simd::prelude::*;

use super::lens_formulas::{Distortion, LensProjection, LensProjectionGrad};
use super::{COMPENSATION_MIN, Ellipse, ProjectSpec, RADIUS_SIGMAS};
use crate::linalg::{Matrix3, add, cross, dot, hadamard, matmul, matvec, rotation_of, scale, sub};
use crate::simd::{LaneNumber, Lanes, MaskOf, Real, Vector, each, norm};

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
    pub(super) antialias: bool,
    /// Whether Gaussians have factors of covariances.
    pub(super) factors: bool,
    /// `None` for a pinhole.
    pub distortion: Option<Distortion<L>>,
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
            factors: spec.factors,
            distortion: Distortion::new(camera),
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
            factors: self.factors,
            #[allow(clippy::manual_map, reason = "a closure may be left out of line, without vector instructions")]
            distortion: match &self.distortion {
                Some(distortion) => Some(distortion.map(
                    #[inline(always)]
                    |value| F::Lanes::<S>::splat(simd, value),
                )),
                None => None,
            },
        }
    }
}

/// The projection of eight centres through a lens.
pub(crate) type Bent<S, F> = LensProjection<LaneNumber<S, F>>;

/// Projects eight centres through a lens; `rows` are those of `W R`.
#[inline(always)]
pub(crate) fn through_lens<S: Simd, F: Real>(
    camera: &ProjectCameraSimd<Lanes<S, F>>,
    distortion: &Distortion<Lanes<S, F>>,
    mean_cam: Vector<S, F>,
    rows: &Matrix3<Lanes<S, F>>,
) -> Bent<S, F> {
    let distortion = distortion.map(
        #[inline(always)]
        |value| LaneNumber(value),
    );
    let limits = [LaneNumber::row(camera.low), LaneNumber::row(camera.high)];
    let rows = each!(*rows, |row| LaneNumber::row(row));
    LensProjection::new(distortion, LaneNumber::row(camera.focal), LaneNumber::row(mean_cam), rows, limits)
}

impl<S: Simd, F: Real> LensProjectionGrad<LaneNumber<S, F>> {
    /// Unwraps the lanes.
    #[inline(always)]
    pub fn lanes(self) -> LensProjectionGrad<Lanes<S, F>> {
        let rows = each!(self.rows, |row| LaneNumber::lanes(row));
        LensProjectionGrad { mean_cam: LaneNumber::lanes(self.mean_cam), rows }
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

/// Intermediate values of the forward pass that the backward pass needs.
pub(crate) struct ProjectionTermsSimd<S: Simd, F: Real> {
    pub(super) simd: S,
    /// Whether each Gaussian is not culled.
    pub seen: MaskOf<S, F>,
    pub mean_cam: Vector<S, F>,
    /// `x/z, y/z`, or their distorted values with a lens; the slopes at which the Jacobian is evaluated; whether each slope is unclamped.
    pub(super) ratio: [F::Lanes<S>; 2],
    pub slope: [F::Lanes<S>; 2],
    pub(super) slope_free: [MaskOf<S, F>; 2],
    pub(super) quaternion: [F::Lanes<S>; 4],
    pub(super) quaternion_length: F::Lanes<S>,
    pub(super) world_from_gaussian: Matrix3<F::Lanes<S>>,
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
    pub(super) compensation: F::Lanes<S>,
    pub(super) compensation_free: MaskOf<S, F>,
    /// Terms of a lens; `None` in the code that is compiled for pinholes.
    pub(super) bent: Option<Bent<S, F>>,
}

impl<S: Simd, F: Real> ProjectionTermsSimd<S, F> {
    /// Projects eight Gaussians. `BENDS` as in [`GaussianStage`](super::cpu::GaussianStage).
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
        let (mut world_from_gaussian, mut sizes) = (rotation_of(one, quaternion), g.scale);
        if BENDS && camera.factors {
            let ([xx, yx, yy, zx], [zy, zz, _]) = (g.rotation, g.scale);
            (world_from_gaussian, sizes) = ([[xx, zero, zero], [yx, yy, zero], [zx, zy, zz]], [one; 3]);
        }
        let cam_from_gaussian = matmul(&camera.rotation, &world_from_gaussian);

        let slope = [ratio[0].max(camera.low[0]).min(camera.high[0]), ratio[1].max(camera.low[1]).min(camera.high[1])];
        let slope_free = [slope[0].simd_eq(ratio[0]), slope[1].simd_eq(ratio[1])];
        let mut j = each!([0, 1], |axis| {
            let leaning = sub(cam_from_gaussian[axis], scale(cam_from_gaussian[2], slope[axis]));
            scale(leaning, camera.focal[axis] / z)
        });
        let mut bent = None;
        if BENDS && let Some(distortion) = &camera.distortion {
            let found = through_lens::<S, F>(camera, distortion, mean_cam, &cam_from_gaussian);
            (ratio, j) = (LaneNumber::lanes(found.seen_at()), each!(found.rows(), |row| LaneNumber::lanes(row)));
            seen &= found.within;
            bent = Some(found);
        }
        seen = seen & finite(ratio[0]) & finite(ratio[1]) & quaternion_length.simd_gt(zero);
        let m = [hadamard(j[0], sizes), hadamard(j[1], sizes)];

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
    pub(super) fn lanes(&self, value: F) -> F::Lanes<S> {
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
