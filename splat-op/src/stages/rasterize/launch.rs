//! Launches of `rasterize`.

use cubecl::prelude::*;

use super::backward::{rasterize_backward_kernel, row_len};
use super::backward_block::SEGMENT_UNITS;
use super::backward_groups::{PLANES, rasterize_backward_groups_kernel};
use super::ellipse::LayerEllipse;
use super::forward::rasterize_forward_kernel;
use super::gather::rasterize_gather_kernel;
use super::groups::Sharing;
use super::layer::{KernelShape, RasterFrameLaunch, SplatInputsLaunch};
use super::rows::Rows;
use super::segment::{KeptTraceLaunch, SegmentRangeLaunch};
use super::splat::Splat;
use super::suffix::rasterize_suffix_kernel;
use super::trace::{DeviceTrace, TraceRun, runs_of};
use super::{Layers, RasterizeSpec};
use crate::camera::PictureRays;
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, PART_BYTES, SHARED_BYTES, UNITS, cubes, given, launch_unchecked};
use crate::intersect::launch::DeviceIntersections;
use crate::intersect::{TILE_PIXELS, tile_grid};
use crate::options::Accumulation;
use crate::project::COLUMNS;
use crate::rasterize_rays::layer::RayGaussian;
use crate::ray_space;

/// Natural logarithm below that of the least positive f32, half of which rounds to zero.
const LOG_SMALLEST: f32 = -104.0;

/// Returns the picture and the thresholds as a kernel argument.
pub(super) fn frame(spec: &RasterizeSpec) -> RasterFrameLaunch {
    let (camera, options) = (&spec.intrinsics, &spec.options);
    let [tiles_x, _] = tile_grid(camera.width, camera.height);
    let [width, height, tiles_x] = [camera.width, camera.height, tiles_x].map(|size| size as u32);
    // A threshold of zero leaves out nothing, not even layers behind an alpha of one.
    let least = if options.transmittance_min > 0.0 { options.transmittance_min as f32 } else { -1.0 };
    let alpha_min = options.alpha_min as f32;
    let log_least = if alpha_min >= f32::MIN_POSITIVE { alpha_min.ln() } else { LOG_SMALLEST };
    RasterFrameLaunch::new(width, height, tiles_x, alpha_min, options.alpha_max as f32, least, log_least)
}

/// The Gaussians of a view on the device.
pub(super) struct DeviceSplats<'a> {
    inputs: &'a Layers<Buffer<f32>>,
    lists: &'a DeviceIntersections,
    /// Whether they are seen along rays, and the slopes of the rays of a camera with a lens, `[H, W, 2]`.
    along_rays: bool,
    slopes: Option<Buffer<f32>>,
}

impl<'a> DeviceSplats<'a> {
    pub fn new(
        gpu: &Gpu,
        inputs: &'a Layers<Buffer<f32>>,
        lists: &'a DeviceIntersections,
        spec: &RasterizeSpec,
    ) -> Self {
        let along_rays = spec.options.along_rays();
        let rays = if along_rays { PictureRays::of(&spec.intrinsics) } else { None };
        let slopes = rays.map(|rays| rays.on(gpu));
        Self { inputs, lists, along_rays, slopes }
    }

    pub fn arg(&self) -> SplatInputsLaunch {
        let Layers { projected, features, ray_space, .. } = self.inputs;
        let ray_space = self.along_rays.then(|| ray_space.arg());
        let slopes = self.slopes.as_ref().map(Buffer::arg);
        SplatInputsLaunch::new(projected.arg(), features.arg(), ray_space.into(), slopes.into(), self.lists.arg())
    }
}

/// Number of values of an intersection's row of sums.
pub(crate) fn columns_of(shape: KernelShape, spec: &RasterizeSpec, absolute: bool) -> usize {
    if spec.options.along_rays() {
        row_len::<RayGaussian>(shape, absolute)
    } else {
        row_len::<LayerEllipse>(shape, absolute)
    }
}

/// Planes of a picture: `[C, H, W]`, alpha and, if it is rendered, depth. Each part begins where a device can bind a buffer, so that it is an
/// output without a copy.
pub(crate) struct DevicePlanes {
    all: Buffer<f32>,
    lens: Vec<usize>,
}

impl DevicePlanes {
    fn new(gpu: &Gpu, spec: &RasterizeSpec, features: usize) -> Self {
        let pixels = spec.intrinsics.width * spec.intrinsics.height;
        let mut lens = vec![features * pixels, pixels];
        lens.extend(spec.options.depth.then_some(pixels));
        Self { all: Buffer::new(gpu, start(&lens[..lens.len() - 1]) + pixels), lens }
    }

    /// Returns the parts.
    pub fn parts(&self) -> impl Iterator<Item = Buffer<f32>> {
        self.lens.iter().enumerate().map(|(i, len)| self.all.part(start(&self.lens[..i]), *len))
    }
}

/// Number of floats up to the part behind some.
fn start(lens: &[usize]) -> usize {
    lens.iter().map(|len| len.next_multiple_of(PART_BYTES / size_of::<f32>())).sum()
}

