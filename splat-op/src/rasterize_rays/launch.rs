//! Launches of `rasterize_rays`.

use cubecl::prelude::CubeDim;

use super::RayLayers;
use super::backward::{
    rasterize_rays_background_kernel, rasterize_rays_gather_kernel, rasterize_rays_sums_kernel,
    rasterize_rays_walk_kernel, row_len,
};
use super::forward::rasterize_rays_forward_kernel;
use super::layer::RayFrameLaunch;
use crate::depth_slope::DEPTH_SLOPE;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
use crate::intersect::launch::DeviceIntersections;
use crate::intersect::{TILE_PIXELS, tile_grid};
use crate::limits::Need;
use crate::options::{Order, Projection};
use crate::project::COLUMNS;
use crate::rasterize::RasterizeSpec;

/// Number of places in the table of layers and pixels, unless one tile has more: 64 MiB.
const TABLE: usize = 32_768;

/// Hint for a render whose backward pass needs too much memory.
const FEWER_INTERSECTIONS: &str = "train on smaller pictures, raise `alpha_min`, or use fewer Gaussians";

/// The view as a kernel argument, for the tiles `first..end`.
fn view(spec: &RasterizeSpec, features: usize, (first, end): (usize, usize)) -> RayFrameLaunch {
    let (camera, options) = (&spec.intrinsics, &spec.options);
    let least = options.transmittance_min;
    RayFrameLaunch::new(
        camera.width as u32,
        camera.height as u32,
        tile_grid(camera.width, camera.height)[0] as u32,
        first as u32,
        end as u32,
        features as u32,
        options.alpha_min as f32,
        options.alpha_max as f32,
        // A threshold of zero omits nothing, not even layers behind an alpha of one.
        if least > 0.0 { least as f32 } else { -1.0 },
        options.projection == Projection::RayMax,
        options.order == Order::PerPixelSort,
        options.depth,
    )
}

fn tiles(spec: &RasterizeSpec) -> usize {
    tile_grid(spec.intrinsics.width, spec.intrinsics.height).iter().product()
}

/// Launches the forward pass and returns the planes `[C + 1 (+ 1), H, W]`.
pub(crate) fn launch_rasterize_rays(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
) -> Buffer<f32> {
    let features = inputs.background.len;
    let planes = Buffer::new(gpu, spec.planes(features) * spec.intrinsics.width * spec.intrinsics.height);
    let tiles = tiles(spec);
    // SAFETY: places, intersections and Gaussians come from the lists, whose entries are in range; pixels are guarded.
    unsafe {
        rasterize_rays_forward_kernel::launch_unchecked(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d(TILE_PIXELS as u32),
            inputs.projected.arg(),
            inputs.depth_slope.arg(),
            inputs.features.arg(),
            inputs.background.arg(),
            lists.tile_start.arg(),
            lists.intersection_of_place.arg(),
            lists.gaussian_of_intersection.arg(),
            planes.arg(),
            view(spec, features, (0, tiles)),
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

/// Returns the gradients of the inputs from `grad`, the gradient of the planes. Waits for the device once, to read the lengths of
/// the lists.
pub(crate) fn launch_rasterize_rays_backward(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    grad: &Buffer<f32>,
    lists: &DeviceIntersections,
    spec: &RasterizeSpec,
    needs: RayLayers<bool>,
) -> RayLayers<Option<Buffer<f32>>> {
    launch_rasterize_rays_backward_by(gpu, inputs, grad, (lists, TABLE), spec, needs)
}

/// [`launch_rasterize_rays_backward`] with a table of at most `room` places.
pub(super) fn launch_rasterize_rays_backward_by(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    grad: &Buffer<f32>,
    (lists, room): (&DeviceIntersections, usize),
    spec: &RasterizeSpec,
    needs: RayLayers<bool>,
) -> RayLayers<Option<Buffer<f32>>> {
    let (camera, features, count) = (&spec.intrinsics, inputs.background.len, inputs.projected.len / COLUMNS);
    let pixels = camera.width * camera.height;
    let read = gpu.client.read_one(lists.counts.handle.clone()).unwrap_or_else(|error| panic!("{error}"));
    let counts: Vec<i32> = bytemuck::pod_collect_to_vec(&read[..4 * tiles(spec)]);
    let (runs, longest) = runs(&counts, room.min(gpu.buffer_limit as usize / (8 * TILE_PIXELS)));
    let columns = row_len(features, needs.mean2d_abs);
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
                inputs.projected.arg(),
                inputs.depth_slope.arg(),
                inputs.features.arg(),
                inputs.background.arg(),
                grad.arg(),
                lists.tile_start.arg(),
                lists.intersection_of_place.arg(),
                lists.gaussian_of_intersection.arg(),
                table.arg(),
                left.arg(),
                view(spec, features, (first, end)),
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
                inputs.projected.arg(),
                inputs.depth_slope.arg(),
                grad.arg(),
                lists.tile_start.arg(),
                lists.intersection_of_place.arg(),
                lists.gaussian_of_intersection.arg(),
                table.arg(),
                rows.arg(),
                view(spec, features, (first, end)),
                needs.mean2d_abs,
            );
        }
    }
    let mut grads = RayLayers::default();
    if needs.background {
        let sums = Buffer::new(gpu, features);
        // SAFETY: every access is guarded by the lengths given.
        unsafe {
            rasterize_rays_background_kernel::launch_unchecked(
                &gpu.client,
                cubes(features),
                CubeDim::new_1d(UNITS as u32),
                grad.arg(),
                left.arg(),
                sums.arg(),
                pixels as u32,
                features as u32,
                gpu.planes,
            );
        }
        grads.background = Some(sums);
    }
    if !of_intersections {
        return grads;
    }
    let zeros = |needed: bool, columns: usize| Buffer::zeros(gpu, if needed { count * columns } else { 0 });
    let projected = zeros(needs.projected, COLUMNS);
    let depth_slope = zeros(needs.depth_slope, DEPTH_SLOPE);
    let feature_rows = zeros(needs.features, features);
    let absolute = zeros(needs.mean2d_abs, 2);
    let (grid, dim) = elementwise(lists.visible);
    // SAFETY: ranks stay below the number of visible Gaussians, and intersections below the number of intersections.
    unsafe {
        rasterize_rays_gather_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            inputs.projected.arg(),
            lists.order.arg(),
            lists.first_intersection.arg(),
            rows.arg(),
            projected.arg(),
            depth_slope.arg(),
            feature_rows.arg(),
            absolute.arg(),
            lists.visible as u32,
            lists.intersections as u32,
            features as u32,
            (needs.projected, needs.depth_slope, needs.features),
            needs.mean2d_abs,
        );
    }
    grads.projected = needs.projected.then_some(projected);
    grads.depth_slope = needs.depth_slope.then_some(depth_slope);
    grads.features = needs.features.then_some(feature_rows);
    grads.mean2d_abs = needs.mean2d_abs.then_some(absolute);
    grads
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
