//! Kernels of `intersect` from the Gaussians in depth order to each tile's first intersection: counting, numbering and
//! writing the intersections.

use cubecl::prelude::*;

use super::forward::{TileCoverage, TileMask};
use super::sort::uniform;
use crate::gpu::{SUM_ROOM, UNITS, cube_exclusive_sum};

/// Number of intersections that a cube writes.
pub(super) const LIST_BLOCK: usize = 4 * UNITS;

/// Bits of a word.
const WORD_BITS: usize = 32;

/// Returns the ranks of this cube: the first, and the one after the last.
#[cube]
fn ranks(visible: u32, chunks: u32) -> (u32, u32) {
    let each = visible.div_ceil(chunks);
    let first = min(CUBE_POS as u32 * each, visible);
    (first, min(first + each, visible))
}

/// Counts the intersections of each Gaussian in depth order, with the tiles of `mask` if it is given, and of each cube's Gaussians
/// together. A cube's sum is two numbers, `2^16 high + low`, so that it cannot wrap.
#[cube(launch_unchecked)]
pub(super) fn count_kernel(
    order: &[u32],
    covers: &[u32],
    visible: &[u32],
    mask: ComptimeOption<TileMask>,
    counts: &mut [u32],
    sums: &mut [u32],
    chunks: u32,
) {
    let mut shared = Shared::<[u32]>::new_slice(comptime!(SUM_ROOM));
    let (first, end) = ranks(visible[0], chunks);
    let mut own = 0u32;
    let mut rank = first + UNIT_POS;
    while rank < end {
        let cover = TileCoverage::load(covers, order[rank as usize] as usize);
        let count = count_of(&cover, &mask);
        counts[rank as usize] = count;
        // At most the largest u32, which no list holds.
        own += min(count, 0xffff_ffff - own);
        rank += comptime!(UNITS as u32);
    }
    let (_, low) = cube_exclusive_sum(own & 0xffff, &mut shared);
    let (_, high) = cube_exclusive_sum(own >> 16, &mut shared);
    if UNIT_POS == 0 {
        sums[2 * CUBE_POS] = low;
        sums[2 * CUBE_POS + 1] = high;
    }
}

#[cube]
fn count_of(cover: &TileCoverage, mask: &ComptimeOption<TileMask>) -> u32 {
    #[comptime]
    match mask {
        ComptimeOption::Some(mask) => cover.count_in(mask),
        ComptimeOption::None => cover.count(),
    }
}

/// Largest number of an intersection: a multiple of a block, above every length of a list.
const MOST: u32 = 0u32.wrapping_sub(LIST_BLOCK as u32);

/// Returns the sum of two numbers of at most [`MOST`], or [`MOST`] if it is larger.
#[cube]
fn plus(one: u32, other: u32) -> u32 {
    one + min(other, comptime!(MOST) - one)
}

/// Returns `2^16 high + low`, or [`MOST`] if it is larger.
#[cube]
fn joined(low: u32, high: u32) -> u32 {
    let high = high + (low >> 16);
    let sum = (high << 16) | (low & 0xffff);
    select(high > 0xffff, comptime!(MOST), min(sum, comptime!(MOST)))
}

/// Writes the number of each Gaussian's first intersection, and the rank that has the first intersection of each block
/// below `capacity`. Numbers above [`MOST`] become [`MOST`]. The sizes are the number of intersections to list, at most
/// `capacity`, and the number of visible Gaussians.
#[cube(launch_unchecked)]
pub(super) fn number_kernel(
    counts: &[u32],
    sums: &[u32],
    visible: &[u32],
    first_intersection: &mut [u32],
    rank_of_block: &mut [u32],
    sizes: &mut [u32],
    chunks: u32,
    capacity: u32,
) {
    let mut shared = Shared::<[u32]>::new_slice(comptime!(SUM_ROOM));
    let blocks = capacity.div_ceil(comptime!(LIST_BLOCK as u32));
    let mut low = 0u32;
    let mut high = 0u32;
    let mut other = UNIT_POS as usize;
    while other < CUBE_POS {
        // Halves, of which a thousand cannot wrap.
        let earlier = joined(sums[2 * other], sums[2 * other + 1]);
        low += earlier & 0xffff;
        high += earlier >> 16;
        other += comptime!(UNITS);
    }
    let (_, low) = cube_exclusive_sum(low, &mut shared);
    let (_, high) = cube_exclusive_sum(high, &mut shared);
    let mut carried = joined(low, high);
    let visible = uniform(visible);
    let (first, end) = ranks(visible, chunks);
    let mut from = first;
    while from < end {
        let rank = from + UNIT_POS;
        let mut count = 0u32;
        if rank < end {
            count = counts[rank as usize];
        }
        let (before, total) = cube_exclusive_sum(count, &mut shared);
        if rank < end {
            let start = plus(carried, before);
            first_intersection[rank as usize] = start;
            let next = plus(start, count);
            let mut block = start.div_ceil(comptime!(LIST_BLOCK as u32));
            while block < blocks && block * comptime!(LIST_BLOCK as u32) < next {
                rank_of_block[block as usize] = rank;
                block += 1;
            }
        }
        carried = plus(carried, total);
        from += comptime!(UNITS as u32);
    }
    if CUBE_POS as u32 == chunks - 1 && UNIT_POS == 0 {
        sizes[0] = min(carried, capacity);
        sizes[1] = visible;
    }
}

