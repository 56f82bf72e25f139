//! Launches of `rasterize`.

use cubecl::prelude::*;

use super::backward::{rasterize_gather_kernel, rasterize_suffix_kernel, row_len};
use super::backward_few_channels::{FEW_UNITS, rasterize_backward_few_channels_kernel};
use super::backward_many_channels::{MANY_UNITS, rasterize_backward_many_channels_kernel};
use super::forward::rasterize_forward_kernel;
use super::layer::{BUCKET, KernelShape, RasterFrameLaunch};
use super::{Layers, RasterizeSpec};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
use crate::intersect::launch::DeviceIntersections;
use crate::intersect::{TILE_PIXELS, tile_grid};
use crate::limits::Need;
use crate::options::Accumulation;
use crate::project::COLUMNS;

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

/// Number of slots for the buckets of all tiles; see `first_bucket`.
fn max_buckets(lists: &DeviceIntersections) -> usize {
    lists.intersections / BUCKET + lists.counts.len
}

/// Returns the picture and the thresholds as a kernel argument.
pub(crate) fn frame(spec: &RasterizeSpec) -> RasterFrameLaunch {
    let (camera, options) = (&spec.intrinsics, &spec.options);
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height).map(|tiles| tiles as u32);
    let (width, height) = (camera.width as u32, camera.height as u32);
    // A threshold of zero leaves out nothing, not even layers behind an alpha of one.
    let least = if options.transmittance_min > 0.0 { options.transmittance_min as f32 } else { -1.0 };
    RasterFrameLaunch::new(width, height, tiles_x, tiles_y, options.alpha_min as f32, options.alpha_max as f32, least)
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
    let (shape, tiles) = (KernelShape::of(inputs.background.len, &spec.options), lists.counts.len);
    let planes = Buffer::new(gpu, spec.planes(shape.features) * spec.intrinsics.width * spec.intrinsics.height);
    let kept_len = |len: usize| if keep { len } else { 0 };
    let kept = kept_len(max_buckets(lists) * shape.kept() * TILE_PIXELS);
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
            lists.arg(),
            planes.arg(),
            trace.kept.arg(),
            trace.final_transmittance.arg(),
            trace.bucket_count.arg(),
            frame(spec),
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
    let shape = KernelShape::of(inputs.background.len, &spec.options);
    let alone = grad.len == shape.features * camera.width * camera.height;
    debug_assert!(!(alone && shape.depth), "where depth is rendered, the gradient has all planes");
    let shape = KernelShape { grad_alpha: !alone, ..shape };
    let (tiles, max_buckets) = (lists.counts.len, max_buckets(lists));
    let suffix_rho: Buffer<f32> = Buffer::with_headroom(gpu, max_buckets * TILE_PIXELS);
    let background = Buffer::if_needed(gpu, needs.background, tiles * shape.features);
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
            lists.arg(),
            trace.kept.arg(),
            trace.final_transmittance.arg(),
            trace.bucket_count.arg(),
            suffix_rho.arg(),
            background.as_ref().map(Buffer::arg).into(),
            frame(spec),
            shape,
            gpu.planes,
        );
    }
    let background = background.map(|rows| launch_column_sums(gpu, &rows, shape.features));
    if !(needs.projected || needs.features || needs.mean2d_abs) {
        return Layers { background, ..Layers::default() };
    }

    let columns = row_len(shape, needs.mean2d_abs);
    let ordered = spec.options.accumulation == Accumulation::Ordered;
    let rows = match ordered {
        true => {
            assert_fits(gpu, "the rows of ordered gradients", lists.intersections * columns);
            Buffer::with_headroom(gpu, lists.intersections * columns)
        }
        false => Buffer::zeros(gpu, inputs.projected.len / COLUMNS * columns),
    };
    let unused: Buffer<f32> = Buffer::new(gpu, 0);
    let (written, added) = if ordered { (&rows, &unused) } else { (&unused, &rows) };
    macro_rules! launch {
        ($kernel:path, $units:expr) => {
            // SAFETY: as in the forward pass; a row belongs to an intersection or a Gaussian of the lists.
            unsafe {
                $kernel(
                    &gpu.client,
                    cubes(max_buckets),
                    CubeDim::new_1d($units as u32),
                    inputs.projected.arg(),
                    inputs.features.arg(),
                    grad.arg(),
                    lists.arg(),
                    trace.kept.arg(),
                    trace.bucket_count.arg(),
                    suffix_rho.arg(),
                    written.arg(),
                    added.arg(),
                    frame(spec),
                    max_buckets as u32,
                    shape,
                    needs.mean2d_abs,
                    !ordered,
                )
            }
        };
    }
    match (shape.few(), gpu.float_atomics) {
        (true, true) => launch!(rasterize_backward_few_channels_kernel::launch_unchecked::<Atomic<f32>>, FEW_UNITS),
        (true, false) => launch!(rasterize_backward_few_channels_kernel::launch_unchecked::<Atomic<u32>>, FEW_UNITS),
        (false, true) => launch!(rasterize_backward_many_channels_kernel::launch_unchecked::<Atomic<f32>>, MANY_UNITS),
        (false, false) => launch!(rasterize_backward_many_channels_kernel::launch_unchecked::<Atomic<u32>>, MANY_UNITS),
    }
    let (found, _) = launch_gather(gpu, &inputs.projected, lists, (&rows, columns, ordered), shape, (needs, 0));
    Layers { background, ..found }
}

/// Turns rows of `columns` sums, one per intersection if `ordered` is set, else one per Gaussian, into the gradients of
/// the inputs but the background, and of depth slopes of `slopes` numbers, zero for none.
pub(crate) fn launch_gather(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    lists: &DeviceIntersections,
    (rows, columns, ordered): (&Buffer<f32>, usize, bool),
    shape: KernelShape,
    (needs, slopes): (Layers<bool>, usize),
) -> (Layers<Option<Buffer<f32>>>, Option<Buffer<f32>>) {
    let len = |needed: bool, columns: usize| needed.then_some(projected.len / COLUMNS * columns);
    let lens = [
        len(needs.projected, COLUMNS),
        len(needs.features, shape.features),
        len(needs.mean2d_abs, 2),
        len(slopes > 0, slopes),
    ];
    let [of_projected, features, mean2d_abs, grad_depth_slopes] = Buffer::zeros_of(gpu, lens);
    let grads = Layers { projected: of_projected, features, background: None, mean2d_abs };
    let output = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(Buffer::arg).into();
    let (grid, dim) = elementwise(lists.visible);
    // SAFETY: ranks stay below the number of visible Gaussians; intersections below theirs.
    unsafe {
        rasterize_gather_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            projected.arg(),
            lists.order.arg(),
            lists.first_intersection.arg(),
            rows.arg(),
            output(&grads.projected),
            output(&grads.features),
            output(&grads.mean2d_abs),
            output(&grad_depth_slopes),
            lists.visible as u32,
            lists.intersections as u32,
            shape,
            columns,
            slopes,
            ordered,
        );
    }
    (grads, grad_depth_slopes)
}
