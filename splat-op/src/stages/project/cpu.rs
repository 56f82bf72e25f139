//! The CPU twin of `project`: both passes, generic over the float, parallel over chunks of Gaussians. `ray_space` runs by the same loops.

use fearless_simd::prelude::*;

use super::simd::{GaussiansSimd, ProjectCameraSimd, ProjectionTermsSimd};
use super::simd_backward::GradientsSimd;
use super::{COLUMNS, Ellipse, Geometry, ProjectSpec, WIDTHS};
use crate::simd::{Columns, ROW_BLOCK, Real, dispatch, each, width};
use crate::{CameraModel, tasks};

/// Number of Gaussians per task. Sums over all Gaussians add one partial sum per chunk in order, so threads never change a result.
const CHUNK: usize = 1024;

/// The parameters of up to [`ROW_BLOCK`] Gaussians, column by column.
struct Parameters<F> {
    means: Columns<F, 3>,
    rotations: Columns<F, 4>,
    scales: Columns<F, 3>,
    opacities: Columns<F, 1>,
}

impl<F: Real> Parameters<F> {
    fn new() -> Self {
        Self { means: Columns::new(), rotations: Columns::new(), scales: Columns::new(), opacities: Columns::new() }
    }

    #[inline(always)]
    fn read(&mut self, inputs: &Geometry<&[F]>, first: usize) {
        self.means.read(&inputs.means[3 * first..]);
        self.rotations.read(&inputs.rotations[4 * first..]);
        self.scales.read(&inputs.scales[3 * first..]);
        self.opacities.read(&inputs.opacities[first..]);
    }

    #[inline(always)]
    fn store<S: Simd>(&mut self, first: usize, eight: &GaussiansSimd<F::Lanes<S>>) {
        self.means.store(first, eight.mean);
        self.rotations.store(first, eight.rotation);
        self.scales.store(first, eight.scale);
        self.opacities.store(first, [eight.opacity]);
    }

    #[inline(always)]
    fn eight<S: Simd>(&self, simd: S, first: usize) -> GaussiansSimd<F::Lanes<S>> {
        GaussiansSimd {
            mean: self.means.all_lanes(simd, first),
            rotation: self.rotations.all_lanes(simd, first),
            scale: self.scales.all_lanes(simd, first),
            opacity: self.opacities.lanes(simd, 0, first),
        }
    }
}

/// What is computed of each Gaussian: a row of `C` numbers, and its gradient. `BENDS` says whether the camera has a lens, or Gaussians have
/// factors; it keeps both out of the code of plain renders.
pub(crate) trait GaussianStage<const C: usize> {
    /// Rows of eight Gaussians.
    fn rows<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> [F::Lanes<S>; C];

    /// Gradients of eight Gaussians from those of their rows; zero if those are zero. Adds the pose's gradient, row by row, to `pose`.
    fn gradients<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        grad: &[F::Lanes<S>; C],
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GradientsSimd<F::Lanes<S>>;
}

/// Packed ellipses.
struct ProjectStage;

impl GaussianStage<COLUMNS> for ProjectStage {
    #[inline(always)]
    fn rows<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
    ) -> [F::Lanes<S>; COLUMNS] {
        ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, g, camera).ellipse(camera, g).to_row()
    }

    #[inline(always)]
    fn gradients<S: Simd, F: Real, const BENDS: bool>(
        simd: S,
        g: &GaussiansSimd<F::Lanes<S>>,
        camera: &ProjectCameraSimd<F::Lanes<S>>,
        grad: &[F::Lanes<S>; COLUMNS],
        pose: Option<&mut [F::Lanes<S>; 12]>,
    ) -> GradientsSimd<F::Lanes<S>> {
        let terms = ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, g, camera);
        terms.backward::<BENDS>(camera, g, &Ellipse::from_row(grad), pose)
    }
}