/// Writes the tile and the Gaussian of each intersection; a unit writes some intersections of a block, whichever Gaussians have them.
#[cube(launch_unchecked)]
pub(super) fn emit_kernel(
    order: &[u32],
    covers: &[u32],
    first_intersection: &[u32],
    rank_of_block: &[u32],
    sizes: &[u32],
    tiles: &mut [u32],
    gaussians: &mut [u32],
    blocks: u32,
    tiles_x: u32,
) {
    // A bit for each intersection of the block: whether it is the first of its Gaussian.
    let firsts = Shared::<[Atomic<u32>]>::new_slice(comptime!(LIST_BLOCK / WORD_BITS));
    // Number of bits in the words before each.
    let mut earlier = Shared::<[u32]>::new_slice(comptime!(LIST_BLOCK / WORD_BITS));
    // A dispatch may hold more cubes than there are blocks.
    if CUBE_POS < blocks as usize {
        let unit = UNIT_POS as usize;
        if unit < comptime!(LIST_BLOCK / WORD_BITS) {
            firsts[unit].store(0u32);
        }
        sync_cube();
        let first = CUBE_POS as u32 * comptime!(LIST_BLOCK as u32);
        let (listed, visible) = (sizes[0], sizes[1]);
        let end = min(first + comptime!(LIST_BLOCK as u32), listed);
        // A block behind the list belongs to no rank.
        let mut rank_of_first = visible;
        if first < listed {
            rank_of_first = rank_of_block[CUBE_POS];
        }
        let mut rank = rank_of_first + 1 + UNIT_POS;
        let mut within = true;
        while within {
            within = rank < visible;
            if within {
                let start = first_intersection[rank as usize];
                within = start < end;
                if within {
                    let at = start - first;
                    firsts[(at / comptime!(WORD_BITS as u32)) as usize]
                        .fetch_or(1u32 << (at % comptime!(WORD_BITS as u32)));
                }
            }
            rank += comptime!(UNITS as u32);
        }
        sync_cube();
        if unit < comptime!(LIST_BLOCK / WORD_BITS) {
            let mut count = 0u32;
            for word in 0..unit {
                count += firsts[word].load().count_ones();
            }
            earlier[unit] = count;
        }
        sync_cube();
        #[unroll]
        for i in 0..comptime!(LIST_BLOCK / UNITS) {
            let at = UNIT_POS + comptime!((i * UNITS) as u32);
            let intersection = first + at;
            if intersection < end {
                let word = (at / comptime!(WORD_BITS as u32)) as usize;
                let up_to_here = firsts[word].load() & (0xffff_ffffu32 >> (31 - at % comptime!(WORD_BITS as u32)));
                let rank = (rank_of_first + earlier[word] + up_to_here.count_ones()) as usize;
                let gaussian = order[rank];
                let cover = TileCoverage::load(covers, gaussian as usize);
                let (x, y) = cover.tile(intersection - first_intersection[rank]);
                tiles[intersection as usize] = y * tiles_x + x;
                gaussians[intersection as usize] = gaussian;
            }
        }
    }
}

/// Writes the tile and the Gaussian of each intersection with a tile of `mask`; a unit writes those of a Gaussian.
#[cube(launch_unchecked)]
pub(super) fn emit_masked_kernel(
    order: &[u32],
    covers: &[u32],
    first_intersection: &[u32],
    sizes: &[u32],
    mask: TileMask,
    tiles: &mut [u32],
    gaussians: &mut [u32],
) {
    let rank = ABSOLUTE_POS;
    let (listed, visible) = (sizes[0], sizes[1]);
    if rank < visible as usize {
        let gaussian = order[rank];
        let cover = TileCoverage::load(covers, gaussian as usize);
        let mut intersection = first_intersection[rank];
        for index in 0..cover.count() {
            let (x, y) = cover.tile(index);
            if mask.holds(x, y) && intersection < listed {
                tiles[intersection as usize] = mask.number(x, y);
                gaussians[intersection as usize] = gaussian;
                intersection += 1;
            }
        }
    }
}

/// Writes the index of each tile's first intersection in the sorted list, with one more entry for the end, and each
/// tile's number of intersections.
#[cube(launch_unchecked)]
pub(super) fn ranges_kernel(sorted_tiles: &[u32], sizes: &[u32], starts: &mut [u32], counts: &mut [i32], tiles: u32) {
    let tile = ABSOLUTE_POS as u32;
    let intersections = sizes[0];
    if tile <= tiles {
        let start = lower_bound(sorted_tiles, intersections, tile);
        starts[tile as usize] = start;
        if tile < tiles {
            counts[tile as usize] = i32::cast_from(lower_bound(sorted_tiles, intersections, tile + 1) - start);
        }
    }
}

/// Returns the first place whose tile is at least `tile`.
#[cube]
fn lower_bound(sorted_tiles: &[u32], intersections: u32, tile: u32) -> u32 {
    let mut low = 0u32;
    let mut high = intersections;
    while low < high {
        let middle = low + (high - low) / 2;
        if sorted_tiles[middle as usize] < tile {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}
