//! The tiles that each Gaussian covers, and its depth as a sort key.
//!
//! The coverage of a Gaussian is decided once, in floats, and stored as integers: its box of tiles, divided into at most 8 × 8 cells, with
//! one bit per cell. Counting the intersections and writing them both read these integers, so they cannot disagree. In a box of up to 8 × 8
//! tiles a cell is one tile. In a larger box a cell is several tiles, and its intersections are those of all its tiles: some that cannot
//! contribute are listed, none that can contribute is lost.

use cubecl::prelude::*;

use super::TILE_SIZE;
use super::sort::HIDDEN;
use crate::gpu::{Vec3, finite, undefined, within};
use crate::project::COLUMNS;
use crate::project::forward::PackedEllipse;

/// Number of words of a stored [`TileCoverage`].
pub(super) const COVER: usize = 4;

/// Number of cells along each side of a coverage.
const CELLS: u32 = 8;

/// The lists of a view, for the kernels that read them; see `DeviceIntersections`.
#[derive(CubeType, CubeLaunch)]
pub(crate) struct TileLists {
    tile_start: Box<[u32]>,
    intersection_of_place: Box<[u32]>,
    pub gaussian_of_intersection: Box<[u32]>,
}

#[cube]
impl TileLists {
    /// Returns the first place of a tile; of the tile after the last, the number of places.
    pub fn start(&self, tile: u32) -> u32 {
        self.tile_start[tile as usize]
    }

    pub fn intersection(&self, place: u32) -> u32 {
        self.intersection_of_place[place as usize]
    }

    pub fn gaussian(&self, place: u32) -> u32 {
        self.gaussian_of_intersection[self.intersection(place) as usize]
    }
}

/// The tiles whose lists are not empty, `[tiles along y, tiles along x]`: those that are not zero.
#[derive(CubeType, CubeLaunch)]
pub(super) struct TileMask {
    tiles: Box<[i32]>,
    tiles_x: u32,
}

#[cube]
impl TileMask {
    /// Returns the number of a tile.
    pub fn number(&self, x: u32, y: u32) -> u32 {
        y * self.tiles_x + x
    }

    pub fn holds(&self, x: u32, y: u32) -> bool {
        self.tiles[self.number(x, y) as usize] != 0
    }
}

/// Tiles that list a Gaussian.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct TileCoverage {
    /// First tile of the box.
    x: u32,
    y: u32,
    /// Number of tiles of the box along x and y; zero for none.
    width: u32,
    height: u32,
    /// One bit per cell, row by row; each word holds four rows.
    low: u32,
    high: u32,
}

#[cube]
impl TileCoverage {
    pub fn load(covers: &[u32], gaussian: usize) -> TileCoverage {
        let at = gaussian * comptime!(COVER);
        TileCoverage {
            x: covers[at] & 0xffff,
            y: covers[at] >> 16,
            width: covers[at + 1] & 0xffff,
            height: covers[at + 1] >> 16,
            low: covers[at + 2],
            high: covers[at + 3],
        }
    }

    fn store(&self, covers: &mut [u32], gaussian: usize) {
        let at = gaussian * comptime!(COVER);
        covers[at] = self.x | (self.y << 16);
        covers[at + 1] = self.width | (self.height << 16);
        covers[at + 2] = self.low;
        covers[at + 3] = self.high;
    }

    /// Width of a cell in tiles.
    fn cell_width(&self) -> u32 {
        (self.width + comptime!(CELLS - 1)) / comptime!(CELLS)
    }

    fn cell_height(&self) -> u32 {
        (self.height + comptime!(CELLS - 1)) / comptime!(CELLS)
    }

    /// Whether each cell is one tile.
    fn fine(&self) -> bool {
        self.width <= comptime!(CELLS) && self.height <= comptime!(CELLS)
    }

    /// Returns the bits of a row of cells.
    fn row(&self, row: u32) -> u32 {
        (select(row < 4, self.low, self.high) >> (8 * (row & 3))) & 0xff
    }

    /// Number of rows of tiles in a row of cells.
    fn tile_rows(&self, row: u32) -> u32 {
        let first = min(row * self.cell_height(), self.height);
        min(self.cell_height(), self.height - first)
    }

    /// Number of covered tiles in each row of tiles of a row of cells. Only the last cell may reach beyond the box.
    fn tiles_across(&self, row: u32) -> u32 {
        let bits = self.row(row);
        let cell_width = self.cell_width();
        let end = (32 - bits.leading_zeros()) * cell_width;
        bits.count_ones() * cell_width - (max(end, self.width) - self.width)
    }

