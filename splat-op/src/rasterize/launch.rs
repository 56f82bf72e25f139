//! Launches of `rasterize`.

use cubecl::prelude::*;

use super::backward::{LANES, rasterize_backward_kernel, row_len};
use super::backward_planes::{PLANES, rasterize_backward_planes_kernel, shared_bytes};
use super::forward::{PAIR_COUNTS, rasterize_forward_kernel};
use super::gather::rasterize_gather_kernel;
use super::layer::{KernelShape, RasterFrameLaunch};
use super::rows::Rows;
use super::suffix::rasterize_suffix_kernel;
use super::trace::{DeviceTrace, TraceRun, runs_of};
use super::{Layers, RasterizeSpec};
use crate::counters::pairs_are_counted;
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, cubes, elementwise};
use crate::intersect::launch::DeviceIntersections;
use crate::intersect::{TILE_PIXELS, tile_grid};
use crate::options::Accumulation;
use crate::project::COLUMNS;

/// Natural logarithm below that of the least positive f32, half of which rounds to zero.
const LOG_SMALLEST: f32 = -104.0;

/// Returns the picture and the thresholds as a kernel argument.
pub(crate) fn frame(spec: &RasterizeSpec) -> RasterFrameLaunch {
    let (camera, options) = (&spec.intrinsics, &spec.options);
    let [tiles_x, _] = tile_grid(camera.width, camera.height);
    let [width, height, tiles_x] = [camera.width, camera.height, tiles_x].map(|size| size as u32);
    // A threshold of zero leaves out nothing, not even layers behind an alpha of one.
    let least = if options.transmittance_min > 0.0 { options.transmittance_min as f32 } else { -1.0 };
    let alpha_min = options.alpha_min as f32;
    let log_least = if alpha_min >= f32::MIN_POSITIVE { alpha_min.ln() } else { LOG_SMALLEST };
    RasterFrameLaunch::new(width, height, tiles_x, alpha_min, options.alpha_max as f32, least, log_least)
}

/// Runs the forward pass. Returns the planes `[C + 1 (+ 1), H, W]`, and the trace if `keep` is set.
pub(crate) fn launch_rasterize(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
    keep: bool,
) -> (Buffer<f32>, Option<DeviceTrace>) {
    let (shape, tiles) = (KernelShape::of(inputs.background.len, &spec.options), lists.counts.len);
    let planes = Buffer::new(gpu, spec.planes(shape.features) * spec.intrinsics.width * spec.intrinsics.height);
    let kept_tiles = if keep { tiles } else { 0 };
    let count_pairs = keep && pairs_are_counted();
    let mut trace = DeviceTrace {
        runs: Vec::new(),
        final_transmittance: Buffer::new(gpu, kept_tiles * TILE_PIXELS),
        segment_count: Buffer::new(gpu, kept_tiles),
        pairs: Buffer::if_needed(gpu, count_pairs, tiles * TILE_PIXELS * PAIR_COUNTS),
    };
    for slots in runs_of(gpu, lists, shape, keep) {
        let run = TraceRun::new(gpu, slots, shape, keep);
        // SAFETY: places, intersections and Gaussians come from the lists, which hold none out of range; pixels are
        // guarded; a run has the slots of all its tiles.
        unsafe {
            rasterize_forward_kernel::launch_unchecked(
                &gpu.client,
                cubes(run.slots.tiles.len()),
                CubeDim::new_1d(TILE_PIXELS as u32),
                inputs.projected.arg(),
                inputs.features.arg(),
                inputs.background.arg(),
                lists.arg(),
                planes.arg(),
                run.kept.arg(),
                run.words.arg(),
                run.tile_of_slot.arg(),
                trace.final_transmittance.arg(),
                trace.segment_count.arg(),
                trace.pairs.as_ref().map(Buffer::arg).into(),
                frame(spec),
                run.slots.arg(),
                shape,
                keep,
                count_pairs,
            );
        }
        trace.runs.push(run);
    }
    (planes, keep.then_some(trace))
}

