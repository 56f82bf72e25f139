//! The two sweeps of the loss on a driver in software. A unit goes down some columns of a part of a plane and carries what the
//! window has of the last rows along: such a driver takes fifty times as long to load or store a number as to add two,
//! and the four passes of `forward.rs` load five numbers and store three for each value between one direction of the window and
//! the other.

use cubecl::prelude::*;

use super::forward::{HALF, Planes, Similarity, Weights, Window};
use super::taps::TAPS;

/// Columns of a unit, and rows of its part. A part begins and ends with rows that its neighbours sweep too, a unit with
/// columns.
pub(super) const COLUMNS: usize = 16;
pub(super) const ROWS: usize = 96;

/// Units that sweep all planes.
pub(super) fn units([width, height]: [usize; 2], planes: usize) -> usize {
    width.div_ceil(COLUMNS) * height.div_ceil(ROWS) * planes
}

/// Where a unit sweeps.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Area {
    /// Where its plane begins.
    base: usize,
    first_column: u32,
    first_row: u32,
    /// Rows with those of the window above and below.
    rows: u32,
    exists: bool,
}

#[cube]
fn own_area(planes: Planes) -> Area {
    let unit = ABSOLUTE_POS as u32;
    let across = (planes.width + comptime!(COLUMNS as u32 - 1)) / comptime!(COLUMNS as u32);
    let down = (planes.height + comptime!(ROWS as u32 - 1)) / comptime!(ROWS as u32);
    let plane = unit / across / down;
    let first_row = unit / across % down * comptime!(ROWS as u32);
    Area {
        base: (plane * planes.width * planes.height) as usize,
        first_column: unit % across * comptime!(COLUMNS as u32),
        first_row,
        rows: min(planes.height - first_row, comptime!(ROWS as u32)) + comptime!(2 * HALF as u32),
        exists: plane < planes.count,
    }
}

#[cube]
impl Area {
    /// Row `row`, counted from the first that the window reaches, with the columns that it reaches; zero outside the picture.
    fn load(&self, from: &[f32], offset: usize, row: u32, planes: Planes) -> Array<f32> {
        let shifted = self.first_row + row;
        let inside = shifted >= comptime!(HALF as u32) && shifted < planes.height + comptime!(HALF as u32);
        let row = select(inside, shifted - comptime!(HALF as u32), 0u32);
        let at = offset + self.base + (row * planes.width) as usize;
        let mut values = Array::<f32>::new(comptime!(COLUMNS + 2 * HALF));
        #[unroll]
        for i in 0..comptime!(COLUMNS + 2 * HALF) {
            let place = self.first_column + comptime!(i as u32);
            values[i] = 0.0f32;
            if inside && place >= comptime!(HALF as u32) && place < planes.width + comptime!(HALF as u32) {
                values[i] = from[at + (place - comptime!(HALF as u32)) as usize];
            }
        }
        values
    }

    /// Where column `i` of row `row` lies that the window has just passed.
    fn at(&self, row: u32, planes: Planes, #[comptime] i: usize) -> usize {
        let row = self.first_row + row - comptime!(2 * HALF as u32);
        self.base + (row * planes.width + self.first_column + comptime!(i as u32)) as usize
    }

    fn holds(&self, planes: Planes, #[comptime] i: usize) -> bool {
        self.first_column + comptime!(i as u32) < planes.width
    }
}

/// What the window along the rows made of the last rows of a map, the newest last.
#[derive(CubeType)]
struct Carried {
    rows: Array<f32>,
}

#[cube]
impl Carried {
    fn new(#[comptime] rows: usize) -> Carried {
        let mut values = Array::<f32>::new(comptime!(rows * COLUMNS));
        #[unroll]
        for i in 0..comptime!(rows * COLUMNS) {
            values[i] = 0.0f32;
        }
        Carried { rows: values }
    }

    /// Lets go of the oldest of `rows` rows; the newest is to be [`Self::set`].
    fn advance(&mut self, #[comptime] rows: usize) {
        #[unroll]
        for i in 0..comptime!((rows - 1) * COLUMNS) {
            self.rows[i] = self.rows[comptime!(i + COLUMNS)];
        }
    }

    fn set(&mut self, value: f32, #[comptime] rows: usize, #[comptime] i: usize) {
        self.rows[comptime!((rows - 1) * COLUMNS + i)] = value;
    }

    /// The window down column `i`.
    fn down(&self, window: &Window, #[comptime] i: usize) -> f32 {
        let mut column = Array::<f32>::new(TAPS);
        #[unroll]
        for row in 0..TAPS {
            column[row] = self.rows[comptime!(row * COLUMNS + i)];
        }
        window.on(&column, 0usize)
    }
}

