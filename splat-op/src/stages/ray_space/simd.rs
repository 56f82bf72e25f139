//! The rows of eight Gaussians at a time and their gradient, one per SIMD lane, from the terms of `project`. Values in the
//! lanes of culled Gaussians are meaningless and are masked before they are stored.

use fearless_simd::prelude::*;

use super::{DEPTH_SLOPE, RAY_SPACE, THICKNESS_MAX};
use crate::linalg::{Matrix3, add, cross, dot, hadamard, scale, sub};
use crate::project::lens_simd::{LensProjectionGrad, LensProjectionSimd};
use crate::project::simd::{GaussiansSimd, ProjectCameraSimd, ProjectionTermsSimd};
use crate::project::simd_backward::{GradientsSimd, ShapeGrad, any_not_zero};
use crate::simd::each;
use crate::simd::lanes::{MaskOf, Vector, norm};
use crate::simd::real::Real;

/// Intermediate values of the forward pass, with the names of the module's documentation.
pub(super) struct RaySpaceSimd<S: Simd, F: Real> {
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

impl<S: Simd, F: Real> RaySpaceSimd<S, F> {
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
            let identity: Matrix3<F::Lanes<S>> = [[one, zero, zero], [zero, one, zero], [zero, zero, one]];
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
        let (zero, projection) = (self.lanes(F::ZERO), &self.projection);
        let (seen, sound) = (projection.seen, projection.seen & self.sound);
        let mut row = [zero; C];
        for k in 0..DEPTH_SLOPE {
            row[k] = sound.select(self.depth_slope[k], zero);
        }
        let [away_x, away_y] = match &self.lens {
            Some(_) => [zero; 2],
            None => projection.away(camera),
        };
        let rest = [self.lanes(F::ONE), away_x, away_y, projection.sigma_u, projection.shear, projection.sigma_v];
        for (value, found) in row[DEPTH_SLOPE..].iter_mut().zip(rest) {
            *value = seen.select(found, zero);
        }
        if let Some(lens) = &self.lens {
            let ([x, y, z], jacobian) = (projection.mean_cam, lens.rows(camera.focal));
            let frame = [x / z, y / z, jacobian[0][0] * z, jacobian[0][1] * z, jacobian[1][0] * z, jacobian[1][1] * z];
            for (value, frame) in row[RAY_SPACE..].iter_mut().zip(frame) {
                *value = seen.select(frame, zero);
            }
        }
        row
    }