/// `[N, 7]` packed ellipses.
pub(crate) fn project_cpu<F: Real>(inputs: Geometry<&[F]>, spec: &ProjectSpec) -> Vec<F> {
    match spec.intrinsics.model {
        CameraModel::Pinhole if !spec.factors => stage_rows::<F, ProjectStage, COLUMNS, false>(inputs, spec),
        _ => stage_rows::<F, ProjectStage, COLUMNS, true>(inputs, spec),
    }
}

/// Gradients of the inputs from `grad`, the `[N, 7]` gradient of the packed ellipses.
pub(crate) fn project_backward_cpu<F: Real>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    match spec.intrinsics.model {
        CameraModel::Pinhole if !spec.factors => {
            stage_gradients::<F, ProjectStage, COLUMNS, false>(inputs, grad, spec, needs)
        }
        _ => stage_gradients::<F, ProjectStage, COLUMNS, true>(inputs, grad, spec, needs),
    }
}

/// `[N, C]` rows of a stage.
pub(crate) fn stage_rows<F: Real, T: GaussianStage<C>, const C: usize, const BENDS: bool>(
    inputs: Geometry<&[F]>,
    spec: &ProjectSpec,
) -> Vec<F> {
    chunks_of_rows(&inputs, spec, C, |inputs, camera, first, rows| {
        dispatch!(F, simd => rows_of_chunk::<_, F, T, C, BENDS>(simd, inputs, camera, first, rows));
    })
}

/// Writes the rows of the Gaussians from a number on.
type RowsOfChunk<F> = fn(&Geometry<&[F]>, &ProjectCameraSimd<F>, usize, &mut [F]);

// This and `chunks_of_gradients` are compiled once for all stages and lenses.
fn chunks_of_rows<F: Real>(
    inputs: &Geometry<&[F]>,
    spec: &ProjectSpec,
    columns: usize,
    rows_of_chunk: RowsOfChunk<F>,
) -> Vec<F> {
    let camera = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let mut all = vec![F::ZERO; inputs.opacities.len() * columns];
    tasks::for_each(all.chunks_mut(CHUNK * columns), |chunk, rows| rows_of_chunk(inputs, &camera, chunk * CHUNK, rows));
    all
}

#[inline(always)]
fn rows_of_chunk<S: Simd, F: Real, T: GaussianStage<C>, const C: usize, const BENDS: bool>(
    simd: S,
    inputs: &Geometry<&[F]>,
    camera: &ProjectCameraSimd<F>,
    first: usize,
    rows: &mut [F],
) {
    let camera = camera.lanes(simd);
    let (mut parameters, mut found) = (Parameters::new(), Columns::<F, C>::new());
    for (block, rows) in rows.chunks_mut(ROW_BLOCK * C).enumerate() {
        parameters.read(inputs, first + block * ROW_BLOCK);
        for at in (0..rows.len() / C).step_by(width::<S, F>()) {
            let eight = parameters.eight(simd, at);
            found.store(at, T::rows::<S, F, BENDS>(simd, &eight, &camera));
        }
        found.write(rows);
    }
}

/// Gradients of the inputs of a stage from `grad`, the `[N, C]` gradient of its rows. Those not needed are empty.
pub(crate) fn stage_gradients<F: Real, T: GaussianStage<C>, const C: usize, const BENDS: bool>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    chunks_of_gradients(
        &inputs,
        grad,
        C,
        spec,
        needs,
        |inputs, camera, first, grad, pose, out| dispatch!(F, simd => gradients_of_chunk::<_, F, T, C, BENDS>(simd, inputs, camera, first, grad, pose, out)),
    )
}

/// Writes the gradients of the Gaussians from a number on, and returns their share of the pose's.
type GradientsOfChunk<F> =
    fn(&Geometry<&[F]>, &ProjectCameraSimd<F>, usize, &[F], bool, &mut Geometry<&mut [F]>) -> [F; 12];

