//! The CPU twin of `ray_space`: both passes, generic over the float, by the loops of `project`.

use fearless_simd::prelude::*;

use super::simd::RaySpaceSimd;
use super::{LENS_COLUMNS, RAY_SPACE, columns};
use crate::project::cpu::{GaussianStage, stage_gradients, stage_rows};
use crate::project::simd::{GaussiansSimd, ProjectCameraSimd};
use crate::project::simd_backward::GradientsSimd;
use crate::project::{Geometry, ProjectSpec};
use crate::simd::real::Real;

/// Rows in ray space.
struct RaySpaceStage;

impl<const C: usize> GaussianStage<C> for RaySpaceStage {
    #[inline(always)]
    fn rows<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> [F::Lanes<S>; C] {
        RaySpaceSimd::<S, F>::new::<BENDS>(simd, g, camera).row(camera)
    }

    #[inline(always)]
    fn gradients<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        grad: &[F::Lanes<S>; C],
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GradientsSimd<F::Lanes<S>> {
        RaySpaceSimd::<S, F>::new::<BENDS>(simd, g, camera).backward::<BENDS, C>(camera, g, grad, pose)
    }
}

/// Returns the rows, `[N, 9 (+ 6)]`.
pub(crate) fn ray_space_cpu<F: Real>(inputs: Geometry<&[F]>, spec: &ProjectSpec) -> Vec<F> {
    match columns(&spec.intrinsics) {
        LENS_COLUMNS => stage_rows::<F, RaySpaceStage, LENS_COLUMNS, true>(inputs, spec),
        _ => stage_rows::<F, RaySpaceStage, RAY_SPACE, false>(inputs, spec),
    }
}

/// Returns the gradients of the inputs from `grad`, `[N, 9 (+ 6)]`. Those of opacities are zero.
pub(crate) fn ray_space_backward_cpu<F: Real>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    match columns(&spec.intrinsics) {
        LENS_COLUMNS => stage_gradients::<F, RaySpaceStage, LENS_COLUMNS, true>(inputs, grad, spec, needs),
        _ => stage_gradients::<F, RaySpaceStage, RAY_SPACE, false>(inputs, grad, spec, needs),
    }
}
