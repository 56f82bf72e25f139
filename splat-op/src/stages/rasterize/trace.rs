//! The trace: what the forward pass keeps for the backward pass, in one or more runs of tiles. One run suffices unless
//! its buffers would exceed the device's largest.

use std::ops::Range;

use cubecl::prelude::*;

use super::blocks::BLOCKS;
use super::layer::{BUCKETS, KernelShape, SEGMENT};
use crate::gpu::{Buffer, Gpu, split};
use crate::intersect::TILE_PIXELS;
use crate::intersect::launch::DeviceIntersections;
use crate::limits::Need;

/// Number of words of a segment.
pub(super) const WORDS: usize = BUCKETS * BLOCKS;

/// The tiles of a launch.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
pub(super) struct TileRun {
    pub first_tile: u32,
    pub end_tile: u32,
    /// Slot of the first tile's first segment if all tiles had one run; slots of a run are counted from it.
    pub first_slot: u32,
}

/// Values that the forward pass keeps.
#[derive(Clone, Debug)]
pub(crate) struct DeviceTrace {
    pub(super) runs: Vec<TraceRun>,
    /// `[tiles, 256]`: the transmittance behind all layers.
    pub(super) final_transmittance: Buffer<f32>,
    /// `[tiles]`: number of segments passed before every pixel was finished.
    pub(super) segment_count: Buffer<u32>,
}

/// Values of a run of tiles. Pixels are counted by unit, block by block.
#[derive(Clone, Debug)]
pub(super) struct TraceRun {
    pub slots: RunSlots,
    /// `[slots, kept, 256]`: values per segment and pixel; see [`KernelShape::kept`].
    pub kept: Buffer<f32>,
    /// `[slots, 4, 8]`: for each bucket and block, the places that some pixel of the block needs, one bit each.
    pub words: Buffer<u32>,
    /// `[slots]`: the tile of each slot.
    pub tile_of_slot: Buffer<u32>,
}

/// Tiles of a run and the slots of their segments.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RunSlots {
    pub tiles: Range<usize>,
    pub slots: Range<usize>,
}

impl RunSlots {
    pub fn arg(&self) -> TileRunLaunch {
        TileRunLaunch::new(self.tiles.start as u32, self.tiles.end as u32, self.slots.start as u32)
    }
}

/// Hint in error messages: how to make a render keep less for its backward pass.
pub(super) const FEWER_PLACES: &str =
    "train on smaller pictures, raise `alpha_min`, or render parts of the picture with several cameras";

impl TraceRun {
    /// Allocates the buffers of a run, or empty ones if nothing is kept. Lists that are not counted may have more slots than their tiles
    /// write: these are of the first tile, which has no place in them.
    pub fn new(gpu: &Gpu, slots: RunSlots, shape: KernelShape, keep: bool, counted: bool) -> Self {
        let count = if keep { slots.slots.len() } else { 0 };
        let kept = count * shape.kept() * TILE_PIXELS;
        Need { what: "the trace of a tile for the backward pass", bytes: 4 * kept as u64, hint: FEWER_PLACES }
            .assert_fits(gpu.buffer_limit);
        Self {
            kept: Buffer::with_headroom(gpu, kept),
            words: Buffer::with_headroom(gpu, count * WORDS),
            tile_of_slot: if counted { Buffer::with_headroom(gpu, count) } else { Buffer::zeros(gpu, count) },
            slots,
        }
    }
}

/// Returns the runs of a trace. Waits for the device if one run does not fit its largest buffer.
pub(super) fn runs_of(gpu: &Gpu, lists: &DeviceIntersections, shape: KernelShape, keep: bool) -> Vec<RunSlots> {
    let tiles = lists.counts.len;
    let slots = lists.intersections / SEGMENT + tiles;
    let room = (gpu.buffer_limit / (4 * (shape.kept() * TILE_PIXELS) as u64)) as usize;
    if !keep || slots <= room {
        return vec![RunSlots { tiles: 0..tiles, slots: 0..slots }];
    }
    runs_from(&lists.tile_start.read(gpu), room)
}

/// Splits tiles that begin at the places `starts` into runs of at most `room` slots, unless a run is a single tile.
fn runs_from(starts: &[u32], room: usize) -> Vec<RunSlots> {
    let first_slot = |tile: usize| starts[tile] as usize / SEGMENT + tile;
    let slots = |tiles: Range<usize>| RunSlots { slots: first_slot(tiles.start)..first_slot(tiles.end), tiles };
    split(starts.len() - 1, room, first_slot).into_iter().map(slots).collect()
}

#[cfg(test)]
mod tests;