    pub fn count(&self) -> u32 {
        let mut count = self.low.count_ones() + self.high.count_ones();
        if !self.fine() {
            count = 0;
            for row in 0..comptime!(CELLS) {
                count += self.tile_rows(row) * self.tiles_across(row);
            }
        }
        count
    }

    /// Returns the number of covered tiles of a mask.
    pub fn count_in(&self, mask: &TileMask) -> u32 {
        let mut count = 0u32;
        for index in 0..self.count() {
            let (x, y) = self.tile(index);
            count += select(mask.holds(x, y), 1u32, 0u32);
        }
        count
    }

    /// Returns the picture's tile that is the covered tile `index`, below [`TileCoverage::count`]: row by row.
    pub fn tile(&self, index: u32) -> (u32, u32) {
        let in_low = self.low.count_ones();
        let bit = if index < in_low { nth_bit(self.low, index) } else { 32 + nth_bit(self.high, index - in_low) };
        let mut x = bit % comptime!(CELLS);
        let mut y = bit / comptime!(CELLS);
        if !self.fine() {
            let mut left = index;
            let mut row = 0u32;
            let mut here = self.tile_rows(0u32) * self.tiles_across(0u32);
            while left >= here && row < comptime!(CELLS - 1) {
                left -= here;
                row += 1;
                here = self.tile_rows(row) * self.tiles_across(row);
            }
            let (across, cell_width) = (max(self.tiles_across(row), 1), self.cell_width());
            let in_row = left % across;
            x = nth_bit(self.row(row), in_row / cell_width) * cell_width + in_row % cell_width;
            y = row * self.cell_height() + left / across;
        }
        (self.x + x, self.y + y)
    }
}

/// Returns the position of the set bit with `n` set bits below it.
#[cube]
fn nth_bit(bits: u32, n: u32) -> u32 {
    let mut rest = bits;
    let mut left = n;
    let mut at = 0u32;
    #[unroll]
    for step in 0..5u32 {
        let half = comptime!(16 >> step);
        let low = (rest & comptime!((1u32 << half) - 1)).count_ones();
        if left >= low {
            left -= low;
            rest >>= half;
            at += half;
        }
    }
    at
}

/// A packed ellipse and its extent.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct EllipseExtent {
    ellipse: PackedEllipse,
    /// The largest `u² + v²` that can show.
    limit: f32,
}

#[cube]
impl EllipseExtent {
    /// Whether the ellipse reaches the rectangle of pixel centres from `first` up to, but not including, `end` px along each axis. The
    /// least `u² + v²` over the rectangle lies at the centre, or on a side that faces the centre, where it is the minimum of a parabola.
    fn meets(&self, first_x: u32, end_x: u32, first_y: u32, end_y: u32) -> bool {
        let e = self.ellipse;
        let left = f32::cast_from(first_x) + 0.5 - e.x;
        let right = f32::cast_from(end_x) - 0.5 - e.x;
        let top = f32::cast_from(first_y) + 0.5 - e.y;
        let bottom = f32::cast_from(end_y) - 0.5 - e.y;
        let near_x = within(0.0, left, right);
        let near_y = within(0.0, top, bottom);
        let mut reached = true;
        if near_x != 0.0 || near_y != 0.0 {
            let mut by_side = f32::max_value();
            let mut by_top = f32::max_value();
            if near_x != 0.0 {
                by_side = self.whitened(near_x, within(e.shear * near_x, top, bottom));
            }
            if near_y != 0.0 {
                let across = e.shear * e.sigma_u;
                let slope = across * e.sigma_u / (across * across + e.sigma_v * e.sigma_v);
                by_top = self.whitened(within(slope * near_y, left, right), near_y);
            }
            // `dy − shear dx` loses digits when both terms are large; `rasterize` may then see a smaller value than this.
            let farthest = max(left.abs(), right.abs()) * e.shear.abs() + max(top.abs(), bottom.abs());
            let extent = self.limit.sqrt() + 1e-6 * farthest / e.sigma_v;
            // NaN says nothing, and `min` may return the other of its arguments.
            let known = !(undefined(by_side) || undefined(by_top));
            reached = !(known && min(by_side, by_top) > extent * extent);
        }
        reached
    }

