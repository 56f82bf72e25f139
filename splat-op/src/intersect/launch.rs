//! Launches of `intersect`, and the lists that they leave on the device.

use cubecl::prelude::CubeDim;

use super::emit::{BLOCK, count_kernel, emit_kernel, number_kernel, ranges_kernel};
use super::forward::{COVER, TileListsLaunch, cover_kernel};
use super::sort::launch_sort;
use super::{Cut, tile_grid};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
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
    /// `[N]`: the `visible` Gaussians that have intersections, by depth, then by index. The rest is not written.
    pub order: Buffer<u32>,
    /// `[N]`: the first intersection of each Gaussian of `order`.
    pub first_intersection: Buffer<u32>,
    /// Number of Gaussians that have intersections.
    pub visible: usize,
    /// Number of intersections.
    pub intersections: usize,
}

/// Largest number of cubes that count intersections. Each adds up the sums of those before it.
const COUNTERS: usize = 1024;

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
    let (covers, depths) = (Buffer::<u32>::new(gpu, count * COVER), Buffer::<u32>::new(gpu, count));
    let (client, (grid, dim)) = (&gpu.client, elementwise(count));
    // SAFETY: every access is guarded by the lengths given.
    unsafe {
        cover_kernel::launch_unchecked(
            client,
            grid,
            dim,
            projected.arg(),
            covers.arg(),
            depths.arg(),
            camera.width as u32,
            camera.height as u32,
            cut.alpha_min as f32,
            count as u32,
            cut.culling,
        );
    }
    let by_depth = launch_sort(gpu, depths, u32::BITS);
    let chunks = count.div_ceil(UNITS).clamp(1, COUNTERS);
    let (first_intersection, sums) = (Buffer::<u32>::new(gpu, count), Buffer::<u32>::new(gpu, 2 * chunks));
    let dim = CubeDim::new_1d(UNITS as u32);
    // SAFETY: every access is guarded by the number of visible Gaussians.
    unsafe {
        count_kernel::launch_unchecked(
            client,
            cubes(chunks),
            dim,
            by_depth.indices.arg(),
            covers.arg(),
            by_depth.kept.arg(),
            first_intersection.arg(),
            sums.arg(),
            chunks as u32,
        );
    }
    let read = client.read(vec![by_depth.kept.handle.clone(), sums.handle.clone()]);
    let read = read.unwrap_or_else(|error| panic!("{error}"));
    let visible = bytemuck::pod_read_unaligned::<u32>(&read[0][..4]);
    let sums_read: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(&read[1][..8 * chunks]);
    let intersections: u64 = sums_read.iter().map(|&[low, high]| u64::from(low) + (u64::from(high) << 16)).sum();
    let list = Need { what: "the list of intersections", bytes: 4 * intersections, hint: FEWER_INTERSECTIONS };
    list.assert_fits(gpu.buffer_limit);
    // The limit is below 2^32 elements.
    let intersections = intersections as usize;

    let blocks = intersections.div_ceil(BLOCK);
    let rank_of_block = Buffer::<u32>::with_headroom(gpu, blocks);
    let (tile_of_intersection, gaussian_of_intersection) =
        (Buffer::with_headroom(gpu, intersections), Buffer::with_headroom(gpu, intersections));
    // SAFETY: the sums that sized the lists give each Gaussian the places that the same covers count.
    unsafe {
        let (starts, ranks) = (first_intersection.arg(), rank_of_block.arg());
        number_kernel::launch_unchecked(client, cubes(chunks), dim, starts, sums.arg(), ranks, visible, chunks as u32);
        emit_kernel::launch_unchecked(
            client,
            cubes(blocks),
            dim,
            by_depth.indices.arg(),
            covers.arg(),
            first_intersection.arg(),
            rank_of_block.arg(),
            tile_of_intersection.arg(),
            gaussian_of_intersection.arg(),
            visible,
            intersections as u32,
            blocks as u32,
            tiles_x as u32,
        );
    }
    let by_tile = launch_sort(gpu, tile_of_intersection, usize::BITS - (tiles - 1).leading_zeros());
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
        intersection_of_place: by_tile.indices,
        gaussian_of_intersection,
        order: by_depth.indices,
        first_intersection,
        visible: visible as usize,
        intersections,
    }
}