/// Runs the forward pass. Returns the planes, and the trace if `keep` is set.
pub(crate) fn launch_rasterize(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
    keep: bool,
) -> (DevicePlanes, Option<DeviceTrace>) {
    let (shape, tiles) = (KernelShape::of(inputs.background.len, &spec.options), lists.counts.len);
    let splats = DeviceSplats::new(gpu, inputs, lists, spec);
    let planes = DevicePlanes::new(gpu, spec, shape.features);
    let kept_tiles = if keep { tiles } else { 0 };
    let mut trace = DeviceTrace {
        runs: Vec::new(),
        final_transmittance: Buffer::new(gpu, kept_tiles * TILE_PIXELS),
        segment_count: Buffer::new(gpu, kept_tiles),
    };
    let launch = match splats.along_rays {
        true => rasterize_forward_kernel::launch_unchecked::<RayGaussian>,
        false => rasterize_forward_kernel::launch_unchecked::<LayerEllipse>,
    };
    for slots in runs_of(gpu, lists, shape, keep) {
        let run = TraceRun::new(gpu, slots, shape, keep, lists.counted);
        // SAFETY: places, intersections and Gaussians come from the lists, which hold none out of range; pixels are
        // guarded; a run has the slots of all its tiles.
        unsafe {
            launch(
                &gpu.client,
                cubes(run.slots.tiles.len()),
                CubeDim::new_1d(TILE_PIXELS as u32),
                splats.arg(),
                inputs.background.arg(),
                planes.all.arg(),
                run.kept.arg(),
                run.words.arg(),
                run.tile_of_slot.arg(),
                trace.final_transmittance.arg(),
                trace.segment_count.arg(),
                frame(spec),
                run.slots.arg(),
                start(&planes.lens[..1]) as u32,
                start(&planes.lens[..2]) as u32,
                shape,
                keep,
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
    let background = Buffer::if_needed(gpu, needs.background, lists.counts.len * shape.features);
    let rows_needed = needs.projected || needs.ray_space || needs.features || needs.mean2d_abs;
    let columns = columns_of(shape, spec, needs.mean2d_abs);
    let ordered = spec.options.accumulation == Accumulation::Ordered;
    let rows = match (rows_needed, ordered) {
        (false, _) => Vec::new(),
        (true, true) => Rows::of_intersections(gpu, lists, columns),
        (true, false) => {
            let count = inputs.projected.len / COLUMNS;
            let sums = Buffer::zeros(gpu, count * columns);
            vec![Rows { ranks: 0..count, intersections: 0..lists.intersections, sums }]
        }
    };
    let splats = DeviceSplats::new(gpu, inputs, lists, spec);
    let absolute = needs.mean2d_abs;
    let task = LayersTask { gpu, splats, grad, trace, spec, shape, alone, rows: &rows, columns, absolute, ordered };
    match spec.options.along_rays() {
        true => task.launch::<RayGaussian>(&background),
        false => task.launch::<LayerEllipse>(&background),
    }
    let background = background.map(|rows| launch_column_sums(gpu, &rows, shape.features));
    match rows_needed {
        true => Layers { background, ..launch_gather(gpu, inputs, lists, &rows, columns, spec, needs) },
        false => Layers { background, ..Layers::default() },
    }
}

/// What the launches over the layers share.
struct LayersTask<'a> {
    gpu: &'a Gpu,
    splats: DeviceSplats<'a>,
    grad: &'a Buffer<f32>,
    trace: &'a DeviceTrace,
    spec: &'a RasterizeSpec,
    shape: KernelShape,
    /// Whether the planes of the features alone have a gradient.
    alone: bool,
    rows: &'a [Rows],
    columns: usize,
    /// Whether the sums of absolute values are wanted.
    absolute: bool,
    ordered: bool,
}

impl LayersTask<'_> {
    /// Fills the rows, and each tile's share of the gradient of the background.
    fn launch<S: Splat>(&self, background: &Option<Buffer<f32>>) {
        let Self { gpu, splats, trace, shape, .. } = self;
        // Only what lies behind the segments depends on the gradient of alpha.
        let suffix_shape = KernelShape { grad_alpha: !self.alone, ..*shape };
        for run in &trace.runs {
            let suffix_rho: Buffer<f32> = Buffer::with_headroom(gpu, run.slots.slots.len() * TILE_PIXELS);
            // SAFETY: as in the forward pass; slots are those that the forward pass wrote.
            unsafe {
                rasterize_suffix_kernel::launch_unchecked::<S>(
                    &gpu.client,
                    cubes(run.slots.tiles.len()),
                    CubeDim::new_1d(TILE_PIXELS as u32),
                    splats.arg(),
                    splats.inputs.background.arg(),
                    self.grad.arg(),
                    run.kept.arg(),
                    run.words.arg(),
                    trace.final_transmittance.arg(),
                    trace.segment_count.arg(),
                    suffix_rho.arg(),
                    background.as_ref().map(Buffer::arg).into(),
                    frame(self.spec),
                    run.slots.arg(),
                    suffix_shape,
                    background.is_some(),
                );
            }
            self.rows.iter().for_each(|rows| self.launch_layers::<S>(run, &suffix_rho, rows));
        }
    }

    /// Fills those of the rows that a run has.
    fn launch_layers<S: Splat>(&self, run: &TraceRun, suffix_rho: &Buffer<f32>, rows: &Rows) {
        let Self { gpu, ref splats, trace, shape, columns, absolute, ordered, .. } = *self;
        let (slots, add) = (run.slots.slots.len(), !ordered);
        let unused: Buffer<f32> = Buffer::new(gpu, 0);
        let (written, added) = if ordered { (&rows.sums, &unused) } else { (&unused, &rows.sums) };
        // SAFETY: as above; a row belongs to an intersection or a Gaussian of the lists.
        macro_rules! launch {
            ($kernel:ident::<$($cell:ty),+>, $dim:expr, $last:expr) => {
                unsafe {
                    $kernel::launch_unchecked::<$($cell),+>(
                        &gpu.client,
                        cubes(slots),
                        CubeDim::new_1d($dim as u32),
                        splats.arg(),
                        self.grad.arg(),
                        KeptTraceLaunch::new(
                            run.kept.arg(),
                            run.words.arg(),
                            run.tile_of_slot.arg(),
                            trace.segment_count.arg(),
                            suffix_rho.arg(),
                        ),
                        written.arg(),
                        added.arg(),
                        frame(self.spec),
                        SegmentRangeLaunch::new(
                            run.slots.arg(),
                            slots as u32,
                            rows.intersections.start as u32,
                            rows.intersections.end as u32,
                        ),
                        shape,
                        absolute,
                        $last,
                    )
                }
            };
        }
        // Blocks are for every device and keep to what all of them offer.
        let fits = |sharing: &Sharing| {
            let room = if sharing.planes { gpu.shared_bytes } else { SHARED_BYTES };
            sharing.shared_bytes(shape) <= room
        };
        let planes = gpu.plane_units.filter(|units| PLANES.contains(units)).map(Sharing::of_planes).filter(fits);
        let sharing = planes.or(Some(Sharing::of_blocks(columns)).filter(fits));
        match (sharing.filter(|_| add && shape.few() && !S::ALONG_RAYS), gpu.float_atomics) {
            (Some(of), true) => launch!(rasterize_backward_groups_kernel::<Atomic<f32>>, TILE_PIXELS, of),
            (Some(of), false) => launch!(rasterize_backward_groups_kernel::<Atomic<u32>>, TILE_PIXELS, of),
            (None, true) => launch!(rasterize_backward_kernel::<S, Atomic<f32>>, SEGMENT_UNITS, add),
            (None, false) => launch!(rasterize_backward_kernel::<S, Atomic<u32>>, SEGMENT_UNITS, add),
        }
    }
}

/// Turns rows of `columns` sums, one per intersection or one per Gaussian as [`Accumulation`] says, into the gradients of
/// the inputs but the background. A launch per part of the rows.
fn launch_gather(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceIntersections,
    rows: &[Rows],
    columns: usize,
    spec: &RasterizeSpec,
    needs: Layers<bool>,
) -> Layers<Option<Buffer<f32>>> {
    let shape = KernelShape::of(inputs.background.len, &spec.options);
    let ordered = spec.options.accumulation == Accumulation::Ordered;
    let ray_columns = if spec.options.along_rays() { ray_space::columns(&spec.intrinsics) } else { 0 };
    let len = |needed: bool, columns: usize| needed.then_some(inputs.projected.len / COLUMNS * columns);
    let lens = [
        len(needs.projected, COLUMNS),
        len(needs.features, shape.features),
        len(needs.mean2d_abs, 2),
        len(needs.ray_space, ray_columns),
    ];
    // The columns of a lens have no gradient.
    let [projected, features, mean2d_abs, ray_space] = match ordered || ray_columns > 0 {
        true => Buffer::zeros_of(gpu, lens),
        false => lens.map(|len| len.map(|len| Buffer::new(gpu, len))),
    };
    let grads = Layers { projected, features, background: None, mean2d_abs, ray_space };
    let Layers { projected, features, mean2d_abs, ray_space, .. } = &grads;
    let given = given([projected, features, mean2d_abs, ray_space]);
    for Rows { ranks, intersections, sums } in rows {
        // SAFETY: ranks stay below the number of visible Gaussians; the rows hold the intersections of these ranks.
        launch_unchecked!(
            gpu.cubes(ranks.len().div_ceil(UNITS)),
            rasterize_gather_kernel(
                &inputs.projected,
                &lists.order,
                &lists.first_intersection,
                sums,
                projected,
                features,
                mean2d_abs,
                ray_space,
                ranks.start,
                ranks.end,
                intersections.start,
                intersections.end,
                shape,
                columns,
                ray_columns,
                ordered,
                given
            )
        );
    }
    grads
}
