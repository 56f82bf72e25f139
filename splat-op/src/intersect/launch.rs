//! Launches of `intersect`, and the lists that they leave on the device.

use super::forward::{COVER, TileListsLaunch, count_kernel, cover_kernel, emit_kernel, ranges_kernel};
use super::scan::launch_scan;
use super::sort::{Pairs, launch_sort};
use super::{Cut, tile_grid};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::limits::Need;

/// Lists of one view on the device. Intersections are numbered Gaussian by Gaussian in depth order; a place is the
/// position of an intersection after the sort by tile.
#[derive(Clone, Debug)]
pub(crate) struct DeviceIntersections {
    /// `[tiles]`: number of intersections of each tile.
    pub counts: Buffer<i32>,
    /// `[tiles + 1]`: each tile's first place; tiles run along x, then y.
    pub tile_start: Buffer<u32>,
    /// `[H]`: the intersection of each place.
    pub intersection_of_place: Buffer<u32>,
    /// `[H]`: the Gaussian of each intersection.
    pub gaussian_of_intersection: Buffer<u32>,
    /// `[N]`: Gaussians by depth, then by index; those without intersections last.
    pub order: Buffer<u32>,
    /// `[N]`: the first intersection of each Gaussian of `order`.
    pub first_intersection: Buffer<u32>,
    /// Number of Gaussians that have intersections.
    pub visible: usize,
    /// Number of intersections.
    pub intersections: usize,
}

/// Hint in error messages: how to get fewer intersections.
const FEWER_INTERSECTIONS: &str =
    "raise `alpha_min`, render a smaller picture, or use fewer Gaussians that cover most of it (smaller `scales`)";

impl DeviceIntersections {
    /// Returns the lists by tile as a kernel argument.
    pub fn arg(&self) -> TileListsLaunch {
        let places = self.intersection_of_place.arg();
        TileListsLaunch::new(self.tile_start.arg(), places, self.gaussian_of_intersection.arg())
    }
}

/// Lists the intersections of `projected`, `[count, 7]`, and counts them by tile. Waits for the device once, to learn
/// the number of intersections.
pub(crate) fn launch_intersect(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    camera: &Intrinsics,
    cut: Cut,
) -> DeviceIntersections {
    let count = projected.len / crate::project::COLUMNS;
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    let tiles = tiles_x * tiles_y;
    let covers: Buffer<u32> = Buffer::new(gpu, count * COVER);
    let pairs = Pairs { keys: Buffer::new(gpu, count), values: Buffer::new(gpu, count) };
    let (grid, dim) = elementwise(count);
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        cover_kernel::launch_unchecked(
            &gpu.client,
            grid.clone(),
            dim,
            projected.arg(),
            covers.arg(),
            pairs.keys.arg(),
            pairs.values.arg(),
            camera.width as u32,
            camera.height as u32,
            cut.alpha_min as f32,
            count as u32,
            cut.culling,
        );
    }
    let by_depth = launch_sort(gpu, pairs, u32::BITS);
    let first_intersection = Buffer::new(gpu, count);
    let visible = Buffer::<u32>::from_slice(gpu, &[0]);
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        count_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            by_depth.keys.arg(),
            by_depth.values.arg(),
            covers.arg(),
            first_intersection.arg(),
            visible.arg(),
            count as u32,
        );
    }
    let intersections = launch_scan(gpu, &first_intersection);
    let read = gpu.client.read(vec![visible.handle.clone(), intersections.handle.clone()]);
    let read = read.unwrap_or_else(|error| panic!("{error}"));
    let [visible, intersections] = [0, 1].map(|i| bytemuck::pod_read_unaligned::<u32>(&read[i][..4]) as usize);
    // The sum saturates at the largest u32, which then is not their number.
    assert!(
        intersections < u32::MAX as usize,
        "2^32 or more intersections of {visible} Gaussians in {tiles} tiles: {FEWER_INTERSECTIONS}"
    );
    let list = Need { what: "the list of intersections", bytes: 4 * intersections as u64, hint: FEWER_INTERSECTIONS };
    list.assert_fits(gpu.buffer_limit);

    let by_tile =
        Pairs { keys: Buffer::with_headroom(gpu, intersections), values: Buffer::with_headroom(gpu, intersections) };
    let gaussian_of_intersection = Buffer::with_headroom(gpu, intersections);
    let (grid, dim) = elementwise(visible);
    // SAFETY: the scan that sized the lists gives each Gaussian the places that the same covers count.
    unsafe {
        emit_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            by_depth.values.arg(),
            covers.arg(),
            first_intersection.arg(),
            by_tile.keys.arg(),
            gaussian_of_intersection.arg(),
            by_tile.values.arg(),
            visible as u32,
            tiles_x as u32,
        );
    }
    let by_tile = launch_sort(gpu, by_tile, usize::BITS - (tiles - 1).leading_zeros());
    let (tile_start, counts) = (Buffer::new(gpu, tiles + 1), Buffer::new(gpu, tiles));
    let (grid, dim) = elementwise(tiles + 1);
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        ranges_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            by_tile.keys.arg(),
            tile_start.arg(),
            counts.arg(),
            intersections as u32,
            tiles as u32,
        );
    }
    DeviceIntersections {
        counts,
        tile_start,
        intersection_of_place: by_tile.values,
        gaussian_of_intersection,
        order: by_depth.values,
        first_intersection,
        visible,
        intersections,
    }
}
