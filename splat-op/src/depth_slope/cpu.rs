//! The CPU twin of `depth_slope`: both passes, generic over the float, by the loops of `project`.

use fearless_simd::prelude::*;

use super::simd::DepthSlopeSimd;
use super::{DEPTH_SLOPE, LENS_COLUMNS, columns};
use crate::project::cpu::{GaussianStage, stage_gradients, stage_rows};
use crate::project::simd::{GaussiansSimd, GradientsSimd, ProjectCameraSimd};
use crate::project::{Geometry, ProjectSpec};
use crate::simd::real::Real;

/// Rows of depth slopes.
struct DepthSlope;

impl<const C: usize> GaussianStage<C> for DepthSlope {
    #[inline(always)]
    fn rows<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> [F::Lanes<S>; C] {
        DepthSlopeSimd::<S, F>::new::<BENDS>(simd, g, camera).row(camera)
    }

    #[inline(always)]
    fn gradients<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        grad: &[F::Lanes<S>; C],
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GradientsSimd<F::Lanes<S>> {
        let found = DepthSlopeSimd::<S, F>::new::<BENDS>(simd, g, camera);
        GradientsSimd {
            parameters: found.backward::<BENDS, C>(camera, g, grad, pose),
            mean2d: [F::Lanes::<S>::splat(simd, F::ZERO); 2],
        }
    }
}

/// Returns the depth slopes and thicknesses and, with a lens, its columns: `[N, 3 (+ 6)]`.
pub(crate) fn depth_slope_cpu<F: Real>(inputs: Geometry<&[F]>, spec: &ProjectSpec) -> Vec<F> {
    match columns(&spec.intrinsics) {
        LENS_COLUMNS => stage_rows::<F, DepthSlope, LENS_COLUMNS, true>(inputs, spec),
        _ => stage_rows::<F, DepthSlope, DEPTH_SLOPE, false>(inputs, spec),
    }
}

/// Returns the gradients of the inputs from `grad`, `[N, 3 (+ 6)]`. Those of opacities and projected centres are zero.
pub(crate) fn depth_slope_backward_cpu<F: Real>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    match columns(&spec.intrinsics) {
        LENS_COLUMNS => stage_gradients::<F, DepthSlope, LENS_COLUMNS, true>(inputs, grad, spec, needs),
        _ => stage_gradients::<F, DepthSlope, DEPTH_SLOPE, false>(inputs, grad, spec, needs),
    }
}
