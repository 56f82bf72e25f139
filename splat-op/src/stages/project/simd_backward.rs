//! The gradient of the projection of eight Gaussians at a time, one per SIMD lane.

use fearless_simd::prelude::*;

use super::Ellipse;
use super::lens_formulas::LensProjectionGrad;
use super::simd::{GaussiansSimd, ProjectCameraSimd, ProjectionTermsSimd};
use crate::linalg::{Matrix3, add, cross, dot, hadamard, matmul, matvec, scale, sub, transpose, transposed_matvec};
use crate::simd::{LaneNumber, MaskOf, Real, Vector, each, norm};

impl<S: Simd, F: Real> ProjectionTermsSimd<S, F> {
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
            // With P = |p| and S = sigma_v, whose square is ε + P² + ε |along|²: d(P/S) = (ε + ε |along|²)/S² dP/S − P/S ε along·d along /
            // S². Without blur every term is exactly zero; there is no difference of almost equal numbers.
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
        if BENDS && let Some(bent) = &self.bent {
            let grad_j = each!(grad_j, |row| LaneNumber::row(row));
            let mut out = bent.backward(grad_j, LaneNumber::row(grad.mean_px)).lanes();
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
        let mut grad_j = [hadamard(grad_m[0], g.scale), hadamard(grad_m[1], g.scale)];
        if BENDS && camera.factors {
            grad_j = grad_m;
        }
        let through = self.rows_backward::<BENDS>(camera, grad_j, grad);
        let mut parameters =
            self.parameters_backward(camera, g, takes_part, &through, ShapeGrad { scales, opacity }, pose);
        if BENDS && camera.factors {
            let [x, y, z] = matmul(&transpose(&camera.rotation), &through.rows);
            parameters.rotation = each!([x[0], y[0], y[1], z[0]], |value| takes_part.select(value, zero));
            parameters.scale = each!([z[1], z[2], zero], |value| takes_part.select(value, zero));
        }
        GradientsSimd { parameters, mean2d: each!(grad.mean_px, |value| takes_part.select(value, zero)) }
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
        of: ShapeGrad<F::Lanes<S>>,
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
            scale: each!(of.scales, |value| kept(value)),
            opacity: kept(of.opacity),
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

/// Gradients of the scales and of the opacity.
pub(crate) struct ShapeGrad<L> {
    pub scales: [L; 3],
    pub opacity: L,
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
