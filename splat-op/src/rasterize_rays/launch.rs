//! Launches of `rasterize_rays`.

use std::ops::Range;

use cubecl::prelude::CubeDim;

use super::RayLayers;
use super::backward::{rasterize_rays_sums_kernel, rasterize_rays_walk_kernel, row_len};
use super::forward::rasterize_rays_forward_kernel;
use super::layer::{RayFrameLaunch, RayInputsLaunch};
use crate::camera::{Intrinsics, PictureRays};
use crate::depth_slope;
use crate::gpu::reduce::launch_sums;
use crate::gpu::{Buffer, Gpu, cubes, elementwise, split};
use crate::intersect::TILE_PIXELS;
use crate::intersect::launch::DeviceIntersections;
use crate::limits::Need;
use crate::options::{Order, Projection};
use crate::rasterize::launch::{frame, launch_gather};
use crate::rasterize::layer::KernelShape;
use crate::rasterize::rows::Rows;
use crate::rasterize::{Layers, RasterizeSpec};

/// Number of places in the table of layers and pixels, unless one tile has more: 64 MiB.
pub(crate) const TABLE: usize = 32_768;

/// Hint for a render whose backward pass needs too much memory.
const FEWER_INTERSECTIONS: &str = "train on smaller pictures, raise `alpha_min`, or use fewer Gaussians";

impl RayLayers<Buffer<f32>> {
    fn arg(&self, lists: &DeviceIntersections, rays: &Option<Buffer<f32>>) -> RayInputsLaunch {
        let [projected, depth_slope, features, background, _] = self.each_ref().into_array().map(Buffer::arg);
        let rays = rays.as_ref().map(Buffer::arg).into();
        RayInputsLaunch::new(projected, depth_slope, features, background, rays, lists.arg())
    }
}

/// Uploads the slopes of the rays of a camera with a lens, `[H, W, 2]`.
fn rays(gpu: &Gpu, camera: &Intrinsics) -> Option<Buffer<f32>> {
    let rays = PictureRays::of(camera)?;
    let slopes: Vec<f32> = rays.slopes.as_flattened().iter().map(|slope| *slope as f32).collect();
    Some(Buffer::from_slice(gpu, &slopes))
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
    let rays = rays(gpu, &spec.intrinsics);
    let planes = Buffer::new(gpu, spec.planes(shape.features) * spec.intrinsics.width * spec.intrinsics.height);
    // SAFETY: places, intersections and Gaussians come from the lists, whose entries are in range; pixels are guarded.
    unsafe {
        rasterize_rays_forward_kernel::launch_unchecked(
            &gpu.client,
            cubes(tiles),
            CubeDim::new_1d(TILE_PIXELS as u32),
            inputs.arg(lists, &rays),
            planes.arg(),
            Buffer::<u32>::new(gpu, 1).arg(),
            view(spec, shape, (0, tiles)),
        );
    }
    planes
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
    let rays = rays(gpu, &spec.intrinsics);
    let starts = lists.tile_start.read(gpu);
    let start = |tile: usize| starts[tile] as usize;
    let runs = split(lists.counts.len, room.min(gpu.buffer_limit as usize / (8 * TILE_PIXELS)), start);
    let places = |run: &Range<usize>| start(run.end) - start(run.start);
    let table_len = runs.iter().map(places).max().unwrap_or(0) * 2 * TILE_PIXELS;
    Need { what: "the layers of a tile's pixels", bytes: 4 * table_len as u64, hint: FEWER_INTERSECTIONS }
        .assert_fits(gpu.buffer_limit);
    let table: Buffer<u32> = Buffer::with_headroom(gpu, table_len);
    let columns = row_len(shape, needs.mean2d_abs);
    let left: Buffer<f32> = Buffer::new(gpu, pixels);
    let of_intersections = needs.projected || needs.depth_slope || needs.features || needs.mean2d_abs;
    let rows = match of_intersections {
        true => Rows::of_intersections(gpu, lists, columns),
        false => Vec::new(),
    };
    for run in runs {
        let view = || view(spec, shape, (run.start, run.end));
        // SAFETY: as in the forward pass; the table holds all places of a run.
        unsafe {
            rasterize_rays_walk_kernel::launch_unchecked(
                &gpu.client,
                cubes(run.len()),
                CubeDim::new_1d(TILE_PIXELS as u32),
                inputs.arg(lists, &rays),
                grad.arg(),
                table.arg(),
                left.arg(),
                view(),
            );
        }
        for part in rows.iter().filter(|_| places(&run) > 0) {
            let (grid, dim) = elementwise(places(&run));
            // SAFETY: as above; rows are guarded.
            unsafe {
                rasterize_rays_sums_kernel::launch_unchecked(
                    &gpu.client,
                    grid,
                    dim,
                    inputs.arg(lists, &rays),
                    grad.arg(),
                    table.arg(),
                    part.sums.arg(),
                    part.intersections.start as u32,
                    part.intersections.end as u32,
                    view(),
                    needs.mean2d_abs,
                );
            }
        }
    }
    let background = needs.background.then(|| launch_sums(gpu, grad, Some(&left), [pixels, shape.features]));
    if !of_intersections {
        return RayLayers { background, ..RayLayers::default() };
    }
    let RayLayers { projected, depth_slope, features, mean2d_abs, .. } = needs;
    let needed = Layers { projected, features, background: false, mean2d_abs };
    let ray_columns = match spec.options.projection {
        Projection::RayMax => depth_slope::columns(&spec.intrinsics),
        Projection::Affine => 0,
    };
    let (grads, of_rays) =
        launch_gather(gpu, &inputs.projected, lists, (&rows, columns, true), shape, (needed, ray_columns));
    let Layers { projected, features, mean2d_abs, .. } = grads;
    // With the affine projection the row decides nothing but the order.
    let of_rays = of_rays.or_else(|| depth_slope.then(|| Buffer::zeros(gpu, inputs.depth_slope.len)));
    RayLayers { projected, depth_slope: of_rays.filter(|_| depth_slope), features, background, mean2d_abs }
}
