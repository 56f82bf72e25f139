//! The segment of a cube of the backward pass: which places it has, and what the forward pass kept of it.

use cubecl::prelude::*;

use super::layer::{BUCKET, SEGMENT, first_slot};
use super::trace::TileRun;
use crate::intersect::forward::TileLists;

/// What the forward pass and the suffix kernel kept of a run of tiles.
#[derive(CubeType, CubeLaunch)]
pub(super) struct KeptTrace {
    /// `[slot][value][unit]`
    pub kept: Box<[f32]>,
    /// `[slot][bucket][block]`
    pub words: Box<[u32]>,
    pub tile_of_slot: Box<[u32]>,
    /// Number of segments passed in each tile.
    pub segment_count: Box<[u32]>,
    /// `[slot][unit]`: `ρ` behind the segment.
    pub suffix_rho: Box<[f32]>,
}

/// The segments of a launch, and the intersections whose rows it writes, `first_row..end_row`.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
pub(super) struct SegmentRange {
    pub run: TileRun,
    pub slots: u32,
    pub first_row: u32,
    pub end_row: u32,
}

/// A segment of a tile.
#[derive(CubeType, Clone, Copy)]
pub(super) struct Segment {
    pub tile: u32,
    /// First place of the tile, and number of its places.
    pub first: u32,
    pub places: u32,
    /// Number of the tile's places before the segment.
    pub start: u32,
    /// Number of places and of buckets of the segment.
    pub count: u32,
    pub buckets: u32,
    /// Whether it has places with a row of the launch.
    pub wanted: bool,
    /// Whether it is wanted, and pixels were left when the forward pass reached it.
    pub passed: bool,
}

#[cube]
impl Segment {
    /// Returns the segment of a slot. With `add`, each has a row of the launch.
    pub fn of(slot: u32, lists: &TileLists, trace: &KeptTrace, range: &SegmentRange, #[comptime] add: bool) -> Segment {
        let tile = trace.tile_of_slot[slot as usize];
        let first = lists.start(tile);
        let places = lists.start(tile + 1) - first;
        let segment = slot - (first_slot(first, tile) - range.run.first_slot);
        let start = segment * comptime!(SEGMENT as u32);
        // The last slot of a tile may have no places.
        let mut wanted = start < places;
        if comptime!(!add) {
            // Intersections ascend along a tile's list.
            let begin = first + start;
            if wanted {
                let last = begin + min(places - start, comptime!(SEGMENT as u32)) - 1;
                wanted = lists.intersection(begin) < range.end_row && lists.intersection(last) >= range.first_row;
            }
        }
        let count = min(places - min(places, start), comptime!(SEGMENT as u32));
        Segment {
            tile,
            first,
            places,
            start,
            count,
            buckets: (count + comptime!(BUCKET as u32 - 1)) / comptime!(BUCKET as u32),
            wanted,
            passed: wanted && segment < trace.segment_count[tile as usize],
        }
    }
}

/// Writes zeros to the rows of a segment before which all pixels were finished.
#[cube]
pub(super) fn clear_rows(
    segment: &Segment,
    lists: &TileLists,
    rows: &mut [f32],
    range: &SegmentRange,
    #[comptime] columns: usize,
) {
    if segment.wanted && !segment.passed {
        let mut i = UNIT_POS;
        while i < segment.count {
            let target = lists.intersection(segment.first + segment.start + i) - range.first_row;
            if target < range.end_row - range.first_row {
                for column in 0..columns {
                    rows[target as usize * columns + column] = 0.0f32;
                }
            }
            i += CUBE_DIM;
        }
    }
}
