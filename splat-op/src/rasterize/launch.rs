//! Launches of `rasterize`.

use cubecl::prelude::*;

use super::backward::{rasterize_gather_kernel, rasterize_suffix_kernel, row_len};
use super::backward_few_channels::rasterize_backward_few_channels_kernel;
use super::backward_many_channels::rasterize_backward_many_channels_kernel;
use super::forward::rasterize_forward_kernel;
use super::layer::{BUCKET, KernelShape, LimitsLaunch};
use super::{Layers, RasterizeSpec};
use crate::dials::Exponential;
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
use crate::intersect::launch::{DeviceIntersections, frame};
use crate::intersect::{TILE_PIXELS, tile_grid};
use crate::limits::Need;
use crate::options::Accumulation;
use crate::project::COLUMNS;

/// Number of units of a cube in the kernel for many channels, and of pixels in its blocks. Two arrays of 32 numbers per
/// unit leave room for no more in 32 KiB of shared memory.
const CHANNEL_UNITS: usize = 64;

impl Layers<Buffer<f32>> {
    fn shape(&self, spec: &RasterizeSpec) -> KernelShape {
        KernelShape {
            features: self.background.len,
            depth: spec.options.depth,
            grad_alpha: true,
            polynomial: spec.options.exponential == Exponential::Polynomial,
        }
    }

    fn count(&self) -> usize {
        self.projected.len / COLUMNS
    }
}

/// Values that the forward pass keeps for the backward pass.
#[derive(Clone, Debug)]
pub(crate) struct DeviceTrace {
    /// `[max_buckets, kept, 256]`: values per bucket and pixel; see [`KernelShape::kept`].
    kept: Buffer<f32>,
    /// `[tiles, 256]`: the transmittance behind all layers.
    final_transmittance: Buffer<f32>,
    /// `[tiles]`: number of buckets passed before every pixel was finished.
    bucket_count: Buffer<u32>,
}

/// Number of pixels of a unit in the forward kernel for few channels; see `forward.rs`. For many channels it is one.
const FORWARD_STRIP: usize = 4;

/// Number of pixels of a unit in the backward kernel for few channels; see `backward_few_channels.rs`.
const STRIP: usize = 8;

/// Number of slots for the buckets of all tiles; see `first_bucket`.
fn max_buckets(lists: &DeviceIntersections, tiles: usize) -> usize {
    lists.intersections / BUCKET + tiles
}

fn limits(spec: &RasterizeSpec) -> LimitsLaunch {
    let least = spec.options.transmittance_min;
    // A threshold of zero leaves out nothing, not even layers behind an alpha of one.
    LimitsLaunch::new(spec.options.alpha_max as f32, if least > 0.0 { least as f32 } else { -1.0 })
}

/// Hint in error messages: how to make a render keep less for its backward pass.
const FEWER_BUCKETS: &str =
    "train on smaller pictures, raise `alpha_min`, or render parts of the picture with several cameras";

/// Panics if the device cannot hold a buffer of `len` floats. Only the intersections determine the length.
fn assert_fits(gpu: &Gpu, what: &'static str, len: usize) {
    Need { what, bytes: 4 * len as u64, hint: FEWER_BUCKETS }.assert_fits(gpu.buffer_limit);
}

