//! Launches of `tile`, and the lists they leave on the device.

use super::forward::{COVER, TileFrameLaunch, count_kernel, cover_kernel, emit_kernel, ranges_kernel};
use super::scan::launch_scan;
use super::sort::{Pairs, launch_sort};
use super::{Cut, tile_grid};
use crate::camera::Intrinsics;
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::limits::Need;

/// The lists of one view on the device. Hits are numbered Gaussian by Gaussian in depth order; a place is where a hit
/// lies once they are sorted by tile.
#[derive(Clone, Debug)]
pub(crate) struct DeviceLists {
    /// `[tiles]`: hits of each tile.
    pub counts: Buffer<i32>,
    /// `[tiles + 1]`: where each tile's places begin; tiles run along x, then y.
    pub tile_start: Buffer<u32>,
    /// `[H]`: the hit of each place.
    pub hit_of_place: Buffer<u32>,
    /// `[H]`: the Gaussian of each hit.
    pub gaussian_of_hit: Buffer<u32>,
    /// `[N]`: Gaussians by depth, then by index; those without hits last.
    pub order: Buffer<u32>,
    /// `[N]`: the first hit of each Gaussian of `order`.
    pub first_hit: Buffer<u32>,
    /// Gaussians that have hits.
    pub visible: usize,
    /// Hits.
    pub hits: usize,
}

/// What to change when there are too many hits.
const FEWER_HITS: &str =
    "raise `alpha_min`, render a smaller picture, or use fewer Gaussians that cover most of it (smaller `scales`)";

/// As an argument of a kernel.
pub(crate) fn frame(camera: &Intrinsics, alpha_min: f64) -> TileFrameLaunch {
    let [tiles_x, tiles_y] = tile_grid(camera.width, camera.height);
    TileFrameLaunch::new(camera.width as u32, camera.height as u32, tiles_x as u32, tiles_y as u32, alpha_min as f32)
}

/// Lists the hits of `projected`, `[count, 7]`, and counts them by tile. Waits for the device once, to learn how many hits
/// there are.
pub(crate) fn launch_tile(gpu: &Gpu, projected: &Buffer<f32>, camera: &Intrinsics, cut: Cut) -> DeviceLists {
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
            frame(camera, cut.alpha_min),
            count as u32,
            cut.culling,
        );
    }
    let by_depth = launch_sort(gpu, pairs, u32::BITS);
    let first_hit = Buffer::new(gpu, count);
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
            first_hit.arg(),
            visible.arg(),
            count as u32,
        );
    }
    let hits = launch_scan(gpu, &first_hit);
    let read = gpu.client.read(vec![visible.handle.clone(), hits.handle.clone()]);
    let read = read.unwrap_or_else(|error| panic!("{error}"));
    let [visible, hits] = [0, 1].map(|i| bytemuck::pod_read_unaligned::<u32>(&read[i][..4]) as usize);
    // The sum stops at the largest u32, which then no longer says how many there are.
    assert!(hits < u32::MAX as usize, "2^32 or more hits of {visible} Gaussians in {tiles} tiles: {FEWER_HITS}");
    let list = Need { what: "the list of hits", bytes: 4 * hits as u64, hint: FEWER_HITS };
    list.assert_fits(gpu.buffer_limit);

    let by_tile = Pairs { keys: Buffer::with_headroom(gpu, hits), values: Buffer::with_headroom(gpu, hits) };
    let gaussian_of_hit = Buffer::with_headroom(gpu, hits);
    let (grid, dim) = elementwise(visible);
    // SAFETY: the scan that sized the lists gives each Gaussian the places that the same covers count.
    unsafe {
        emit_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            by_depth.values.arg(),
            covers.arg(),
            first_hit.arg(),
            by_tile.keys.arg(),
            gaussian_of_hit.arg(),
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
            hits as u32,
            tiles as u32,
        );
    }
    DeviceLists {
        counts,
        tile_start,
        hit_of_place: by_tile.values,
        gaussian_of_hit,
        order: by_depth.values,
        first_hit,
        visible,
        hits,
    }
}