/// Returns the gradients of the inputs from `grad`, the gradient of the planes; of the feature planes alone if no other
/// plane has a gradient.
pub(crate) fn launch_rasterize_backward(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    grad: &Buffer<f32>,
    lists: &DeviceIntersections,
    trace: &DeviceTrace,
    spec: &RasterizeSpec,
    needs: Layers<bool>,
) -> Layers<Option<Buffer<f32>>> {
    let camera = &spec.intrinsics;
    let shape = KernelShape::of(inputs.background.len, &spec.options);
    let alone = grad.len == shape.features * camera.width * camera.height;
    debug_assert!(!(alone && shape.depth), "where depth is rendered, the gradient has all planes");
    // Only what lies behind the segments depends on the gradient of alpha.
    let suffix_shape = KernelShape { grad_alpha: !alone, ..shape };
    let background = Buffer::if_needed(gpu, needs.background, lists.counts.len * shape.features);
    let rows_needed = needs.projected || needs.features || needs.mean2d_abs;
    let columns = row_len(shape, needs.mean2d_abs);
    let ordered = spec.options.accumulation == Accumulation::Ordered;
    let rows = match (rows_needed, ordered) {
        (false, _) => Vec::new(),
        (true, true) => Rows::of_intersections(gpu, lists, columns),
        (true, false) => {
            let count = inputs.projected.len / COLUMNS;
            vec![Rows::of_gaussians(lists, count, Buffer::zeros(gpu, count * columns))]
        }
    };
    let unused: Buffer<f32> = Buffer::new(gpu, 0);
    for run in &trace.runs {
        let slots = run.slots.slots.len();
        let suffix_rho: Buffer<f32> = Buffer::with_headroom(gpu, slots * TILE_PIXELS);
        // SAFETY: as in the forward pass; slots are those that the forward pass wrote.
        unsafe {
            rasterize_suffix_kernel::launch_unchecked(
                &gpu.client,
                cubes(run.slots.tiles.len()),
                CubeDim::new_1d(TILE_PIXELS as u32),
                inputs.projected.arg(),
                inputs.features.arg(),
                inputs.background.arg(),
                grad.arg(),
                lists.arg(),
                run.kept.arg(),
                run.words.arg(),
                trace.final_transmittance.arg(),
                trace.segment_count.arg(),
                suffix_rho.arg(),
                background.as_ref().map(Buffer::arg).into(),
                frame(spec),
                run.slots.arg(),
                suffix_shape,
            );
        }
        for Rows { intersections, sums, .. } in &rows {
            let (written, added) = if ordered { (sums, &unused) } else { (&unused, sums) };
            // SAFETY: as above; a row belongs to an intersection or a Gaussian of the lists.
            macro_rules! launch {
                ($kernel:ident, $cell:ty, $dim:expr $(, $planes:expr, $direct:expr)?) => {
                    unsafe {
                        $kernel::launch_unchecked::<$cell>(
                            &gpu.client,
                            cubes(slots),
                            CubeDim::new_1d($dim as u32),
                            inputs.projected.arg(),
                            inputs.features.arg(),
                            grad.arg(),
                            lists.arg(),
                            run.kept.arg(),
                            run.words.arg(),
                            run.tile_of_slot.arg(),
                            trace.segment_count.arg(),
                            suffix_rho.arg(),
                            written.arg(),
                            added.arg(),
                            frame(spec),
                            run.slots.arg(),
                            slots as u32,
                            intersections.start as u32,
                            intersections.end as u32,
                            shape,
                            needs.mean2d_abs,
                            !ordered,
                            $($planes, $direct)?
                        )
                    }
                };
            }
            let direct = !ordered && gpu.float_atomics;
            let fits = |units: u32| shared_bytes(shape, columns, units as usize, direct) <= gpu.shared_bytes;
            let planes = gpu.plane_units.filter(|&units| shape.few() && PLANES.contains(&units) && fits(units));
            match (planes, gpu.float_atomics) {
                (Some(units), true) => {
                    launch!(rasterize_backward_planes_kernel, Atomic<f32>, TILE_PIXELS, units, direct)
                }
                (Some(units), false) => {
                    launch!(rasterize_backward_planes_kernel, Atomic<u32>, TILE_PIXELS, units, false)
                }
                (None, true) => launch!(rasterize_backward_kernel, Atomic<f32>, LANES),
                (None, false) => launch!(rasterize_backward_kernel, Atomic<u32>, LANES),
            }
        }
    }
    let background = background.map(|rows| launch_column_sums(gpu, &rows, shape.features));
    if !rows_needed {
        return Layers { background, ..Layers::default() };
    }
    let (found, _) = launch_gather(gpu, &inputs.projected, lists, (&rows, columns, ordered), shape, (needs, 0));
    Layers { background, ..found }
}

/// Turns rows of `columns` sums, one per intersection if `ordered` is set, else one per Gaussian, into the gradients of
/// the inputs but the background. With `ray_columns` above zero the gradient of the shape goes to rows of `ray_space` with as many
/// columns. A launch per part of the rows.
pub(crate) fn launch_gather(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    lists: &DeviceIntersections,
    (rows, columns, ordered): (&[Rows], usize, bool),
    shape: KernelShape,
    (needs, ray_columns): (Layers<bool>, usize),
) -> (Layers<Option<Buffer<f32>>>, Option<Buffer<f32>>) {
    let len = |needed: bool, columns: usize| needed.then_some(projected.len / COLUMNS * columns);
    let lens = [
        len(needs.projected, COLUMNS),
        len(needs.features, shape.features),
        len(needs.mean2d_abs, 2),
        len(ray_columns > 0, ray_columns),
    ];
    let [of_projected, features, mean2d_abs, grad_rays] = match ordered || ray_columns > 0 {
        true => Buffer::zeros_of(gpu, lens),
        false => lens.map(|len| len.map(|len| Buffer::new(gpu, len))),
    };
    let grads = Layers { projected: of_projected, features, background: None, mean2d_abs };
    let output = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(Buffer::arg).into();
    for Rows { ranks, intersections, sums } in rows {
        let (grid, dim) = elementwise(ranks.len());
        // SAFETY: ranks stay below the number of visible Gaussians; the rows hold the intersections of these ranks.
        unsafe {
            rasterize_gather_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                projected.arg(),
                lists.order.arg(),
                lists.first_intersection.arg(),
                sums.arg(),
                output(&grads.projected),
                output(&grads.features),
                output(&grads.mean2d_abs),
                output(&grad_rays),
                ranks.start as u32,
                ranks.end as u32,
                intersections.start as u32,
                intersections.end as u32,
                shape,
                columns,
                ray_columns,
                ordered,
            );
        }
    }
    (grads, grad_rays)
}
