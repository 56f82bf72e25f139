//! The blocks of a tile in the CPU twin, which of them a box meets, and the loop over those.

use fearless_simd::prelude::*;

use super::pixels::{SIMD_ROWS, SIMD_WIDTH, lanes, len};
use crate::intersect::TILE_SIZE;
use crate::simd::real::Real;

/// Number of blocks along a row of a tile.
const SIMD_ACROSS: usize = TILE_SIZE / SIMD_WIDTH;

/// Number of blocks in a tile.
pub(crate) const SIMD_BLOCKS: usize = SIMD_ACROSS * (TILE_SIZE / SIMD_ROWS);
const _: () = assert!(SIMD_ACROSS == 4 && SIMD_BLOCKS == u16::BITS as usize);

/// The blocks of a tile, to be compared with boxes and ellipses.
pub(crate) struct TileBlocks<F> {
    /// For each block the centres of its first and last pixels along x and y, px.
    pub(super) first: [[F; SIMD_BLOCKS]; 2],
    pub(super) last: [[F; SIMD_BLOCKS]; 2],
}

impl<F: Real> TileBlocks<F> {
    /// The blocks of the tile whose first pixel is at `corner`, px.
    pub fn new(corner: [F; 2]) -> Self {
        let (mut first, mut last) = ([[F::ZERO; SIMD_BLOCKS]; 2], [[F::ZERO; SIMD_BLOCKS]; 2]);
        for block in 0..SIMD_BLOCKS {
            let place = [block % SIMD_ACROSS * SIMD_WIDTH, block / SIMD_ACROSS * SIMD_ROWS];
            for (axis, size) in [SIMD_WIDTH, SIMD_ROWS].into_iter().enumerate() {
                first[axis][block] = corner[axis] + F::of(place[axis] as f64 + 0.5);
                last[axis][block] = first[axis][block] + F::of((size - 1) as f64);
            }
        }
        Self { first, last }
    }

    /// Returns a bit for each block whose rectangle of pixels' centres meets the box around `middle`, px, of half the size `half`. A box
    /// that is not a number meets all.
    #[inline(always)]
    pub fn met<S: Simd>(&self, simd: S, middle: [F; 2], half: [F; 2]) -> u16 {
        let (mut low, mut high) = ([F::ZERO; 2], [F::ZERO; 2]);
        for axis in 0..2 {
            // The margin covers rounding.
            let reach = half[axis] + F::of(0.01) + F::of(8.0) * F::EPSILON * (middle[axis].abs() + half[axis]);
            (low[axis], high[axis]) = (middle[axis] - reach, middle[axis] + reach);
        }
        let mut met = 0;
        for block in (0..SIMD_BLOCKS).step_by(len::<S, F>()) {
            let mut apart = lanes(simd, &self.last[0], block).simd_lt(F::Block::<S>::splat(simd, low[0]));
            apart |= lanes(simd, &self.first[0], block).simd_gt(F::Block::<S>::splat(simd, high[0]));
            apart |= lanes(simd, &self.last[1], block).simd_lt(F::Block::<S>::splat(simd, low[1]));
            apart |= lanes(simd, &self.first[1], block).simd_gt(F::Block::<S>::splat(simd, high[1]));
            met |= ((!apart).to_bitmask() as u16) << block;
        }
        met
    }
}

/// Iterates over the numbers of the blocks that have a bit, from the lowest.
#[derive(Clone, Copy)]
pub(super) struct Blocks(pub u16);

impl Iterator for Blocks {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        let first = self.0.trailing_zeros() as usize;
        let any = self.0 != 0;
        self.0 &= self.0.wrapping_sub(1);
        any.then_some(first)
    }
}

#[cfg(test)]
mod tests;
