//! The depth slopes of eight Gaussians at a time and their gradient, one per SIMD lane, from the terms of `project`. Values in the
//! lanes of culled Gaussians are meaningless and are masked before they are stored.

use fearless_simd::prelude::*;

use super::{DEPTH_SLOPE, THICKNESS_MAX};
use crate::linalg::{Mat3, add, cross, dot, hadamard, scale, sub};
use crate::project::Ellipse;
use crate::project::lens_simd::LensProjectionSimd;
use crate::project::simd::{GaussiansSimd, MaskOf, ProjectCameraSimd, ProjectionTermsSimd, Vector, any_not_zero, norm};
use crate::simd::each;
use crate::simd::real::Real;

/// Intermediate values of the forward pass, with the names of the module's documentation.
pub(super) struct DepthSlopeSimd<S: Simd, F: Real> {
    simd: S,
    projection: ProjectionTermsSimd<S, F>,
    inverse_z: F::Lanes<S>,
    /// `mz`, and without the scales.
    mz: Vector<S, F>,
    jz: Vector<S, F>,
    length: F::Lanes<S>,
    b_u: F::Lanes<S>,
    b: F::Lanes<S>,
    p: Vector<S, F>,
    a: Vector<S, F>,
    c: Vector<S, F>,
    depth_slope: [F::Lanes<S>; DEPTH_SLOPE],
    thickness_free: MaskOf<S, F>,
    /// False if the Gaussian is too long for a depth slope.
    sound: MaskOf<S, F>,
    /// With a lens, its projection of Gaussians that are not rotated against the camera: the rows of their `J W R` are those of `J`.
    lens: Option<LensProjectionSimd<S, F>>,
}