/// Runs the forward pass. Returns the planes `[C + 1 (+ 1), H, W]`, and the trace if `keep` is set.
pub(crate) fn launch_rasterize(
    gpu: &Gpu,
    inputs: &Layers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
    keep: bool,
) -> (Buffer<f32>, Option<DeviceTrace>) {
    let camera = &spec.intrinsics;
    let shape = inputs.shape(spec);
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    let tiles = tiles_x * tiles_y;
    let planes = Buffer::new(gpu, spec.planes(shape.features) * camera.width * camera.height);
    let kept_len = |len: usize| if keep { len } else { 0 };
    let kept = kept_len(max_buckets(lists, tiles) * shape.kept() * TILE_PIXELS);
    assert_fits(gpu, "the trace of the backward pass", kept);
    let trace = DeviceTrace {
        kept: Buffer::with_headroom(gpu, kept),
        final_transmittance: Buffer::new(gpu, kept_len(tiles * TILE_PIXELS)),
        bucket_count: Buffer::new(gpu, kept_len(tiles)),
    };
    let pixels = if shape.few() { FORWARD_STRIP } else { 1 };
    // SAFETY: places, intersections and Gaussians come from the lists, which hold none out of range; pixels are guarded.
    unsafe {
        rasterize_forward_kernel::launch_unchecked(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d((TILE_PIXELS / pixels) as u32),
            inputs.projected.arg(),
            inputs.features.arg(),
            inputs.background.arg(),
            lists.tile_start.arg(),
            lists.intersection_of_place.arg(),
            lists.gaussian_of_intersection.arg(),
            planes.arg(),
            trace.kept.arg(),
            trace.final_transmittance.arg(),
            trace.bucket_count.arg(),
            frame(camera, spec.options.alpha_min),
            limits(spec),
            shape,
            keep,
            pixels,
        );
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
    let shape = inputs.shape(spec);
    let alone = grad.len == shape.features * camera.width * camera.height;
    debug_assert!(!(alone && shape.depth), "where depth is rendered, the gradient has all planes");
    let shape = KernelShape { grad_alpha: !alone, ..shape };
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    let tiles = tiles_x * tiles_y;
    let max_buckets = max_buckets(lists, tiles);
    let suffix_rho: Buffer<f32> = Buffer::with_headroom(gpu, max_buckets * TILE_PIXELS);
    let background = Buffer::new(gpu, if needs.background { tiles * shape.features } else { 0 });
    // SAFETY: as in the forward pass; slots are those that the forward pass wrote.
    unsafe {
        rasterize_suffix_kernel::launch_unchecked(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d(UNITS as u32),
            inputs.projected.arg(),
            inputs.features.arg(),
            inputs.background.arg(),
            grad.arg(),
            lists.tile_start.arg(),
            lists.intersection_of_place.arg(),
            lists.gaussian_of_intersection.arg(),
            trace.kept.arg(),
            trace.final_transmittance.arg(),
            trace.bucket_count.arg(),
            suffix_rho.arg(),
            background.arg(),
            frame(camera, spec.options.alpha_min),
            limits(spec),
            shape,
            needs.background,
            gpu.planes,
        );
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
            assert_fits(gpu, "the rows of ordered gradients", lists.intersections * columns);
            Buffer::with_headroom(gpu, lists.intersections * columns)
        }
        false => Buffer::zeros(gpu, inputs.count() * columns),
    };
    let unused: Buffer<f32> = Buffer::new(gpu, 0);
    let (written, added) = if ordered { (&rows, &unused) } else { (&unused, &rows) };
    macro_rules! launch {
        ($kernel:path, $units:expr, $own:expr) => {
            // SAFETY: as in the forward pass; a row belongs to an intersection or a Gaussian of the lists.
            unsafe {
                $kernel(
                    &gpu.client,
                    cubes(max_buckets),
                    CubeDim::new_1d($units as u32),
                    inputs.projected.arg(),
                    inputs.features.arg(),
                    grad.arg(),
                    lists.tile_start.arg(),
                    lists.intersection_of_place.arg(),
                    lists.gaussian_of_intersection.arg(),
                    trace.kept.arg(),
                    trace.bucket_count.arg(),
                    suffix_rho.arg(),
                    written.arg(),
                    added.arg(),
                    frame(camera, spec.options.alpha_min),
                    limits(spec),
                    max_buckets as u32,
                    shape,
                    needs.mean2d_abs,
                    !ordered,
                    $own,
                )
            }
        };
    }
    let few = TILE_PIXELS / STRIP;
    match (shape.few(), gpu.float_atomics) {
        (true, true) => launch!(rasterize_backward_few_channels_kernel::launch_unchecked::<Atomic<f32>>, few, STRIP),
        (true, false) => launch!(rasterize_backward_few_channels_kernel::launch_unchecked::<Atomic<u32>>, few, STRIP),
        (false, true) => {
            launch!(
                rasterize_backward_many_channels_kernel::launch_unchecked::<Atomic<f32>>,
                CHANNEL_UNITS,
                CHANNEL_UNITS
            )
        }
        (false, false) => {
            launch!(
                rasterize_backward_many_channels_kernel::launch_unchecked::<Atomic<u32>>,
                CHANNEL_UNITS,
                CHANNEL_UNITS
            )
        }
    }
    let zeros = |needed: bool, columns: usize| Buffer::zeros(gpu, if needed { inputs.count() * columns } else { 0 });
    let projected = zeros(needs.projected, COLUMNS);
    let features = zeros(needs.features, shape.features);
    let absolute = zeros(needs.mean2d_abs, 2);
    let (grid, dim) = elementwise(lists.visible);
    // SAFETY: ranks stay below the number of visible Gaussians; intersections below theirs.
    unsafe {
        rasterize_gather_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            inputs.projected.arg(),
            lists.order.arg(),
            lists.first_intersection.arg(),
            rows.arg(),
            projected.arg(),
            features.arg(),
            absolute.arg(),
            lists.visible as u32,
            lists.intersections as u32,
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
