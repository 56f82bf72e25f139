//! Launches of `intersect`, and the lists that they leave on the device.

use cubecl::prelude::ComptimeOptionArgs;

use super::emit::{LIST_BLOCK, count_kernel, emit_kernel, emit_masked_kernel, number_kernel, ranges_kernel};
use super::expected::{expected, remember};
use super::forward::{COVER, TileListsLaunch, TileMaskLaunch, cover_kernel};
use super::pending::{PendingView, Sizes, keep, settle};
use super::sort::{Sorted, launch_sort};
use super::{Cut, tile_grid};
use crate::camera::Intrinsics;
use crate::counters::{count_idle_waits, count_repeated_lists, forced_capacity};
use crate::gpu::{Buffer, Gpu, UNITS, launch_unchecked};
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
    /// Number of Gaussians that have intersections; if they are not counted, of all.
    pub visible: usize,
    /// Number of intersections; if they are not counted, the number that there is room for.
    pub intersections: usize,
    /// Whether the host knows both.
    pub counted: bool,
}

/// Largest number of cubes that count intersections. Each adds up the sums of those before it.
const COUNTERS: usize = 1024;

/// Numbers of intersections of a Gaussian and of a tile for which an uncounted view has room if no recent view is like it.
const UNKNOWN_OF_GAUSSIAN: usize = 8;
const UNKNOWN_OF_TILE: usize = 64;

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

/// Lists the intersections of `projected`, `[count, 7]`, and counts them by tile.
///
/// The host learns the number of intersections from the device. If recent views tell how many to expect, the lists are written with room
/// for so many while the host waits, so that the device has work. They are written once more if there are more.
pub(crate) fn launch_intersect(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    camera: &Intrinsics,
    cut: Cut<&Buffer<i32>>,
) -> DeviceIntersections {
    let (tiles, count, capacity) = expectation(projected, camera);
    let lists = launch_intersect_within(gpu, projected, camera, cut, capacity);
    remember(tiles, count, lists.intersections as u64);
    lists
}

/// Lists the first intersections of `projected`, as many as views are expected to have. The host does not wait for their number.
pub(super) fn launch_expected_intersect(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    camera: &Intrinsics,
    cut: Cut<&Buffer<i32>>,
) -> DeviceIntersections {
    let (tiles, count, capacity) = expectation(projected, camera);
    let unknown = || (UNKNOWN_OF_GAUSSIAN * count + UNKNOWN_OF_TILE * tiles[0] * tiles[1]) as u64;
    let capacity = capacity.unwrap_or_else(unknown).min(gpu.buffer_limit / 4) as usize;
    let counted = Counted::launch(gpu, projected, camera, cut);
    let sizes = counted.ask(gpu);
    let lists = counted.lists(gpu, Room::new(gpu, capacity));
    gpu.begin();
    keep(PendingView { sizes, tiles, gaussians: count, capacity });
    lists
}

/// Returns the tiles of a view along x and y, its number of Gaussians, and the number of intersections to expect, if it is known.
fn expectation(projected: &Buffer<f32>, camera: &Intrinsics) -> ([usize; 2], usize, Option<u64>) {
    settle();
    let (tiles, count) = (tile_grid(camera.width, camera.height), projected.len / crate::project::COLUMNS);
    let capacity = forced_capacity().or_else(|| expected(tiles, count)).filter(|capacity| *capacity > 0);
    (tiles, count, capacity)
}

/// [`launch_intersect`] with room for `capacity` intersections at first.
pub(super) fn launch_intersect_within(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    camera: &Intrinsics,
    cut: Cut<&Buffer<i32>>,
    capacity: Option<u64>,
) -> DeviceIntersections {
    let counted = Counted::launch(gpu, projected, camera, cut);
    let sizes = counted.ask(gpu);
    let capacity = capacity.map(|capacity| capacity.min(gpu.buffer_limit / 4) as usize);
    let early = capacity.map(|capacity| counted.lists(gpu, Room::new(gpu, capacity)));
    match early {
        Some(_) => gpu.begin(),
        None => count_idle_waits(1),
    }
    let (visible, intersections) = sizes.wait();
    let list = Need { what: "the list of intersections", bytes: 4 * intersections, hint: FEWER_INTERSECTIONS };
    list.assert_fits(gpu.buffer_limit);
    // The limit is below 2^32 elements.
    let intersections = intersections as usize;
    let lists = early.filter(|lists| intersections <= lists.intersections).unwrap_or_else(|| {
        if capacity.is_some() {
            count_repeated_lists(1);
        }
        counted.lists(gpu, Room::new(gpu, intersections))
    });
    let listed = |list: Buffer<u32>| Buffer::from_handle(list.handle, intersections);
    DeviceIntersections {
        intersection_of_place: listed(lists.intersection_of_place),
        gaussian_of_intersection: listed(lists.gaussian_of_intersection),
        visible,
        intersections,
        counted: true,
        ..lists
    }
}

/// The Gaussians of a view in depth order, and their numbers of intersections.
pub(super) struct Counted {
    covers: Buffer<u32>,
    by_depth: Sorted,
    counts: Buffer<u32>,
    /// `[chunks, 2]`: sums over the Gaussians of each cube.
    sums: Buffer<u32>,
    chunks: usize,
    tiles: [usize; 2],
    mask: Option<Buffer<i32>>,
}