fn chunks_of_gradients<F: Real>(
    inputs: &Geometry<&[F]>,
    grad: &[F],
    columns: usize,
    spec: &ProjectSpec,
    needs: Geometry<bool>,
    gradients_of_chunk: GradientsOfChunk<F>,
) -> Geometry<Vec<F>> {
    let camera = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let count = inputs.opacities.len();
    let mut grads = needs.zip(WIDTHS).map(|(needed, width)| vec![F::ZERO; if needed { count * width } else { 0 }]);
    let mut rows = grads.each_mut().zip(WIDTHS).map(|(rows, width)| rows.chunks_mut((CHUNK * width).max(1)));
    let chunks = (0..count.div_ceil(CHUNK)).map(|_| rows.each_mut().map(|rows| rows.next().unwrap_or_default()));
    let pose = tasks::map(chunks, |chunk, mut out| {
        let first = chunk * CHUNK;
        let grad = &grad[first * columns..count.min(first + CHUNK) * columns];
        gradients_of_chunk(inputs, &camera, first, grad, needs.cam_from_world, &mut out)
    });
    if needs.cam_from_world {
        let mut total = [F::ZERO; 12];
        for part in pose {
            total.iter_mut().zip(part).for_each(|(sum, value)| *sum += value);
        }
        grads.cam_from_world = total.to_vec();
    }
    grads
}

/// Writes the gradients of `count` Gaussians from `first` on to a chunk's gradients, which are empty where they are not needed.
#[inline(always)]
fn write<F: Real>(
    out: &mut Geometry<&mut [F]>,
    found: &Parameters<F>,
    mean2d: &Columns<F, 2>,
    first: usize,
    count: usize,
) {
    let parts = out.each_mut().zip(WIDTHS).map(|(rows, width)| match rows.is_empty() {
        true => &mut rows[..],
        false => &mut rows[width * first..width * (first + count)],
    });
    found.means.write(parts.means);
    found.rotations.write(parts.rotations);
    found.scales.write(parts.scales);
    found.opacities.write(parts.opacities);
    mean2d.write(parts.mean2d);
}

/// Computes the gradients of the Gaussians from `first` on from those of their rows. Returns their share of the pose's gradient
/// if it is needed.
#[inline(always)]
fn gradients_of_chunk<S: Simd, F: Real, T: GaussianStage<C>, const C: usize, const BENDS: bool>(
    simd: S,
    inputs: &Geometry<&[F]>,
    camera: &ProjectCameraSimd<F>,
    first: usize,
    grad: &[F],
    needs_pose: bool,
    out: &mut Geometry<&mut [F]>,
) -> [F; 12] {
    let camera = camera.lanes(simd);
    let mut pose = [F::Lanes::<S>::splat(simd, F::ZERO); 12];
    let (mut parameters, mut found) = (Parameters::new(), Parameters::new());
    let (mut grads, mut mean2d) = (Columns::<F, C>::new(), Columns::new());
    for (block, grad) in grad.chunks(ROW_BLOCK * C).enumerate() {
        // Most Gaussians of a large scene are out of view and have a gradient of exactly zero.
        if grad.iter().all(|value| *value == F::ZERO) {
            continue;
        }
        let count = grad.len() / C;
        // Values of a previous, longer block must not enter the pose's sum.
        if count < ROW_BLOCK {
            grads = Columns::new();
        }
        grads.read(grad);
        parameters.read(inputs, first + block * ROW_BLOCK);
        for at in (0..count).step_by(width::<S, F>()) {
            let eight = parameters.eight(simd, at);
            let row = grads.all_lanes(simd, at);
            let one = T::gradients::<S, F, BENDS>(simd, &eight, &camera, &row, needs_pose.then_some(&mut pose));
            found.store::<S>(at, &one.parameters);
            mean2d.store(at, one.mean2d);
        }
        write(out, &found, &mean2d, block * ROW_BLOCK, count);
    }
    each!(pose, |lanes| lanes.reduce_sum())
}