    /// Returns the gradients of the rows of `m`, and of the blur times the blur: `B₀₀, B₀₁, B₁₁` of the module's documentation.
    #[inline(always)]
    fn factor_backward(&self, blur_sigma: F::Lanes<S>, grad: &RayGradSimd<F::Lanes<S>>) -> RowsGradSimd<F::Lanes<S>> {
        let Self { mz, length, b_u, p, a, b, c, .. } = *self;
        let ProjectionTermsSimd { n, sigma_u, sigma_v, shear, .. } = self.projection;
        let (zero, one) = (self.lanes(F::ZERO), self.lanes(F::ONE));
        let (inverse_u, inverse_v) = (one / sigma_u, one / sigma_v);
        // The rows of `N`, each at most of length one. The last one is zero where the thickness is clamped or the row was set to zero.
        let across = add(cross(p, n), scale(a, b_u));
        let [slope_u, slope_v, thickness] = self.depth_slope;
        let free = self.thickness_free & thickness.simd_gt(zero) & self.sound;
        let inverse = free.select(one / thickness, zero);
        let through = add(scale(p, dot(mz, p) * inverse), scale(cross(scale(c, b * inverse), n), b));
        let through = add(through, cross(scale(cross(a, mz), inverse), a));
        let of_length = scale(mz, length.simd_gt(zero).select(one / length, one));
        let rest = b * b_u * length * inverse;
        let through = each!(add(through, scale(of_length, rest * b * b_u)), |value| free.select(value, zero));

        let [of_u, of_v, of_t] = each!(grad.depth_slope, |value| self.sound.select(value, zero));
        let [of_sigma_u, of_shear, of_sigma_v] = grad.factor;
        // The gradients of `m0` and `m1` in terms of the rows of `N`.
        let lean = of_shear * inverse_u;
        let turned = free.select((of_v * thickness - of_t * slope_v) * inverse_v, zero);
        let first = [
            of_sigma_u - lean * shear,
            (lean * sigma_v + self.sound.select(of_u * slope_v - of_v * slope_u, zero)) * inverse_u
                - of_sigma_v * shear,
            free.select((of_u * thickness - of_t * slope_u) * inverse_u - turned * shear, zero),
        ];
        let second = [lean, of_sigma_v, turned];
        // The components of the rows of `N` along the blur of x and of y.
        let across_blur = [-(shear * b), b];
        let through_blur = [(slope_v * shear * b - slope_u * b_u) * inverse, -(slope_v * b) * inverse];
        RowsGradSimd {
            m: each!([first, second, [of_u, of_v, of_t]], |of| {
                add(add(scale(n, of[0]), scale(across, of[1])), scale(through, of[2]))
            }),
            blur: [
                blur_sigma * (first[0] * b_u + first[1] * across_blur[0] + first[2] * through_blur[0]),
                blur_sigma * (first[1] * across_blur[1] + first[2] * through_blur[1]),
                blur_sigma * (second[1] * across_blur[1] + second[2] * through_blur[1]),
            ],
        }
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
    ) -> GradientsSimd<F::Lanes<S>> {
        let zero = self.lanes(F::ZERO);
        let (projection, inverse_z) = (&self.projection, self.inverse_z);
        let takes_part = projection.seen & any_not_zero::<S, F>(&grad[..RAY_SPACE]);
        let of = RayGradSimd {
            depth_slope: [grad[0], grad[1], grad[2]],
            depth: grad[3],
            centre: [grad[4], grad[5]],
            factor: [grad[6], grad[7], grad[8]],
        };
        let RowsGradSimd { m: grad_m, blur } = self.factor_backward(camera.blur_sigma, &of);
        let scales = add(hadamard(grad_m[0], projection.j[0]), hadamard(grad_m[1], projection.j[1]));
        let scales = add(scales, hadamard(grad_m[2], self.jz));
        let [grad_j0, grad_j1, grad_jz] = each!(grad_m, |row| hadamard(row, g.scale));
        // `J` has the rows `G (1, −t) / z` and `(0, 0, 1) / z`, and a centre moves in the picture by the former.
        let mut through =
            LensProjectionGrad { mean_cam: [zero; 3], rows: [[zero; 3], [zero; 3], scale(grad_jz, inverse_z)] };
        through.mean_cam[2] = (of.depth + blur[0] + blur[2]) * inverse_z;
        let LinearMapSimd { slopes, by } = self.map(camera);
        for axis in 0..2 {
            let [by_x, by_y] = [by[0][axis] * inverse_z, by[1][axis] * inverse_z];
            let of_row = add(scale(grad_j0, by_x), scale(grad_j1, by_y));
            let of_centre = of.centre[0] * by_x + of.centre[1] * by_y;
            through.rows[axis] = of_row;
            through.rows[2] = sub(through.rows[2], scale(of_row, slopes[axis]));
            through.mean_cam[axis] = of_centre;
            through.mean_cam[2] -= of_centre * slopes[axis];
        }
        if BENDS && let (Some(lens), Some(distortion)) = (&self.lens, &camera.distortion) {
            // The blur alone depends on `G`, whose gradient is `−B G⁻ᵀ`.
            let (z, jacobian) = (projection.mean_cam[2], lens.rows(camera.focal));
            let scaled = (zero - z) / (by[0][0] * by[1][1] - by[0][1] * by[1][0]);
            let mut of_jacobian = [[zero; 3]; 2];
            for (axis, [of_x, of_y]) in [[blur[0], blur[1]], [blur[1], blur[2]]].into_iter().enumerate() {
                of_jacobian[axis][0] = (of_x * by[1][1] - of_y * by[0][1]) * scaled;
                of_jacobian[axis][1] = (of_y * by[0][0] - of_x * by[1][0]) * scaled;
                for k in 0..2 {
                    through.mean_cam[2] += of_jacobian[axis][k] * jacobian[axis][k] * inverse_z;
                }
            }
            let of_lens = lens.backward(distortion, camera.focal, of_jacobian, [zero; 2]);
            through.mean_cam = add(through.mean_cam, of_lens.mean_cam);
        }
        GradientsSimd {
            parameters: projection.parameters_backward(
                camera,
                g,
                takes_part,
                &through,
                ShapeGrad { scales, opacity: zero },
                pose,
            ),
            mean2d: each!(of.centre, |value| takes_part.select(value, zero)),
        }
    }

    /// Returns the linear map of this Gaussian.
    #[inline(always)]
    fn map(&self, camera: &ProjectCameraSimd<F::Lanes<S>>) -> LinearMapSimd<F::Lanes<S>> {
        let zero = self.lanes(F::ZERO);
        match &self.lens {
            Some(lens) => {
                let ([x, y, z], jacobian) = (self.projection.mean_cam, lens.rows(camera.focal));
                let by = each!([0, 1], |row| [jacobian[row][0] * z, jacobian[row][1] * z]);
                LinearMapSimd { slopes: [x / z, y / z], by }
            }
            None => {
                let by = [[camera.focal[0], zero], [zero, camera.focal[1]]];
                LinearMapSimd { slopes: self.projection.slope, by }
            }
        }
    }
}

/// Gradient of a row: of the depth slope and the thickness, of the centre's relative depth and its offset, px, and of `sigma_u`, the
/// shear and `sigma_v`.
struct RayGradSimd<L> {
    depth_slope: [L; DEPTH_SLOPE],
    depth: L,
    centre: [L; 2],
    factor: [L; 3],
}

/// The slopes `t` and `G`, px per slope.
struct LinearMapSimd<L> {
    slopes: [L; 2],
    by: [[L; 2]; 2],
}

/// Gradients of the rows of `m`, and `B₀₀, B₀₁, B₁₁`.
struct RowsGradSimd<L> {
    m: Matrix3<L>,
    blur: [L; 3],
}
