//! The CPU twin of `ray_space`, generic over the float: both passes, by the loops of `project`, and the bounds.

use fearless_simd::prelude::*;

use super::bounds::BoundsRules;
use super::lens_bounds::LensLimits;
use super::simd::RaySpaceSimd;
use super::{LENS_COLUMNS, RAY_SPACE, columns};
use crate::camera::{CameraModel, Intrinsics, PictureRays};
use crate::project::cpu::{GaussianStage, stage_gradients, stage_rows};
use crate::project::simd::{GaussiansSimd, ProjectCameraSimd};
use crate::project::simd_backward::GradientsSimd;
use crate::project::{COLUMNS, Ellipse, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;
use crate::simd::{Columns, LaneNumber, ROW_BLOCK, Real, dispatch, each, width};
use crate::tasks;

/// Gaussians per task.
const CHUNK: usize = 1024;

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

/// Returns the point of the picture next to a centre, and the distance of the centre from there, px. With a lens it is the centre.
pub(crate) fn beyond<F: Real>(mean_px: [F; 2], camera: &Intrinsics) -> ([F; 2], [F; 2]) {
    if camera.model != CameraModel::Pinhole {
        return (mean_px, [F::ZERO; 2]);
    }
    let size = [camera.width, camera.height].map(|px| F::of(px as f64));
    let base = [0, 1].map(|axis| mean_px[axis].within(F::ZERO, size[axis]));
    (base, [0, 1].map(|axis| mean_px[axis] - base[axis]))
}

/// Returns rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and rows `[N, 9 (+ 6)]`. Culled Gaussians stay culled.
pub(crate) fn bounds_cpu<F: Real>(packed: &[F], ray_rows: &[F], spec: &RasterizeSpec) -> Vec<F> {
    match PictureRays::of(&spec.intrinsics) {
        None => by_chunks::<F, RAY_SPACE>(packed, ray_rows, spec, None),
        Some(rays) => {
            let limits = LensLimits::new(&spec.intrinsics, &rays);
            by_chunks::<F, LENS_COLUMNS>(packed, ray_rows, spec, Some(&limits))
        }
    }
}

fn by_chunks<F: Real, const C: usize>(
    packed: &[F],
    ray_rows: &[F],
    spec: &RasterizeSpec,
    limits: Option<&LensLimits<F>>,
) -> Vec<F> {
    let mut bounds = vec![F::ZERO; packed.len()];
    let chunks = packed.chunks(CHUNK * COLUMNS).zip(ray_rows.chunks(CHUNK * C));
    tasks::for_each(bounds.chunks_mut(CHUNK * COLUMNS).zip(chunks), |_, (out, (rows, slopes))| {
        dispatch!(F, simd => bounds_of_chunk::<_, F, C>(simd, out, rows, slopes, &BoundsRules::lanes(simd, spec, limits)));
    });
    bounds
}

impl<S: Simd, F: Real> BoundsRules<LaneNumber<S, F>> {
    #[inline(always)]
    fn lanes(simd: S, spec: &RasterizeSpec, limits: Option<&LensLimits<F>>) -> Self {
        let lanes = |value: F| LaneNumber::splat(simd, value);
        let mut rules = Self {
            size: each!([spec.intrinsics.width, spec.intrinsics.height], |px| lanes(F::of(px as f64))),
            alpha_min: lanes(F::of(spec.options.alpha_min)),
            limits: None,
        };
        if let Some(limits) = limits {
            rules.limits = Some(LensLimits {
                fisheye: limits.fisheye,
                low: each!(limits.low, |value| lanes(value)),
                high: each!(limits.high, |value| lanes(value)),
                farthest: lanes(limits.farthest),
                bend_px: lanes(limits.bend_px),
                bend_radius: lanes(limits.bend_radius),
                stretch_px: lanes(limits.stretch_px),
            });
        }
        rules
    }
}

/// Writes the bounds of consecutive Gaussians, whose rows have `C` columns.
#[inline(always)]
fn bounds_of_chunk<S: Simd, F: Real, const C: usize>(
    simd: S,
    out: &mut [F],
    packed: &[F],
    ray_rows: &[F],
    rules: &BoundsRules<LaneNumber<S, F>>,
) {
    let (mut ellipses, mut slopes, mut found) =
        (Columns::<F, COLUMNS>::new(), Columns::<F, C>::new(), Columns::<F, COLUMNS>::new());
    let blocks = out.chunks_mut(ROW_BLOCK * COLUMNS).zip(packed.chunks(ROW_BLOCK * COLUMNS));
    for ((out, rows), of_slopes) in blocks.zip(ray_rows.chunks(ROW_BLOCK * C)) {
        ellipses.read(rows);
        slopes.read(of_slopes);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let ellipse = Ellipse::from_row(&ellipses.numbers(simd, at));
            let bounds = rules.bound(&ellipse, &slopes.numbers::<S>(simd, at));
            found.store(at, LaneNumber::lanes(bounds.to_row()));
        }
        found.write(out);
    }
}
