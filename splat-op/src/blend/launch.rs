//! Launches of `blend`.

use cubecl::prelude::*;

use super::backward::{blend_behind_kernel, blend_gather_kernel, row_len};
use super::buckets::blend_buckets_kernel;
use super::channels::blend_channels_kernel;
use super::forward::blend_forward_kernel;
use super::half::launch_halve;
use super::layer::{BUCKET, Block, LimitsLaunch, Shape};
use super::order::{launch_order, launch_tile_order};
use super::quads::TILE_QUADS;
use super::quads_behind::blend_behind_quads_kernel;
use super::quads_forward::blend_forward_quads_kernel;
use super::strips::blend_strips_kernel;
use super::{BlendSpec, Layers};
use crate::dials::{Exponential, Storage};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
use crate::limits::Need;
use crate::options::Accumulation;
use crate::project::COLUMNS;
use crate::tile::launch::{DeviceLists, frame};
use crate::tile::{TILE_PIXELS, tile_grid};

/// Units of a cube of the kernel for many channels, and pixels of its blocks: what two arrays of 32 numbers per unit leave of 32 KiB
/// of shared memory.
const CHANNEL_UNITS: usize = 64;

/// Units of a cube of the kernel for drivers in software.
const BUCKET_UNITS: usize = 8;

impl Layers<Buffer<f32>> {
    fn shape(&self, gpu: &Gpu, spec: &BlendSpec) -> Shape {
        let shape = Shape {
            features: self.background.len,
            depth: spec.options.depth,
            bucket: BUCKET,
            grad_alpha: true,
            polynomial: spec.options.exponential == Exponential::Polynomial,
            half: spec.options.features == Storage::Half,
        };
        // The longer, the less there is to keep; the shorter, the fewer places are missing in the last ones.
        Shape { bucket: if by_quads(gpu, shape) { 4 * BUCKET } else { BUCKET }, ..shape }
    }

    pub(super) fn count(&self) -> usize {
        self.projected.len / COLUMNS
    }

    /// The features as the kernels of this shape read them.
    fn stored(&self, gpu: &Gpu, shape: Shape) -> Buffer<f32> {
        if shape.half { launch_halve(gpu, self) } else { self.features.clone() }
    }
}

/// What the forward pass keeps for the backward pass.
#[derive(Clone, Debug)]
pub(crate) struct DeviceTrace {
    /// `[slots, kept, 256]`: numbers per bucket and pixel, see [`Shape::kept`].
    kept: Buffer<f32>,
    /// `[tiles, 256]`: the transmittance behind all layers.
    behind: Buffer<f32>,
    /// `[tiles]`: buckets passed before every pixel was finished.
    passed: Buffer<u32>,
}

/// The pixels of a unit; see `forward.rs`.
fn forward_block(shape: Shape) -> Block {
    Block { across: 1, down: if shape.few() { 4 } else { 1 } }
}

/// What the kernel of layers goes through at once on a card; see `strips.rs`.
const STRIP: Block = Block { across: 1, down: 8 };

/// Channels of a picture whose pixels a driver in software takes four at a time; see `quads.rs`. No other number: for each one such
/// a driver compiles kernels of its own, half a minute long.
const QUAD_CHANNELS: usize = 3;

fn by_quads(gpu: &Gpu, shape: Shape) -> bool {
    gpu.software && shape.channels() == QUAD_CHANNELS
}

/// Slots of all tiles' buckets; see `first_slot`.
pub(super) fn slots(lists: &DeviceLists, tiles: usize, shape: Shape) -> usize {
    lists.hits / shape.bucket + tiles
}

fn limits(spec: &BlendSpec) -> LimitsLaunch {
    let least = spec.options.transmittance_min;
    // A threshold of zero leaves out nothing, not even what is behind an alpha of one.
    LimitsLaunch::new(spec.options.alpha_max as f32, if least > 0.0 { least as f32 } else { -1.0 })
}

/// What makes a render keep less for its backward pass.
const FEWER_BUCKETS: &str =
    "train on smaller pictures, raise `alpha_min`, or render parts of the picture with several cameras";

/// Refuses a buffer of `len` floats that the device cannot hold. How long it is, only the hits tell.
fn assert_fits(gpu: &Gpu, what: &'static str, len: usize) {
    Need { what, bytes: 4 * len as u64, hint: FEWER_BUCKETS }.assert_fits(gpu.buffer_limit);
}

