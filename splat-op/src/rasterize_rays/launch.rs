//! Launches of `rasterize_rays`.

use std::ops::Range;

use cubecl::prelude::CubeDim;

use super::RayLayers;
use super::backward::{BUCKET, BucketsLaunch, rasterize_rays_checkpoints_kernel, rasterize_rays_rows_kernel, slots};
use super::forward::rasterize_rays_forward_kernel;
use super::layer::{RayFrameLaunch, RayInputsLaunch};
use super::pair_sums::row_len;
use crate::camera::{Intrinsics, PictureRays};
use crate::gpu::reduce::launch_sums;
use crate::gpu::{Buffer, Gpu, cubes, split};
use crate::intersect::TILE_PIXELS;
use crate::intersect::launch::DeviceIntersections;
use crate::limits::Need;
use crate::rasterize::blocks::BLOCKS;
use crate::rasterize::launch::{frame, launch_gather};
use crate::rasterize::layer::KernelShape;
use crate::rasterize::rows::Rows;
use crate::rasterize::{Layers, RasterizeSpec};
use crate::ray_space;

/// Number of buckets of a launch of the backward pass, unless one tile has more: 64 MiB.
pub(crate) const ROOM: usize = 32_768;

/// Hint for a render whose backward pass needs too much memory.
const FEWER_INTERSECTIONS: &str = "train on smaller pictures, raise `alpha_min`, or use fewer Gaussians";

impl RayLayers<Buffer<f32>> {
    fn arg(&self, lists: &DeviceIntersections, rays: &Option<Buffer<f32>>) -> RayInputsLaunch {
        let [projected, ray_space, features, background, _] = self.each_ref().into_array().map(Buffer::arg);
        let rays = rays.as_ref().map(Buffer::arg).into();
        RayInputsLaunch::new(projected, ray_space, features, background, rays, lists.arg())
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
    RayFrameLaunch::new(frame(spec), first as u32, end as u32, shape)
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
            view(spec, shape, (0, tiles)),
        );
    }
    planes
}

/// What the launches of the backward pass share.
struct LayersTask<'a> {
    gpu: &'a Gpu,
    inputs: &'a RayLayers<Buffer<f32>>,
    rays: &'a Option<Buffer<f32>>,
    grad: &'a Buffer<f32>,
    lists: &'a DeviceIntersections,
    spec: &'a RasterizeSpec,
    shape: KernelShape,
    /// `[H W]`: the transmittances behind all layers, which the launches write.
    left: &'a Buffer<f32>,
    rows: &'a [Rows],
    absolute: bool,
    /// `[tiles + 1]`: the first place of each tile.
    starts: Vec<u32>,
}

impl LayersTask<'_> {
    fn places(&self, tiles: &Range<usize>) -> [usize; 2] {
        [tiles.start, tiles.end].map(|tile| self.starts[tile] as usize)
    }

    /// Runs of tiles with at most `room` places each, unless one tile has more.
    fn runs(&self, room: usize) -> Vec<Range<usize>> {
        split(self.lists.counts.len, room, |tile| self.starts[tile] as usize)
    }

    fn view(&self, tiles: &Range<usize>) -> RayFrameLaunch {
        view(self.spec, self.shape, (tiles.start, tiles.end))
    }

    fn assert_fits(&self, what: &'static str, values: usize) {
        Need { what, bytes: 4 * values as u64, hint: FEWER_INTERSECTIONS }.assert_fits(self.gpu.buffer_limit);
    }

    fn launch(&self, room: usize) {
        let gpu = self.gpu;
        let runs = self.runs(BUCKET * room.min(gpu.buffer_limit as usize / (8 * TILE_PIXELS)));
        let slots = |run: &Range<usize>| slots([run.start, run.end], self.places(run));
        let most = runs.iter().map(slots).max().unwrap_or(0);
        self.assert_fits("the transmittances of a tile's pixels", most * TILE_PIXELS);
        let [transmittance, rho] = [(); 2].map(|()| Buffer::<f32>::with_headroom(gpu, most * TILE_PIXELS));
        let words: Buffer<u32> = Buffer::with_headroom(gpu, most * BLOCKS);
        let buckets = || BucketsLaunch::new(transmittance.arg(), rho.arg(), words.arg());
        for run in runs {
            // SAFETY: as in the forward pass; the buckets of a run have slots.
            unsafe {
                rasterize_rays_checkpoints_kernel::launch_unchecked(
                    &gpu.client,
                    cubes(run.len()),
                    CubeDim::new_1d(TILE_PIXELS as u32),
                    self.inputs.arg(self.lists, self.rays),
                    self.grad.arg(),
                    buckets(),
                    self.left.arg(),
                    self.view(&run),
                );
            }
            for part in self.rows {
                // SAFETY: as above; rows are guarded.
                unsafe {
                    rasterize_rays_rows_kernel::launch_unchecked(
                        &gpu.client,
                        cubes(slots(&run)),
                        CubeDim::new_1d(BUCKET as u32),
                        self.inputs.arg(self.lists, self.rays),
                        self.grad.arg(),
                        buckets(),
                        part.sums.arg(),
                        slots(&run) as u32,
                        part.intersections.start as u32,
                        part.intersections.end as u32,
                        self.view(&run),
                        self.absolute,
                    );
                }
            }
        }
    }
}

/// Returns the gradients of the inputs from `grad`, the gradient of the planes, with memory for `room` buckets at a time. Waits for the device once, to read the lengths of the lists.
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
    let rays = &rays(gpu, &spec.intrinsics);
    let starts = lists.tile_start.read(gpu);
    let columns = row_len(shape, needs.mean2d_abs);
    let left = &Buffer::new(gpu, pixels);
    let of_intersections = needs.projected || needs.ray_space || needs.features || needs.mean2d_abs;
    let rows = match of_intersections {
        true => Rows::of_intersections(gpu, lists, columns),
        false => Vec::new(),
    };
    let absolute = needs.mean2d_abs;
    let task = LayersTask { gpu, inputs, rays, grad, lists, spec, shape, left, rows: &rows, absolute, starts };
    task.launch(room);
    let background = needs.background.then(|| launch_sums(gpu, grad, Some(left), [pixels, shape.features]));
    if !of_intersections {
        return RayLayers { background, ..RayLayers::default() };
    }
    let RayLayers { projected, ray_space, features, mean2d_abs, .. } = needs;
    let needed = Layers { projected, features, background: false, mean2d_abs };
    let ray_columns = ray_space::columns(&spec.intrinsics);
    let (grads, of_rays) =
        launch_gather(gpu, &inputs.projected, lists, (&rows, columns, true), shape, (needed, ray_columns));
    let Layers { projected, features, mean2d_abs, .. } = grads;
    RayLayers { projected, ray_space: of_rays.filter(|_| ray_space), features, background, mean2d_abs }
}