impl<S: Simd, F: Real> DepthSlopeSimd<S, F> {
    /// `BENDS` says whether the camera has a lens; it keeps lenses out of the code for pinholes.
    #[inline(always)]
    pub fn new<const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> Self {
        let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
        let (zero, one) = (lanes(0.0), lanes(1.0));
        let projection = ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, g, camera);
        let ProjectionTermsSimd { n, along, sigma_u, sigma_v, .. } = projection;
        let inverse_z = one / projection.mean_cam[2];
        let jz = scale(projection.cam_from_gaussian[2], inverse_z);
        let mz = hadamard(jz, g.scale);
        let (b_u, b) = (camera.blur_sigma / sigma_u, camera.blur_sigma / sigma_v);
        let (p, a) = (scale(projection.p, one / sigma_v), scale(along, b));
        let c = cross(n, mz);
        let length = norm::<S, F>(simd, mz);
        let across = norm::<S, F>(simd, [dot(mz, p), b * norm::<S, F>(simd, c), zero]);
        let thickness = norm::<S, F>(simd, [across, norm::<S, F>(simd, cross(a, mz)), b * b_u * length]);
        let depth_slope = [dot(mz, n), dot(p, c) + b_u * dot(a, mz), thickness.min(lanes(THICKNESS_MAX))];
        let largest = F::Lanes::<S>::splat(simd, F::MAX);
        let finite = |value: F::Lanes<S>| value.abs().simd_le(largest);
        let sound = length.simd_le(lanes(1e30))
            & finite(depth_slope[0])
            & finite(depth_slope[1])
            & thickness.simd_eq(thickness);
        let mut lens = None;
        if BENDS && let Some(distortion) = &camera.distortion {
            let identity: Mat3<F::Lanes<S>> = [[one, zero, zero], [zero, one, zero], [zero, zero, one]];
            let limits = [camera.low, camera.high];
            lens = Some(LensProjectionSimd::new(distortion, projection.mean_cam, &identity, limits));
        }
        Self {
            simd,
            inverse_z,
            mz,
            jz,
            length,
            b_u,
            b,
            p,
            a,
            c,
            depth_slope,
            thickness_free: depth_slope[2].simd_eq(thickness),
            sound,
            lens,
            projection,
        }
    }

    #[inline(always)]
    fn lanes(&self, value: F) -> F::Lanes<S> {
        F::Lanes::<S>::splat(self.simd, value)
    }

    /// Returns the rows, with the columns of a lens if `C` has them.
    #[inline(always)]
    pub fn row<const C: usize>(&self, camera: &ProjectCameraSimd<F::Lanes<S>>) -> [F::Lanes<S>; C] {
        let (zero, seen) = (self.lanes(F::ZERO), self.projection.seen);
        let sound = seen & self.sound;
        let mut row = [zero; C];
        for k in 0..DEPTH_SLOPE {
            row[k] = sound.select(self.depth_slope[k], zero);
        }
        if let Some(lens) = &self.lens {
            let ([x, y, z], jacobian) = (self.projection.mean_cam, lens.rows(camera.focal));
            let frame = [x / z, y / z, jacobian[0][0] * z, jacobian[0][1] * z, jacobian[1][0] * z, jacobian[1][1] * z];
            for (value, frame) in row[DEPTH_SLOPE..].iter_mut().zip(frame) {
                *value = seen.select(frame, zero);
            }
        }
        row
    }

    /// Returns the gradients of the rows of `m` from the gradient of the depth slope.
    #[inline(always)]
    fn factor_backward(&self, [grad_u, grad_v, grad_thickness]: [F::Lanes<S>; DEPTH_SLOPE]) -> Mat3<F::Lanes<S>> {
        let Self { mz, length, b_u, p, a, b, c, .. } = *self;
        let ProjectionTermsSimd { n, along, m, sigma_u, sigma_v, .. } = self.projection;
        let (zero, one) = (self.lanes(F::ZERO), self.lanes(F::ONE));
        let e = cross(a, mz);
        // Four parts of the thickness, each divided by the thickness; each has at most length one.
        let free = self.thickness_free & self.depth_slope[2].simd_gt(zero);
        let grad_thickness = free.select(grad_thickness, zero);
        let inverse = free.select(one / self.depth_slope[2], zero);
        let (along_p, along_c) = (dot(mz, p) * inverse, scale(c, b * inverse));
        let (along_e, rest) = (scale(e, inverse), b * b_u * length * inverse);
        let of_length = scale(mz, length.simd_gt(zero).select(one / length, one));

        let mut grad_mz = add(scale(n, grad_u), scale(add(cross(p, n), scale(a, b_u)), grad_v));
        let through = add(add(scale(p, along_p), scale(cross(along_c, n), b)), cross(along_e, a));
        grad_mz = add(grad_mz, scale(add(through, scale(of_length, rest * b * b_u)), grad_thickness));
        let grad_n = add(scale(mz, grad_u), scale(cross(mz, p), grad_v));
        let grad_n = add(grad_n, scale(cross(mz, along_c), b * grad_thickness));
        let grad_p = add(scale(c, grad_v), scale(mz, along_p * grad_thickness));
        let grad_a = add(scale(mz, b_u * grad_v), scale(cross(mz, along_e), grad_thickness));
        let grad_b = grad_thickness * (dot(along_c, c) + rest * b_u * length);
        let grad_b_u = grad_v * dot(a, mz) + grad_thickness * rest * b * length;

        // p, a and b together have length one and the common denominator sigma_v.
        let radial = dot(grad_p, p) + dot(grad_a, a) + grad_b * b;
        let grad_across = scale(sub(grad_p, scale(p, radial)), one / sigma_v);
        let grad_along = scale(sub(grad_a, scale(a, radial)), b);
        let grad_n = add(grad_n, cross(m[1], grad_across));
        // n and bᵤ have the common denominator sigma_u.
        let radial = dot(grad_n, n) + grad_b_u * b_u + dot(grad_along, along);
        let inverse_u = one / sigma_u;
        let grad_m0 = scale(sub(grad_n, scale(n, radial)), inverse_u);
        let grad_m1 = add(cross(grad_across, n), scale(grad_along, inverse_u));
        [grad_m0, grad_m1, grad_mz]
    }

    /// Gradients of the Gaussians from those of their rows; zero if those are zero. Adds the pose's gradient, row by row, to `pose`.
    /// `BENDS` as in [`Self::new`].
    #[inline(always)]
    pub fn backward<const BENDS: bool, const C: usize>(
        &self,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        g: &GaussiansSimd<F::Lanes<S>>,
        grad: &[F::Lanes<S>; C],
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GaussiansSimd<F::Lanes<S>> {
        let zero = self.lanes(F::ZERO);
        let (projection, inverse_z) = (&self.projection, self.inverse_z);
        let takes_part = projection.seen & self.sound & any_not_zero::<S, F>(grad);
        let grad_m = self.factor_backward([grad[0], grad[1], grad[2]]);
        let scales = add(hadamard(grad_m[0], projection.j[0]), hadamard(grad_m[1], projection.j[1]));
        let scales = add(scales, hadamard(grad_m[2], self.jz));
        let [grad_j0, grad_j1, grad_jz] = each!(grad_m, |row| hadamard(row, g.scale));
        let mut through = projection.rows_backward::<BENDS>(camera, [grad_j0, grad_j1], &Ellipse::from_row(&[zero; 7]));
        // The last row of `W R` is divided by z.
        through.rows[2] = add(through.rows[2], scale(grad_jz, inverse_z));
        through.mean_cam[2] -= dot(grad_jz, self.jz) * inverse_z;
        if BENDS && let (Some(lens), Some(distortion)) = (&self.lens, &camera.distortion) {
            let (z, jacobian) = (projection.mean_cam[2], lens.rows(camera.focal));
            let mut of_jacobian = [[zero; 3]; 2];
            for (at, of_frame) in grad[DEPTH_SLOPE + 2..].iter().enumerate() {
                of_jacobian[at / 2][at % 2] = *of_frame * z;
                through.mean_cam[2] += *of_frame * jacobian[at / 2][at % 2];
            }
            let of_lens = lens.backward(distortion, camera.focal, of_jacobian, [zero; 2]);
            through.mean_cam = add(through.mean_cam, of_lens.mean_cam);
        }
        projection.parameters_backward(camera, g, takes_part, &through, (scales, zero), pose)
    }
}
