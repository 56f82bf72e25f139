//! Kernels of the slice: one unit per pixel, and for the gradient of the grid one cube per place of the grid, which adds up the
//! pixels around it in a fixed order.

use cubecl::prelude::*;

use super::{LUMA, MAP};
use crate::gpu::{UNITS, cube_sum, within};

/// Sizes of picture and grid.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Sizes {
    pub width: u32,
    pub height: u32,
    pub levels: u32,
    pub rows: u32,
    pub columns: u32,
}

#[cube]
impl Sizes {
    fn pixels(&self) -> usize {
        (self.width * self.height) as usize
    }
}

/// A colour with its luma.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct LumaColour {
    r: f32,
    g: f32,
    b: f32,
    luma: f32,
}

#[cube]
fn colour_at(image: &[f32], pixel: usize, sizes: Sizes) -> LumaColour {
    let plane = sizes.pixels();
    let (r, g, b) = (image[pixel], image[plane + pixel], image[2 * plane + pixel]);
    let luma = comptime!(LUMA[0] as f32) * r + comptime!(LUMA[1] as f32) * g + comptime!(LUMA[2] as f32) * b;
    LumaColour { r, g, b, luma }
}

/// The place of a pixel's centre along an axis of the grid.
#[cube]
fn place(pixel: u32, pixels: u32, count: u32) -> f32 {
    (f32::cast_from(pixel) + 0.5) / f32::cast_from(pixels) * f32::cast_from(count - 1)
}

/// The place of a luma along the levels.
#[cube]
fn level_place(luma: f32, levels: u32) -> f32 {
    within(luma, 0.0, 1.0) * f32::cast_from(levels - 1)
}

/// The lower neighbour of a place.
#[cube]
fn below(at: f32, count: u32) -> u32 {
    min(u32::cast_from(at), count - 2)
}

/// A pixel's corners in the grid: the lowest, and the shares of the upper neighbours.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Corners {
    first: usize,
    across: f32,
    down: f32,
    up: f32,
}

#[cube]
fn corners(pixel: u32, luma: f32, sizes: Sizes) -> Corners {
    let x = place(pixel % sizes.width, sizes.width, sizes.columns);
    let y = place(pixel / sizes.width, sizes.height, sizes.rows);
    let z = level_place(luma, sizes.levels);
    let column = below(x, sizes.columns);
    let row = below(y, sizes.rows);
    let level = below(z, sizes.levels);
    Corners {
        first: ((level * sizes.rows + row) * sizes.columns + column) as usize,
        across: x - f32::cast_from(column),
        down: y - f32::cast_from(row),
        up: z - f32::cast_from(level),
    }
}

/// An entry of the maps on the levels below and above a pixel.
#[cube]
fn entry_at(grid: &[f32], entry: usize, corners: Corners, sizes: Sizes) -> (f32, f32) {
    let level = (sizes.rows * sizes.columns) as usize;
    let columns = sizes.columns as usize;
    let lower = entry * sizes.levels as usize * level + corners.first;
    let upper = lower + level;
    let (a, b) = (grid[lower], grid[lower + columns]);
    let (c, d) = (grid[upper], grid[upper + columns]);
    let (a, b) = (a + corners.across * (grid[lower + 1] - a), b + corners.across * (grid[lower + columns + 1] - b));
    let (c, d) = (c + corners.across * (grid[upper + 1] - c), d + corners.across * (grid[upper + columns + 1] - d));
    (a + corners.down * (b - a), c + corners.down * (d - c))
}