/// Each value's share of the loss, and, if asked for, the derivatives of `2 S/N` with respect to `μx`, `Kx²` (twice) and
/// `Kxy`, `[3, C, H, W]`.
#[cube(launch_unchecked)]
pub(super) fn index_sweep_kernel(
    image: &[f32],
    truth: &[f32],
    mean_y: &[f32],
    variance_y: &[f32],
    shares: &mut [f32],
    derivatives: &mut [f32],
    window: Window,
    planes: Planes,
    weights: Weights,
    #[comptime] with_gradient: bool,
) {
    let area = own_area(planes);
    if area.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let mut means = Carried::new(TAPS);
        let mut squares = Carried::new(TAPS);
        let mut products = Carried::new(TAPS);
        let mut apart = Carried::new(comptime!(HALF + 1));
        let mut row = 0u32;
        // With its test at its end: this driver's loops take a round more otherwise.
        loop {
            let x = area.load(image, 0usize, row, planes);
            let y = area.load(truth, 0usize, row, planes);
            let mut xx = Array::<f32>::new(comptime!(COLUMNS + 2 * HALF));
            let mut xy = Array::<f32>::new(comptime!(COLUMNS + 2 * HALF));
            #[unroll]
            for i in 0..comptime!(COLUMNS + 2 * HALF) {
                xx[i] = x[i] * x[i];
                xy[i] = x[i] * y[i];
            }
            means.advance(TAPS);
            squares.advance(TAPS);
            products.advance(TAPS);
            apart.advance(comptime!(HALF + 1));
            #[unroll]
            for i in 0..COLUMNS {
                means.set(window.on(&x, i), TAPS, i);
                squares.set(window.on(&xx, i), TAPS, i);
                products.set(window.on(&xy, i), TAPS, i);
                apart.set((x[comptime!(i + HALF)] - y[comptime!(i + HALF)]).abs(), comptime!(HALF + 1), i);
            }
            if row >= comptime!(2 * HALF as u32) {
                #[unroll]
                for i in 0..COLUMNS {
                    if area.holds(planes, i) {
                        let at = area.at(row, planes, i);
                        let mean_x = means.down(&window, i);
                        let (xx, xy) = (squares.down(&window, i), products.down(&window, i));
                        let found = Similarity::of(mean_x, xx, xy, mean_y[at], variance_y[at], weights.share);
                        let apart = apart.rows[i];
                        shares[at] = weights.absolute * apart + weights.lambda * (weights.share - 0.5 * found.index);
                        if comptime!(with_gradient) {
                            derivatives[at] = found.d_mean;
                            derivatives[map + at] = found.twice_d_xx;
                            derivatives[2 * map + at] = found.d_xy;
                        }
                    }
                }
            }
            row += 1;
            if row >= area.rows {
                break;
            }
        }
    }
}

/// The derivative of the loss from those of the index.
#[cube(launch_unchecked)]
pub(super) fn gradient_sweep_kernel(
    image: &[f32],
    truth: &[f32],
    derivatives: &[f32],
    gradient: &mut [f32],
    window: Window,
    planes: Planes,
    weights: Weights,
) {
    let area = own_area(planes);
    if area.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let mut by_mean = Carried::new(TAPS);
        let mut by_square = Carried::new(TAPS);
        let mut by_product = Carried::new(TAPS);
        let mut row = 0u32;
        loop {
            let mean = area.load(derivatives, 0usize, row, planes);
            let square = area.load(derivatives, map, row, planes);
            let product = area.load(derivatives, 2 * map, row, planes);
            by_mean.advance(TAPS);
            by_square.advance(TAPS);
            by_product.advance(TAPS);
            #[unroll]
            for i in 0..COLUMNS {
                by_mean.set(window.on(&mean, i), TAPS, i);
                by_square.set(window.on(&square, i), TAPS, i);
                by_product.set(window.on(&product, i), TAPS, i);
            }
            if row >= comptime!(2 * HALF as u32) {
                #[unroll]
                for i in 0..COLUMNS {
                    if area.holds(planes, i) {
                        let at = area.at(row, planes, i);
                        let (x, y) = (image[at], truth[at]);
                        let similar =
                            by_mean.down(&window, i) + by_square.down(&window, i) * x + by_product.down(&window, i) * y;
                        // The subgradient of the absolute value is zero where the two are equal.
                        let side = select(x > y, weights.absolute, select(x < y, -weights.absolute, 0.0));
                        gradient[at] = side - weights.lambda * similar;
                    }
                }
            }
            row += 1;
            if row >= area.rows {
                break;
            }
        }
    }
}