/// Buffers of the intersections in the order of the Gaussians, for `capacity` of them.
pub(super) struct Room {
    pub capacity: usize,
    pub rank_of_block: Buffer<u32>,
    pub tiles: Buffer<u32>,
    pub gaussians: Buffer<u32>,
}

impl Room {
    pub fn new(gpu: &Gpu, capacity: usize) -> Self {
        let [tiles, gaussians] = [(); 2].map(|()| Buffer::with_headroom(gpu, capacity));
        Self { capacity, rank_of_block: Buffer::with_headroom(gpu, capacity.div_ceil(LIST_BLOCK)), tiles, gaussians }
    }
}

/// The mask of tiles, of which so many are side by side, as a kernel argument.
fn masked(mask: &Buffer<i32>, tiles_x: usize) -> TileMaskLaunch {
    TileMaskLaunch::new(mask.arg(), tiles_x as u32)
}

impl Counted {
    pub fn launch(gpu: &Gpu, projected: &Buffer<f32>, camera: &Intrinsics, cut: Cut<&Buffer<i32>>) -> Self {
        let count = projected.len / crate::project::COLUMNS;
        let (covers, depths) = (Buffer::<u32>::new(gpu, count * COVER), Buffer::<u32>::new(gpu, count));
        // SAFETY: every access is guarded by the lengths given.
        launch_unchecked!(
            gpu.units(count),
            cover_kernel(projected, &covers, &depths, camera.width, camera.height, cut.alpha_min as f32, count)
        );
        let by_depth = launch_sort(gpu, depths, None, u32::BITS);
        let chunks = count.div_ceil(UNITS).clamp(1, COUNTERS);
        let (counts, sums) = (Buffer::<u32>::new(gpu, count), Buffer::<u32>::new(gpu, 2 * chunks));
        let (tiles, mask) = (tile_grid(camera.width, camera.height), cut.mask.cloned());
        let of_tiles = ComptimeOptionArgs::from(mask.as_ref().map(|mask| masked(mask, tiles[0])));
        // SAFETY: every access is guarded by the number of visible Gaussians.
        launch_unchecked!(
            gpu.cubes(chunks),
            count_kernel(&by_depth.indices, &covers, &by_depth.kept, of_tiles, &counts, &sums, chunks)
        );
        Self { covers, by_depth, counts, sums, chunks, tiles, mask }
    }

    /// Asks the device for the numbers of Gaussians and of intersections.
    fn ask(&self, gpu: &Gpu) -> Sizes {
        Sizes::ask(gpu, &self.by_depth.kept, &self.sums, self.chunks)
    }

    /// Writes the tile and the Gaussian of each intersection that `room` holds. Returns the number of the first
    /// intersection of each Gaussian, and the sizes: the number of intersections that are written, and of Gaussians.
    pub fn emit(&self, gpu: &Gpu, room: &Room) -> [Buffer<u32>; 2] {
        let Self { covers, by_depth: Sorted { indices, kept, .. }, counts, sums, chunks, .. } = self;
        let (first_intersection, sizes) = (Buffer::<u32>::new(gpu, counts.len), Buffer::<u32>::new(gpu, 2));
        let Room { capacity, rank_of_block, tiles, gaussians } = room;
        let (blocks, first, tiles_x) = (capacity.div_ceil(LIST_BLOCK), &first_intersection, self.tiles[0]);
        // SAFETY: ranks are guarded by the number of visible Gaussians, blocks and intersections by the capacity.
        launch_unchecked!(
            gpu.cubes(*chunks),
            number_kernel(counts, sums, kept, first, rank_of_block, &sizes, *chunks, *capacity)
        );
        match &self.mask {
            // SAFETY: as above.
            None => launch_unchecked!(
                gpu.cubes(blocks),
                emit_kernel(indices, covers, first, rank_of_block, &sizes, tiles, gaussians, blocks, tiles_x)
            ),
            // SAFETY: as above; the public functions check that a mask has all tiles.
            Some(mask) => launch_unchecked!(
                gpu.cubes(counts.len.div_ceil(UNITS)),
                emit_masked_kernel(indices, covers, first, &sizes, masked(mask, tiles_x), tiles, gaussians)
            ),
        }
        [first_intersection, sizes]
    }

    /// Writes the lists, of the first intersections alone if `room` does not hold all. Their numbers of Gaussians and of intersections are
    /// those that there is room for.
    pub fn lists(&self, gpu: &Gpu, room: Room) -> DeviceIntersections {
        let [first_intersection, sizes] = self.emit(gpu, &room);
        let tiles = self.tiles[0] * self.tiles[1];
        let by_tile = launch_sort(gpu, room.tiles, Some(sizes.clone()), usize::BITS - (tiles - 1).leading_zeros());
        let (tile_start, counts) = (Buffer::new(gpu, tiles + 1), Buffer::new(gpu, tiles));
        // SAFETY: every access is guarded by the number of tiles and by that of the sorted intersections.
        launch_unchecked!(gpu.units(tiles + 1), ranges_kernel(&by_tile.keys, &sizes, &tile_start, &counts, tiles));
        DeviceIntersections {
            counts,
            tile_start,
            intersection_of_place: by_tile.indices,
            gaussian_of_intersection: room.gaussians,
            order: self.by_depth.indices.clone(),
            first_intersection,
            visible: self.counts.len,
            intersections: room.capacity,
            counted: false,
        }
    }
}