#[cube(launch_unchecked)]
pub(super) fn slice_kernel(image: &[f32], grid: &[f32], out: &mut [f32], sizes: Sizes) {
    let pixel = ABSOLUTE_POS;
    if pixel < sizes.pixels() {
        let colour = colour_at(image, pixel, sizes);
        let corners = corners(pixel as u32, colour.luma, sizes);
        #[unroll]
        for to in 0..3usize {
            let mut sum = 0.0f32;
            #[unroll]
            for from in 0..4usize {
                let (lower, upper) = entry_at(grid, comptime!(4 * to + from), corners, sizes);
                let entry = lower + corners.up * (upper - lower);
                if comptime!(from == 0) {
                    sum += entry * colour.r;
                } else if comptime!(from == 1) {
                    sum += entry * colour.g;
                } else if comptime!(from == 2) {
                    sum += entry * colour.b;
                } else {
                    sum += entry;
                }
            }
            out[to * sizes.pixels() + pixel] = sum;
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn image_backward_kernel(image: &[f32], grid: &[f32], grad: &[f32], of_image: &mut [f32], sizes: Sizes) {
    let pixel = ABSOLUTE_POS;
    if pixel < sizes.pixels() {
        let colour = colour_at(image, pixel, sizes);
        let corners = corners(pixel as u32, colour.luma, sizes);
        let mut along = 0.0f32;
        let mut of_r = 0.0f32;
        let mut of_g = 0.0f32;
        let mut of_b = 0.0f32;
        #[unroll]
        for to in 0..3usize {
            let grad = grad[to * sizes.pixels() + pixel];
            #[unroll]
            for from in 0..4usize {
                let (lower, upper) = entry_at(grid, comptime!(4 * to + from), corners, sizes);
                let entry = lower + corners.up * (upper - lower);
                if comptime!(from == 0) {
                    of_r += entry * grad;
                    along += grad * colour.r * (upper - lower);
                } else if comptime!(from == 1) {
                    of_g += entry * grad;
                    along += grad * colour.g * (upper - lower);
                } else if comptime!(from == 2) {
                    of_b += entry * grad;
                    along += grad * colour.b * (upper - lower);
                } else {
                    along += grad * (upper - lower);
                }
            }
        }
        let free = colour.luma > 0.0 && colour.luma < 1.0;
        let of_luma = select(free, along * f32::cast_from(sizes.levels - 1), 0.0);
        of_image[pixel] = of_r + comptime!(LUMA[0] as f32) * of_luma;
        of_image[sizes.pixels() + pixel] = of_g + comptime!(LUMA[1] as f32) * of_luma;
        of_image[2 * sizes.pixels() + pixel] = of_b + comptime!(LUMA[2] as f32) * of_luma;
    }
}

/// The first pixel that may have a share in place `at` of an axis, and the number of such pixels.
#[cube]
fn reach(at: u32, pixels: u32, count: u32) -> (u32, u32) {
    let per_place = f32::cast_from(pixels) / f32::cast_from(count - 1);
    let at = f32::cast_from(at);
    // A pixel more on both sides covers rounding.
    let first = max((at - 1.0) * per_place - 1.5, 0.0);
    let end = min((at + 1.0) * per_place + 1.5, f32::cast_from(pixels));
    (u32::cast_from(first), u32::cast_from(end) - u32::cast_from(first))
}

/// The share of a place in what lies at `to` on an axis.
#[cube]
fn hat(at: u32, to: f32) -> f32 {
    max(1.0 - (to - f32::cast_from(at)).abs(), 0.0)
}

#[cube(launch_unchecked)]
pub(super) fn grid_backward_kernel(image: &[f32], grad: &[f32], of_grid: &mut [f32], sizes: Sizes) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let places = sizes.levels * sizes.rows * sizes.columns;
    if CUBE_POS < places as usize {
        let at = CUBE_POS as u32;
        let (column, row) = (at % sizes.columns, at / sizes.columns % sizes.rows);
        let level = at / (sizes.columns * sizes.rows);
        let (left, width) = reach(column, sizes.width, sizes.columns);
        let (top, height) = reach(row, sizes.height, sizes.rows);
        let mut sums = Array::<f32>::new(comptime!(MAP));
        #[unroll]
        for entry in 0..comptime!(MAP) {
            sums[entry] = 0.0;
        }
        let mut i = UNIT_POS;
        while i < width * height {
            let (x, y) = (left + i % width, top + i / width);
            let pixel = (y * sizes.width + x) as usize;
            let colour = colour_at(image, pixel, sizes);
            let weight = hat(column, place(x, sizes.width, sizes.columns))
                * hat(row, place(y, sizes.height, sizes.rows))
                * hat(level, level_place(colour.luma, sizes.levels));
            #[unroll]
            for to in 0..3usize {
                let grad = weight * grad[to * sizes.pixels() + pixel];
                sums[4 * to] += grad * colour.r;
                sums[4 * to + 1] += grad * colour.g;
                sums[4 * to + 2] += grad * colour.b;
                sums[4 * to + 3] += grad;
            }
            i += comptime!(UNITS as u32);
        }
        #[unroll]
        for entry in 0..comptime!(MAP) {
            let total = cube_sum(sums[entry], &mut shared);
            if UNIT_POS == 0 {
                of_grid[entry * places as usize + CUBE_POS] = total;
            }
        }
    }
}
