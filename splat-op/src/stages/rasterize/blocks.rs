//! Blocks of a tile: 8 × 4 pixels each, the pixels of 32 consecutive units. A block evaluates only the Gaussians whose
//! ellipse meets it.

use cubecl::prelude::*;

use super::ellipse::LayerEllipse;
use super::layer::RasterFrame;
use crate::gpu::math::{finite, within};
use crate::intersect::TILE_SIZE;

/// Width and height of a block, px.
pub(crate) const BLOCK_WIDTH: usize = 8;
pub(crate) const BLOCK_HEIGHT: usize = 4;

/// Number of pixels in a block, one unit each.
pub(crate) const BLOCK_PIXELS: usize = BLOCK_WIDTH * BLOCK_HEIGHT;

/// Number of blocks side by side in a tile.
const ACROSS: usize = TILE_SIZE / BLOCK_WIDTH;

/// Number of blocks in a tile.
pub(crate) const BLOCKS: usize = ACROSS * (TILE_SIZE / BLOCK_HEIGHT);

/// Number of blocks in a half of a tile, the upper or the lower.
pub(crate) const HALF_BLOCKS: usize = BLOCKS / 2;

/// Bound of the rounding error of a coordinate, relative to the largest coordinate in its formula: 16 roundings of f32.
const SLIP: f32 = 1e-6;

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

/// Returns the blocks in half `half` of a tile whose pixel centres the ellipse `alpha >= alpha_min` meets, one bit each.
/// `left` is the centre of the tile's first column, px. No pixel that would see an alpha is left out.
///
/// The least `u² + v²` over a rectangle lies on a side that faces the ellipse's centre, or is zero if it holds the
/// centre. On a side it is the minimum of a parabola. Both sides nearest to the centre are tried, whether they face it
/// or not: a point of the rectangle has no less than the least.
#[cube]
pub(super) fn blocks_met(ellipse: &LayerEllipse, left: f32, half: u32, frame: &RasterFrame) -> u32 {
    let last = comptime!((TILE_SIZE - 1) as f32);
    let dx = left - ellipse.x;
    let dy = ellipse.rise;
    let farthest_x = max(dx.abs(), (dx + last).abs());
    let farthest_y = fma(farthest_x, ellipse.shear.abs(), max(dy.abs(), (dy + last).abs()));
    // A relative margin for the logarithm, an absolute one for the exponential.
    let limit = fma(max(ellipse.opacity.ln() - frame.log_least, 0.0), 2.00002f32, 1e-4f32);
    let slip = fma(farthest_x, ellipse.inverse_u, farthest_y * ellipse.inverse_v) * SLIP;
    let extent = limit.sqrt() + slip;
    let bound = extent * extent;
    // The minimum on a horizontal side at `dy` lies at `slope dy`. With `p = shear sigma_u / sigma_v` the slope is
    // `p / (1 + p²)` times `sigma_u / sigma_v`; both parts of the fraction are divided by the larger of 1 and `p`.
    let ratio = ellipse.inverse_v / ellipse.inverse_u;
    let p = ellipse.shear * ratio;
    let scale = 1.0 / max(p.abs(), 1.0);
    let scaled = p * scale;
    let slope = ratio * scale * scaled / fma(scale, scale, scaled * scaled);
    let sound =
        finite(slope) && finite(p) && finite(farthest_y) && finite(ellipse.inverse_u) && finite(ellipse.inverse_v);

    let mut met = 0u32;
    #[unroll]
    for block in 0..comptime!(HALF_BLOCKS) {
        let low_x = dx + comptime!((block % ACROSS * BLOCK_WIDTH) as f32);
        let high_x = low_x + comptime!((BLOCK_WIDTH - 1) as f32);
        let row = half * comptime!((TILE_SIZE / 2) as u32) + comptime!((block / ACROSS * BLOCK_HEIGHT) as u32);
        let low_y = dy + f32::cast_from(row);
        let high_y = low_y + comptime!((BLOCK_HEIGHT - 1) as f32);
        let near_x = within(0.0, low_x, high_x);
        let near_y = within(0.0, low_y, high_y);
        let beside = whitened(ellipse, near_x, within(ellipse.shear * near_x, low_y, high_y));
        let above = whitened(ellipse, within(slope * near_y, low_x, high_x), near_y);
        if !sound || beside <= bound || above <= bound {
            met |= comptime!(1u32 << block);
        }
    }
    met
}

/// Returns `u² + v²` at an offset from the ellipse's centre, px.
#[cube]
fn whitened(ellipse: &LayerEllipse, dx: f32, dy: f32) -> f32 {
    let u = dx * ellipse.inverse_u;
    let v = fma(-ellipse.shear, dx, dy) * ellipse.inverse_v;
    fma(u, u, v * v)
}

#[cfg(test)]
mod tests;