/// Planes `[C + 1 (+ 1), H, W]`, and the trace if it is to be kept.
pub(crate) fn launch_blend(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceLists,
    spec: &BlendSpec,
    keep: bool,
) -> (Buffer<f32>, Option<DeviceTrace>) {
    let camera = &spec.intrinsics;
    let shape = inputs.shape(gpu, spec);
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    let tiles = tiles_x * tiles_y;
    let features = inputs.stored(gpu, shape);
    let planes = Buffer::new(gpu, spec.planes(shape.features) * camera.width * camera.height);
    let kept_len = |len: usize| if keep { len } else { 0 };
    let kept = kept_len(slots(lists, tiles, shape) * shape.kept() * TILE_PIXELS);
    assert_fits(gpu, "the trace of the backward pass", kept);
    let trace = DeviceTrace {
        kept: Buffer::with_headroom(gpu, kept),
        behind: Buffer::new(gpu, kept_len(tiles * TILE_PIXELS)),
        passed: Buffer::new(gpu, kept_len(tiles)),
    };
    macro_rules! launch {
        ($kernel:path, $cubes:expr, $units:expr $(, order: $order:expr)? $(, own: $of_kernel:expr)?) => {
            // SAFETY: places, hits and Gaussians come from the lists, which hold none out of range; pixels are guarded.
            unsafe {
                $kernel(
                    &gpu.client,
                    cubes($cubes),
                    CubeDim::new_1d($units as u32),
                    inputs.projected.arg(),
                    features.arg(),
                    inputs.background.arg(),
                    lists.tile_start.arg(),
                    lists.hit_of_place.arg(),
                    lists.gaussian_of_hit.arg(),
                    $($order.arg(),)?
                    planes.arg(),
                    trace.kept.arg(),
                    trace.behind.arg(),
                    trace.passed.arg(),
                    frame(camera, spec.options.alpha_min),
                    limits(spec),
                    shape,
                    keep,
                    $($of_kernel,)?
                )
            }
        };
    }
    match by_quads(gpu, shape) {
        true => {
            let (cubes, order) = (tiles.div_ceil(BUCKET_UNITS), launch_tile_order(gpu, lists, tiles));
            launch!(blend_forward_quads_kernel::launch_unchecked, cubes, BUCKET_UNITS, order: order)
        }
        false => {
            let block = forward_block(shape);
            launch!(blend_forward_kernel::launch_unchecked, tiles, block.of_tile(), own: block)
        }
    }
    (planes, keep.then_some(trace))
}

