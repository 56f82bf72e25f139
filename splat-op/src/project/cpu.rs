//! The CPU twin of `project`: both passes, generic over the float, parallel over chunks of Gaussians.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::simd::{GaussiansSimd, ProjectCameraSimd, ProjectionTermsSimd};
use super::{COLUMNS, Ellipse, Geometry, ProjectSpec, WIDTHS};
use crate::simd::lanes::{BLOCK, Columns};
use crate::simd::real::{LANES, Real};

/// Number of Gaussians per task. Sums over all Gaussians add one partial sum per chunk in order, so the number of threads never
/// changes a result.
const CHUNK: usize = 1024;

/// The parameters of up to [`BLOCK`] Gaussians, column by column.
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
        for axis in 0..3 {
            self.means.store(axis, first, eight.mean[axis]);
            self.scales.store(axis, first, eight.scale[axis]);
        }
        for axis in 0..4 {
            self.rotations.store(axis, first, eight.rotation[axis]);
        }
        self.opacities.store(0, first, eight.opacity);
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

/// `[N, 7]` packed ellipses.
pub(crate) fn project_cpu<F: Real>(inputs: Geometry<&[F]>, spec: &ProjectSpec) -> Vec<F> {
    let lens = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let mut packed = vec![F::ZERO; inputs.opacities.len() * COLUMNS];
    packed.par_chunks_mut(CHUNK * COLUMNS).enumerate().for_each(|(chunk, rows)| {
        let first = chunk * CHUNK;
        match lens.bends() {
            true => dispatch!(Level::new(), simd => project_chunk::<_, F, true>(simd, &inputs, &lens, first, rows)),
            false => dispatch!(Level::new(), simd => project_chunk::<_, F, false>(simd, &inputs, &lens, first, rows)),
        }
    });
    packed
}

#[inline(always)]
fn project_chunk<S: Simd, F: Real, const BENDS: bool>(
    simd: S,
    inputs: &Geometry<&[F]>,
    lens: &ProjectCameraSimd<F>,
    first: usize,
    rows: &mut [F],
) {
    let lens = lens.lanes(simd);
    let (mut parameters, mut ellipses) = (Parameters::new(), Columns::<F, COLUMNS>::new());
    for (block, rows) in rows.chunks_mut(BLOCK * COLUMNS).enumerate() {
        parameters.read(inputs, first + block * BLOCK);
        for at in (0..rows.len() / COLUMNS).step_by(LANES) {
            let eight = parameters.eight(simd, at);
            let ellipse = ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, &eight, &lens).ellipse(&lens, &eight);
            for (column, value) in ellipse.to_row().into_iter().enumerate() {
                ellipses.store(column, at, value);
            }
        }
        ellipses.write(rows);
    }
}

/// Gradients of zero for `count` Gaussians; those not needed, and that of the pose, are empty.
pub(crate) fn zero_grads<F: Real>(count: usize, needs: Geometry<bool>) -> Geometry<Vec<F>> {
    needs.zip(WIDTHS).map(|(needed, width)| vec![F::ZERO; if needed { count * width } else { 0 }])
}

/// Gradients of the inputs from `grad`, the `[N, 7]` gradient of the packed ellipses.
pub(crate) fn project_backward_cpu<F: Real>(
    inputs: Geometry<&[F]>,
    grad: &[F],
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Vec<F>> {
    let lens = ProjectCameraSimd::new(inputs.cam_from_world, spec);
    let count = inputs.opacities.len();
    let mut grads = zero_grads(count, needs);
    let mut rows = grads.each_mut().zip(WIDTHS).map(|(rows, width)| rows.chunks_mut((CHUNK * width).max(1)));
    let chunks = (0..count.div_ceil(CHUNK)).map(|_| rows.each_mut().map(|rows| rows.next().unwrap_or_default()));
    let chunks: Vec<Geometry<&mut [F]>> = chunks.collect();
    let pose: Vec<[F; 12]> = chunks
        .into_par_iter()
        .enumerate()
        .map(|(chunk, mut out)| {
            let first = chunk * CHUNK;
            let grad = &grad[first * COLUMNS..count.min(first + CHUNK) * COLUMNS];
            let (part, pose) = ((first, grad), needs.cam_from_world);
            match lens.bends() {
                true => dispatch!(Level::new(), simd => {
                    backward_chunk::<_, F, true>(simd, &inputs, &lens, part, pose, &mut out)
                }),
                false => dispatch!(Level::new(), simd => {
                    backward_chunk::<_, F, false>(simd, &inputs, &lens, part, pose, &mut out)
                }),
            }
        })
        .collect();
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
    (first, count): (usize, usize),
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

/// Computes the gradients of the Gaussians from `first` on from those of their ellipses. Returns their share of the pose's gradient
/// if it is needed.
#[inline(always)]
fn backward_chunk<S: Simd, F: Real, const BENDS: bool>(
    simd: S,
    inputs: &Geometry<&[F]>,
    lens: &ProjectCameraSimd<F>,
    (first, grad): (usize, &[F]),
    needs_pose: bool,
    out: &mut Geometry<&mut [F]>,
) -> [F; 12] {
    let lens = lens.lanes(simd);
    let mut pose = [F::Lanes::<S>::splat(simd, F::ZERO); 12];
    let (mut parameters, mut found) = (Parameters::new(), Parameters::new());
    let (mut grads, mut mean2d) = (Columns::<F, COLUMNS>::new(), Columns::new());
    for (block, grad) in grad.chunks(BLOCK * COLUMNS).enumerate() {
        // Most Gaussians of a large scene are out of view and have a gradient of exactly zero.
        if grad.iter().all(|value| *value == F::ZERO) {
            continue;
        }
        let count = grad.len() / COLUMNS;
        // Values of a previous, longer block must not enter the pose's sum.
        if count < BLOCK {
            grads = Columns::new();
        }
        grads.read(grad);
        parameters.read(inputs, first + block * BLOCK);
        for at in (0..count).step_by(LANES) {
            let eight = parameters.eight(simd, at);
            let row = grads.all_lanes(simd, at);
            let projection = ProjectionTermsSimd::<S, F>::new::<BENDS>(simd, &eight, &lens);
            let one =
                projection.backward::<BENDS>(&lens, &eight, &Ellipse::from_row(&row), needs_pose.then_some(&mut pose));
            found.store::<S>(at, &one.parameters);
            for (axis, value) in one.mean2d.into_iter().enumerate() {
                mean2d.store(axis, at, value);
            }
        }
        write(out, &found, &mean2d, (block * BLOCK, count));
    }
    let mut sums = [F::ZERO; 12];
    for (sum, lanes) in sums.iter_mut().zip(pose) {
        *sum = lanes.reduce_sum();
    }
    sums
}