    fn whitened(&self, dx: f32, dy: f32) -> f32 {
        let u = dx / self.ellipse.sigma_u;
        let v = (dy - self.ellipse.shear * dx) / self.ellipse.sigma_v;
        u * u + v * v
    }
}

/// Returns the first tile, and the tile after the last, along an axis that hold a pixel centre within `half` px of `mean`; the same tile
/// twice if there is none. The tiles are tested afterwards, and the range may begin less than a pixel earlier.
#[cube]
fn tile_range(mean: f32, half: f32, pixels: u32) -> (u32, u32) {
    // The margin covers the rounding of centre and extent.
    let margin = 0.01 + 1e-6 * (mean.abs() + half);
    let last = f32::cast_from(pixels - 1);
    let low = mean - half - 0.5 - margin;
    let high = mean + half - 0.5 + margin;
    let mut first = 0u32;
    let mut end = 0u32;
    if high >= 0.0 && low <= last {
        first = u32::cast_from(within(low, 0.0, last)) / comptime!(TILE_SIZE as u32);
        end = u32::cast_from(within(high, 0.0, last)) / comptime!(TILE_SIZE as u32) + 1;
    }
    (first, end)
}

/// Stores each Gaussian's coverage, and its depth as a key: positive floats are ordered as their bits are.
#[cube(launch_unchecked)]
pub(super) fn cover_kernel(
    projected: &[f32],
    covers: &mut [u32],
    keys: &mut [u32],
    width: u32,
    height: u32,
    alpha_min: f32,
    count: u32,
) {
    let gaussian = ABSOLUTE_POS;
    if gaussian < count as usize {
        let at = gaussian * comptime!(COLUMNS);
        let e = PackedEllipse::load(projected, gaussian);
        let mut cover = TileCoverage { x: 0, y: 0, width: 0, height: 0, low: 0, high: 0 };
        let mut usable = e.depth > 0.0 && e.opacity > 0.0 && e.opacity >= alpha_min;
        #[unroll]
        for column in 0..comptime!(COLUMNS) {
            usable = usable && finite(projected[at + column]);
        }
        let mut key = HIDDEN.runtime();
        if usable {
            let mut limit = f32::max_value();
            if alpha_min > 0.0 {
                // A relative margin for the logarithm, an absolute one for the exponential.
                limit = 2.0 * (e.opacity / alpha_min).ln() * 1.00001 + 1e-4;
            }
            let extent = EllipseExtent { ellipse: e, limit };
            let radius = limit.sqrt();
            let vertical = Vec3::new(e.sigma_v, e.shear * e.sigma_u, 0.0).length();
            let (x, end_x) = tile_range(e.x, radius * e.sigma_u, width);
            let (y, end_y) = tile_range(e.y, radius * vertical, height);
            if end_x > x && end_y > y {
                cover.x = x;
                cover.y = y;
                cover.width = end_x - x;
                cover.height = end_y - y;
                let (low, high) = covered_cells(&cover, &extent, width, height);
                cover.low = low;
                cover.high = high;
                if (low | high) != 0 {
                    key = u32::reinterpret(e.depth);
                } else {
                    cover.width = 0;
                }
            }
        }
        cover.store(covers, gaussian);
        keys[gaussian] = key;
    }
}

/// Returns the bits of the cells that the ellipse reaches.
#[cube]
fn covered_cells(cover: &TileCoverage, extent: &EllipseExtent, width: u32, height: u32) -> (u32, u32) {
    let mut low = 0u32;
    let mut high = 0u32;
    let (cell_width, cell_height) = (cover.cell_width(), cover.cell_height());
    let mut bits_of_row = 0u32;
    let mut y = 0u32;
    while y < cover.height {
        let mut bit = bits_of_row;
        let mut x = 0u32;
        while x < cover.width {
            let first_x = (cover.x + x) * comptime!(TILE_SIZE as u32);
            let first_y = (cover.y + y) * comptime!(TILE_SIZE as u32);
            let end_x = (cover.x + min(x + cell_width, cover.width)) * comptime!(TILE_SIZE as u32);
            let end_y = (cover.y + min(y + cell_height, cover.height)) * comptime!(TILE_SIZE as u32);
            if extent.meets(first_x, min(end_x, width), first_y, min(end_y, height)) {
                let mask = 1u32 << (bit & 31);
                if bit < 32 {
                    low |= mask;
                } else {
                    high |= mask;
                }
            }
            bit += 1;
            x += cell_width;
        }
        bits_of_row += comptime!(CELLS);
        y += cell_height;
    }
    (low, high)
}