/// Gradients of the inputs from `grad`, that of the planes; of the features alone where nothing else has one.
pub(crate) fn launch_blend_backward(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    grad: &Buffer<f32>,
    lists: &DeviceLists,
    trace: &DeviceTrace,
    spec: &BlendSpec,
    needs: Layers<bool>,
) -> Layers<Option<Buffer<f32>>> {
    let camera = &spec.intrinsics;
    let shape = inputs.shape(gpu, spec);
    let alone = grad.len == shape.features * camera.width * camera.height;
    debug_assert!(!(alone && shape.depth), "where depth is rendered, the gradient has all planes");
    let shape = Shape { grad_alpha: !alone, ..shape };
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    let tiles = tiles_x * tiles_y;
    let slots = slots(lists, tiles, shape);
    let stored = inputs.stored(gpu, shape);
    let rho_behind: Buffer<f32> = Buffer::with_headroom(gpu, slots * TILE_PIXELS);
    let background = Buffer::new(gpu, if needs.background { tiles * shape.features } else { 0 });
    let by_quads = by_quads(gpu, shape);
    let by_tile: Buffer<f32> = Buffer::new(gpu, if by_quads { tiles * shape.gradients() * TILE_PIXELS } else { 0 });
    // SAFETY: as in the forward pass; slots are those that the forward pass wrote.
    unsafe {
        if by_quads {
            blend_behind_quads_kernel::launch_unchecked(
                &gpu.client,
                cubes(tiles),
                CubeDim::new_1d(TILE_QUADS as u32),
                inputs.background.arg(),
                grad.arg(),
                lists.tile_start.arg(),
                trace.kept.arg(),
                trace.behind.arg(),
                trace.passed.arg(),
                rho_behind.arg(),
                by_tile.arg(),
                background.arg(),
                frame(camera, spec.options.alpha_min),
                shape,
                needs.background,
            );
        } else {
            blend_behind_kernel::launch_unchecked(
                &gpu.client,
                cubes(tiles),
                CubeDim::new_1d(UNITS as u32),
                inputs.projected.arg(),
                stored.arg(),
                inputs.background.arg(),
                grad.arg(),
                lists.tile_start.arg(),
                lists.hit_of_place.arg(),
                lists.gaussian_of_hit.arg(),
                trace.kept.arg(),
                trace.behind.arg(),
                trace.passed.arg(),
                rho_behind.arg(),
                background.arg(),
                frame(camera, spec.options.alpha_min),
                limits(spec),
                shape,
                needs.background,
                gpu.planes,
            );
        }
    }
    let mut grads = Layers {
        background: needs.background.then(|| launch_column_sums(gpu, &background, shape.features)),
        ..Layers::default()
    };
    if !(needs.projected || needs.features || needs.mean2d_abs) {
        return grads;
    }

    let columns = row_len(shape, needs.mean2d_abs);
    let ordered = spec.options.accumulation == Accumulation::Ordered;
    let rows = match ordered {
        true => {
            assert_fits(gpu, "the rows of ordered gradients", lists.hits * columns);
            Buffer::with_headroom(gpu, lists.hits * columns)
        }
        false => Buffer::zeros(gpu, inputs.count() * columns),
    };
    let unused: Buffer<f32> = Buffer::new(gpu, 0);
    let (written, added) = if ordered { (&rows, &unused) } else { (&unused, &rows) };
    macro_rules! launch {
        ($kernel:path, $dealt:expr, $grad:expr $(, order: $order:expr)? $(, own: $own:expr)?) => {{
            let (count, units) = $dealt;
            // SAFETY: as in the forward pass; a row belongs to a hit or a Gaussian of the lists.
            unsafe {
                $kernel(
                    &gpu.client,
                    cubes(count),
                    CubeDim::new_1d(units as u32),
                    inputs.projected.arg(),
                    stored.arg(),
                    $grad.arg(),
                    lists.tile_start.arg(),
                    lists.hit_of_place.arg(),
                    lists.gaussian_of_hit.arg(),
                    trace.kept.arg(),
                    trace.passed.arg(),
                    rho_behind.arg(),
                    $($order.arg(),)?
                    written.arg(),
                    added.arg(),
                    frame(camera, spec.options.alpha_min),
                    limits(spec),
                    slots as u32,
                    shape,
                    needs.mean2d_abs,
                    !ordered,
                    $($own,)?
                )
            }
        }};
    }
    let order = || launch_order(gpu, lists, tiles, shape);
    // Cubes, and units of each.
    let strips = (slots, STRIP.of_tile());
    let buckets = (slots.div_ceil(BUCKET_UNITS), BUCKET_UNITS);
    let many = (slots, CHANNEL_UNITS);
    match (shape.few(), by_quads, gpu.float_atomics) {
        (true, false, true) => launch!(blend_strips_kernel::launch_unchecked::<Atomic<f32>>, strips, grad, own: STRIP),
        (true, false, false) => launch!(blend_strips_kernel::launch_unchecked::<Atomic<u32>>, strips, grad, own: STRIP),
        (true, true, true) => {
            launch!(blend_buckets_kernel::launch_unchecked::<Atomic<f32>>, buckets, by_tile, order: order())
        }
        (true, true, false) => {
            launch!(blend_buckets_kernel::launch_unchecked::<Atomic<u32>>, buckets, by_tile, order: order())
        }
        (false, _, true) => {
            launch!(blend_channels_kernel::launch_unchecked::<Atomic<f32>>, many, grad, own: CHANNEL_UNITS)
        }
        (false, _, false) => {
            launch!(blend_channels_kernel::launch_unchecked::<Atomic<u32>>, many, grad, own: CHANNEL_UNITS)
        }
    }
    let zeros = |needed: bool, columns: usize| Buffer::zeros(gpu, if needed { inputs.count() * columns } else { 0 });
    let projected = zeros(needs.projected, COLUMNS);
    let features = zeros(needs.features, shape.features);
    let absolute = zeros(needs.mean2d_abs, 2);
    let (grid, dim) = elementwise(lists.visible);
    // SAFETY: ranks stay below the number of visible Gaussians; hits below theirs.
    unsafe {
        blend_gather_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            inputs.projected.arg(),
            lists.order.arg(),
            lists.first_hit.arg(),
            rows.arg(),
            projected.arg(),
            features.arg(),
            absolute.arg(),
            lists.visible as u32,
            lists.hits as u32,
            shape,
            needs.mean2d_abs,
            ordered,
            (needs.projected, needs.features),
        );
    }
    grads.projected = needs.projected.then_some(projected);
    grads.features = needs.features.then_some(features);
    grads.mean2d_abs = needs.mean2d_abs.then_some(absolute);
    grads
}
