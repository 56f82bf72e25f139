//! Blocks of a tile: 8 × 4 pixels each, the pixels of 32 consecutive units. A block evaluates only the Gaussians whose ellipse meets it.

use cubecl::prelude::*;

use crate::intersect::TILE_SIZE;

/// Width and height of a block, px.
pub(crate) const BLOCK_WIDTH: usize = 8;
pub(crate) const BLOCK_HEIGHT: usize = 4;

/// Number of pixels in a block, one unit each.
pub(crate) const BLOCK_PIXELS: usize = BLOCK_WIDTH * BLOCK_HEIGHT;

/// Number of blocks side by side in a tile.
pub(super) const ACROSS: usize = TILE_SIZE / BLOCK_WIDTH;

/// Number of blocks in a tile.
pub(crate) const BLOCKS: usize = ACROSS * (TILE_SIZE / BLOCK_HEIGHT);

/// Number of blocks in a half of a tile, the upper or the lower.
pub(crate) const HALF_BLOCKS: usize = BLOCKS / 2;

/// Returns the index within the tile, counted row by row, of the pixel of unit `unit`.
#[cube]
pub(crate) fn pixel_of(unit: u32) -> u32 {
    let block = unit / comptime!(BLOCK_PIXELS as u32);
    let lane = unit % comptime!(BLOCK_PIXELS as u32);
    let column =
        block % comptime!(ACROSS as u32) * comptime!(BLOCK_WIDTH as u32) + lane % comptime!(BLOCK_WIDTH as u32);
    let row = block / comptime!(ACROSS as u32) * comptime!(BLOCK_HEIGHT as u32) + lane / comptime!(BLOCK_WIDTH as u32);
    row * comptime!(TILE_SIZE as u32) + column
}
