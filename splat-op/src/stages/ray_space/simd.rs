//! The rows of eight Gaussians at a time and their gradient, one per SIMD lane, from the terms of `project`. Values in the
//! lanes of culled Gaussians are meaningless and are masked before they are stored.

use fearless_simd::prelude::*;

use super::formulas::{Factored, RaySpaceGrad, RaySpaceTerms};
use super::{LensFrame, RAY_SPACE};
use crate::linalg::{Matrix3, Number, add};
use crate::project::lens_formulas::LensProjectionGrad;
use crate::project::simd::{Bent, GaussiansSimd, ProjectCameraSimd, ProjectionTermsSimd, through_lens};
use crate::project::simd_backward::{GradientsSimd, ShapeGrad, any_not_zero};
use crate::simd::{LaneNumber, Real, each};

/// Eight Gaussians in ray space.
pub(super) struct RaySpaceSimd<S: Simd, F: Real> {
    projection: ProjectionTermsSimd<S, F>,
    terms: RaySpaceTerms<LaneNumber<S, F>>,
    map: LensFrame<LaneNumber<S, F>>,
    /// A lens's projection of Gaussians that are not rotated against the camera, whose rows of `J W R` are those of `J`.
    lens: Option<Bent<S, F>>,
}

impl<S: Simd, F: Real> RaySpaceSimd<S, F> {
    /// `BENDS` says whether the camera has a lens; it keeps lenses out of the code for pinholes.
    #[inline(always)]
    pub fn new<const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> Self {
        let projection = ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, g, camera);
        let terms = RaySpaceTerms::new(Factored {
            n: LaneNumber::row(projection.n),
            along: LaneNumber::row(projection.along),
            p: LaneNumber::row(projection.p),
            sigma_u: LaneNumber(projection.sigma_u),
            shear: LaneNumber(projection.shear),
            sigma_v: LaneNumber(projection.sigma_v),
            last: LaneNumber::row(projection.cam_from_gaussian[2]),
            depth: LaneNumber(projection.mean_cam[2]),
            scale: LaneNumber::row(g.scale),
            blur_sigma: LaneNumber(camera.blur_sigma),
        });
        let [zero, one] = each!([F::ZERO, F::ONE], |value| LaneNumber::<S, F>::splat(simd, value));
        let [focal_x, focal_y] = LaneNumber::row(camera.focal);
        let slopes = LaneNumber::row(projection.slope);
        let mut map = LensFrame { centre: slopes, by: [[focal_x, zero], [zero, focal_y]] };
        let mut lens = None;
        if BENDS && let Some(distortion) = &camera.distortion {
            let identity: Matrix3<F::Lanes<S>> =
                [[one.0, zero.0, zero.0], [zero.0, one.0, zero.0], [zero.0, zero.0, one.0]];
            let bent = through_lens::<S, F>(camera, distortion, projection.mean_cam, &identity);
            map = LensFrame::at(LaneNumber::row(projection.mean_cam), &bent.rows());
            lens = Some(bent);
        }
        Self { projection, terms, map, lens }
    }

    /// Returns the rows, with the columns of a lens if `C` has them.
    #[inline(always)]
    pub fn row<const C: usize>(&self, camera: &ProjectCameraSimd<F::Lanes<S>>) -> [F::Lanes<S>; C] {
        let zero = self.map.centre[0].constant(0.0);
        let mut row = [zero.0; C];
        let away = match &self.lens {
            Some(_) => [zero; 2],
            None => LaneNumber::row(self.projection.away(camera)),
        };
        row[..RAY_SPACE].copy_from_slice(&LaneNumber::lanes(self.terms.row(self.projection.seen, away)));
        if self.lens.is_some() {
            let columns = LaneNumber::select_all(self.projection.seen, self.map.to_row(), [zero; 6]);
            row[RAY_SPACE..].copy_from_slice(&LaneNumber::lanes(columns));
        }
        row
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
        let projection = &self.projection;
        let zero = self.map.centre[0].constant(0.0);
        let takes_part = projection.seen & any_not_zero::<S, F>(&grad[..RAY_SPACE]);
        let j = each!(projection.j, |row| LaneNumber::row(row));
        let RaySpaceGrad { scales, rows, centre, blur } = self.terms.backward(j, &self.map, &LaneNumber::row(*grad));
        let mut through = LensProjectionGrad { mean_cam: centre, rows };
        if BENDS && let Some(bent) = &self.lens {
            let (of_jacobian, of_z) = self.map.backward(LaneNumber(projection.mean_cam[2]), &bent.rows(), blur);
            through.mean_cam[2] = through.mean_cam[2] + of_z;
            let of_lens = bent.backward(of_jacobian, [zero; 2]);
            through.mean_cam = add(through.mean_cam, of_lens.mean_cam);
        }
        let of_shape = ShapeGrad { scales: LaneNumber::lanes(scales), opacity: zero.0 };
        GradientsSimd {
            parameters: projection.parameters_backward(camera, g, takes_part, &through.lanes(), of_shape, pose),
            mean2d: each!([grad[4], grad[5]], |value| takes_part.select(value, zero.0)),
        }
    }
}
