//! Launches of `rasterize_rays`.

use cubecl::prelude::CubeDim;

use super::RayLayers;
use super::backward::{rasterize_rays_sums_kernel, rasterize_rays_walk_kernel, row_len};
use super::forward::rasterize_rays_forward_kernel;
use super::layer::{RayFrameLaunch, RayInputsLaunch};
use crate::counters::count_idle_wait;
use crate::depth_slope::DEPTH_SLOPE;
use crate::gpu::reduce::launch_sums;
use crate::gpu::{Buffer, Gpu, cubes, elementwise};
use crate::intersect::TILE_PIXELS;
use crate::intersect::launch::DeviceIntersections;
use crate::limits::Need;
use crate::options::{Order, Projection};
use crate::rasterize::launch::{frame, launch_gather};
use crate::rasterize::layer::KernelShape;
use crate::rasterize::{Layers, RasterizeSpec};

/// Number of places in the table of layers and pixels, unless one tile has more: 64 MiB.
pub(crate) const TABLE: usize = 32_768;

/// Hint for a render whose backward pass needs too much memory.
const FEWER_INTERSECTIONS: &str = "train on smaller pictures, raise `alpha_min`, or use fewer Gaussians";

impl RayLayers<Buffer<f32>> {
    fn arg(&self, lists: &DeviceIntersections) -> RayInputsLaunch {
        let [projected, depth_slope, features, background, _] = self.each_ref().into_array().map(Buffer::arg);
        RayInputsLaunch::new(projected, depth_slope, features, background, lists.arg())
    }
}

/// The view as a kernel argument, for the tiles `first..end`.
fn view(spec: &RasterizeSpec, shape: KernelShape, (first, end): (usize, usize)) -> RayFrameLaunch {
    let (ray_max, per_pixel) = (Projection::RayMax, Order::PerPixelSort);
    let (exact, per_pixel) = (spec.options.projection == ray_max, spec.options.order == per_pixel);
    RayFrameLaunch::new(frame(spec), first as u32, end as u32, exact, per_pixel, shape)
}

/// Launches the forward pass and returns the planes `[C + 1 (+ 1), H, W]`.
pub(crate) fn launch_rasterize_rays(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
) -> Buffer<f32> {
    let (shape, tiles) = (KernelShape::of(inputs.background.len, &spec.options), lists.counts.len);
    let planes = Buffer::new(gpu, spec.planes(shape.features) * spec.intrinsics.width * spec.intrinsics.height);
    // SAFETY: places, intersections and Gaussians come from the lists, whose entries are in range; pixels are guarded.
    unsafe {
        rasterize_rays_forward_kernel::launch_unchecked(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d(TILE_PIXELS as u32),
            inputs.arg(lists),
            planes.arg(),
            view(spec, shape, (0, tiles)),
        );
    }
    planes
}

/// Splits the tiles into runs `first..end` of whole tiles. The lists of a run have at most `room` places together, unless the run
/// is a single tile. Also returns the number of places of the longest run.
fn runs(counts: &[i32], room: usize) -> (Vec<(usize, usize)>, usize) {
    let (mut runs, mut longest, mut first, mut places) = (Vec::new(), 0, 0, 0);
    for (tile, &count) in counts.iter().enumerate() {
        if places + count as usize > room && places > 0 {
            runs.push((first, tile));
            (first, places) = (tile, 0);
        }
        places += count as usize;
        longest = longest.max(places);
    }
    runs.push((first, counts.len()));
    (runs, longest)
}

/// Returns the gradients of the inputs from `grad`, the gradient of the planes, with a table of at most `room` places. Waits for
/// the device once, to read the lengths of the lists.
pub(crate) fn launch_rasterize_rays_backward(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    grad: &Buffer<f32>,
    (lists, room): (&DeviceIntersections, usize),
    spec: &RasterizeSpec,
    needs: RayLayers<bool>,
) -> RayLayers<Option<Buffer<f32>>> {
    let (shape, pixels) =
        (KernelShape::of(inputs.background.len, &spec.options), spec.intrinsics.width * spec.intrinsics.height);
    count_idle_wait();
    let read = gpu.client.read_one(lists.counts.handle.clone()).unwrap_or_else(|error| panic!("{error}"));
    let counts: Vec<i32> = bytemuck::pod_collect_to_vec(&read[..4 * lists.counts.len]);
    let (runs, longest) = runs(&counts, room.min(gpu.buffer_limit as usize / (8 * TILE_PIXELS)));
    let columns = row_len(shape, needs.mean2d_abs);
    let fits = |what, len: usize| {
        Need { what, bytes: 4 * len as u64, hint: FEWER_INTERSECTIONS }.assert_fits(gpu.buffer_limit)
    };
    fits("the layers of a tile's pixels", longest * 2 * TILE_PIXELS);
    fits("the rows of gradients", lists.intersections * columns);
    let table: Buffer<u32> = Buffer::with_headroom(gpu, longest * 2 * TILE_PIXELS);
    let rows: Buffer<f32> = Buffer::with_headroom(gpu, lists.intersections * columns);
    let left: Buffer<f32> = Buffer::new(gpu, pixels);
    let of_intersections = needs.projected || needs.depth_slope || needs.features || needs.mean2d_abs;
    for &(first, end) in &runs {
        let places = counts[first..end].iter().sum::<i32>() as usize;
        // SAFETY: as in the forward pass; the table holds all places of a run, and `rows` all intersections.
        unsafe {
            rasterize_rays_walk_kernel::launch_unchecked(
                &gpu.client,
                cubes(end - first),
                CubeDim::new_1d(TILE_PIXELS as u32),
                inputs.arg(lists),
                grad.arg(),
                table.arg(),
                left.arg(),
                view(spec, shape, (first, end)),
            );
        }
        if places == 0 || !of_intersections {
            continue;
        }
        let (grid, dim) = elementwise(places);
        // SAFETY: as above.
        unsafe {
            rasterize_rays_sums_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.arg(lists),
                grad.arg(),
                table.arg(),
                rows.arg(),
                view(spec, shape, (first, end)),
                needs.mean2d_abs,
            );
        }
    }
    let background = needs.background.then(|| launch_sums(gpu, grad, Some(&left), [pixels, shape.features]));
    if !of_intersections {
        return RayLayers { background, ..RayLayers::default() };
    }
    let RayLayers { projected, depth_slope, features, mean2d_abs, .. } = needs;
    let needs = Layers { projected, features, background: false, mean2d_abs };
    let slopes = if depth_slope { DEPTH_SLOPE } else { 0 };
    let (grads, depth_slope) =
        launch_gather(gpu, &inputs.projected, lists, (&rows, columns, true), shape, (needs, slopes));
    let Layers { projected, features, mean2d_abs, .. } = grads;
    RayLayers { projected, depth_slope, features, background, mean2d_abs }
}

#[cfg(test)]
mod tests {
    use super::runs;

    #[test]
    fn runs_hold_whole_tiles() {
        assert_eq!(runs(&[3, 4, 0, 9, 1, 1], 7), (vec![(0, 3), (3, 4), (4, 6)], 9));
        assert_eq!(runs(&[0, 0], 7), (vec![(0, 2)], 0));
        assert_eq!(runs(&[20, 20], 7), (vec![(0, 1), (1, 2)], 20));
    }
}
