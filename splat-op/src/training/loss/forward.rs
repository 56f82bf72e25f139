//! Kernels of the passes of the loss and of a photograph's moments. A unit holds a strip of values along the axis of its pass.

use cubecl::prelude::*;

use super::taps::{C1, C2, HALF, TAPS, half_window};
use crate::gpu::{UNITS, cube_sum};

/// Returns the number of values of a unit. Neighbouring units read a row together, so each takes one value of it.
pub(super) const fn strip_of(vertical: bool) -> usize {
    if vertical { 8 } else { 1 }
}

/// Width and height of the planes, and their number.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Planes {
    pub width: u32,
    pub height: u32,
    pub count: u32,
}

/// Weights of the loss's terms.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct TermWeights {
    /// `(1 − λ)/N`
    pub absolute: f32,
    /// `λ`
    pub lambda: f32,
    /// `1/N`
    pub share: f32,
    /// One, as a number that compilers do not know: Mesa's move constants to the end of a sum, where they take the digits of the others.
    pub one: f32,
}

/// Strip of values of a unit.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct UnitStrip {
    /// Index of the first value of its line, and step from value to value along the line.
    base: usize,
    stride: usize,
    /// Position of its first value on the line, and number of values on the line.
    first: u32,
    len: u32,
    /// Whether the unit has a strip.
    exists: bool,
}

/// Returns the strip of this unit: down a column if `vertical`, else along a row.
#[cube]
fn own_strip(planes: Planes, #[comptime] vertical: bool) -> UnitStrip {
    let strip = comptime!(strip_of(vertical));
    let unit = ABSOLUTE_POS as u32;
    let mut len = planes.width;
    if comptime!(vertical) {
        len = planes.height;
    }
    let blocks = (len + comptime!(strip as u32 - 1)) / comptime!(strip as u32);
    // Neighbouring units take neighbouring columns, or neighbouring blocks of a row.
    let mut first = unit % blocks * comptime!(strip as u32);
    let mut line = unit / blocks;
    let mut base = line * planes.width;
    let mut stride = 1u32;
    if comptime!(vertical) {
        first = unit / planes.width % blocks * comptime!(strip as u32);
        line = unit / planes.width / blocks * planes.height;
        base = line * planes.width + unit % planes.width;
        stride = planes.width;
    }
    let exists = line < planes.height * planes.count;
    UnitStrip { base: base as usize, stride: stride as usize, first, len, exists }
}

#[cube]
impl UnitStrip {
    /// Loads the strip's values and those that the window reaches on both sides; zero outside the picture.
    fn load(&self, from: &[f32], offset: usize, #[comptime] strip: usize) -> Array<f32> {
        let mut values = Array::<f32>::new(comptime!(strip + 2 * HALF));
        #[unroll]
        for i in 0..comptime!(strip + 2 * HALF) {
            let place = self.first + comptime!(i as u32);
            values[i] = 0.0f32;
            if place >= comptime!(HALF as u32) && place < self.len + comptime!(HALF as u32) {
                values[i] = from[offset + self.base + (place - comptime!(HALF as u32)) as usize * self.stride];
            }
        }
        values
    }

    /// Returns the index of the strip's value `i`.
    fn at(&self, #[comptime] i: usize) -> usize {
        self.base + (self.first + comptime!(i as u32)) as usize * self.stride
    }

    fn holds(&self, #[comptime] i: usize) -> bool {
        self.first + comptime!(i as u32) < self.len
    }
}

/// Returns the window applied at value `i` of a strip. The smallest weights come first, so that only the last two sums are
/// rounded to the ulp of the result.
#[cube]
fn windowed(values: &Array<f32>, #[comptime] i: usize) -> f32 {
    let taps = comptime!(half_window().map(|tap| tap as f32));
    let middle = comptime!(i + HALF);
    let mut sum = comptime!(taps[HALF]) * (values[i] + values[comptime!(middle + HALF)]);
    #[unroll]
    for k in 1..comptime!(HALF) {
        let d = comptime!(HALF - k);
        sum = fma(f32::new(comptime!(taps[d])), values[comptime!(middle - d)] + values[comptime!(middle + d)], sum);
    }
    fma(values[middle], f32::new(comptime!(taps[0])), sum)
}

/// Returns the window around value `at` of a line of `len` values that are `value`, rounded as every window is, and its share beyond
/// the line.
#[cube]
fn window_of_equals(value: f32, at: u32, len: u32) -> (f32, f32) {
    let taps = comptime!(half_window().map(|tap| tap as f32));
    let mut values = Array::<f32>::new(comptime!(TAPS));
    let mut beyond = 0.0f32;
    values[comptime!(HALF)] = value;
    #[unroll]
    for k in 0..comptime!(HALF) {
        let d = comptime!(HALF - k);
        let (before, behind) = (at >= comptime!(d as u32), at + comptime!(d as u32) < len);
        values[comptime!(HALF - d)] = select(before, value, 0.0);
        values[comptime!(HALF + d)] = select(behind, value, 0.0);
        beyond += select(before, 0.0, comptime!(taps[d])) + select(behind, 0.0, comptime!(taps[d]));
    }
    (windowed(&values, 0usize), beyond)
}

/// Whether the window around value `at` of a line of `len` values leaves the line.
#[cube]
fn leaves(at: u32, len: u32) -> bool {
    at < comptime!(HALF as u32) || at + comptime!(HALF as u32) >= len
}

/// Returns the excess at the value with this index; see [`super`].
#[cube]
fn excess_at(index: usize, planes: &Planes, one: f32) -> f32 {
    let (column, row) = (index as u32 % planes.width, index as u32 / planes.width % planes.height);
    let mut excess = 0.0f32;
    if leaves(column, planes.width) || leaves(row, planes.height) {
        let (down, above) = window_of_equals(one, row, planes.height);
        let (ones, aside) = window_of_equals(down, column, planes.width);
        excess = ((ones - one) + fma(aside, one - above, above)) / ones;
    }
    excess
}

/// Applies the window down the columns.
#[cube(launch_unchecked)]
pub(super) fn columns_kernel(from: &[f32], to: &mut [f32], planes: Planes) {
    let (own, strip) = (own_strip(planes, true), comptime!(strip_of(true)));
    if own.exists {
        let values = own.load(from, 0usize, strip);
        #[unroll]
        for i in 0..strip {
            if own.holds(i) {
                to[own.at(i)] = windowed(&values, i);
            }
        }
    }
}

/// Applies the window down the columns of `x`, `x(1 − x)` and `x(1 − y) + y(1 − x)`. Writes `moments`, `[3, C, H, W]`.
#[cube(launch_unchecked)]
pub(super) fn moments_kernel(image: &[f32], truth: &[f32], moments: &mut [f32], planes: Planes) {
    let (own, strip) = (own_strip(planes, true), comptime!(strip_of(true)));
    if own.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let x = own.load(image, 0usize, strip);
        let y = own.load(truth, 0usize, strip);
        let mut own_moment = Array::<f32>::new(comptime!(strip + 2 * HALF));
        let mut both = Array::<f32>::new(comptime!(strip + 2 * HALF));
        #[unroll]
        for i in 0..comptime!(strip + 2 * HALF) {
            own_moment[i] = x[i] * (1.0 - x[i]);
            both[i] = x[i] * (1.0 - y[i]) + y[i] * (1.0 - x[i]);
        }
        #[unroll]
        for i in 0..strip {
            if own.holds(i) {
                let at = own.at(i);
                moments[at] = windowed(&x, i);
                moments[map + at] = windowed(&own_moment, i);
                moments[2 * map + at] = windowed(&both, i);
            }
        }
    }
}

/// Applies the window along the rows of the first two of a photograph's three moments. Writes `μy` and `σy² + C2`, `[C, H, W]`. `one` is
/// that of [`TermWeights`].
#[cube(launch_unchecked)]
pub(super) fn photograph_kernel(moments: &[f32], mean: &mut [f32], variance: &mut [f32], planes: Planes, one: f32) {
    let (own, strip) = (own_strip(planes, false), comptime!(strip_of(false)));
    if own.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let m = own.load(moments, 0usize, strip);
        let mm = own.load(moments, map, strip);
        #[unroll]
        for i in 0..strip {
            if own.holds(i) {
                let at = own.at(i);
                let mean_y = windowed(&m, i);
                let rest_y = fma(mean_y, excess_at(at, &planes, one), one - mean_y);
                mean[at] = mean_y;
                variance[at] = fma(mean_y, rest_y, -windowed(&mm, i)) + comptime!(C2 as f32);
            }
        }
    }
}

/// The index of one value, `2 S/N`, and its derivatives with respect to `μx`, `Kx²` (twice) and `Kxy`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Similarity {
    pub index: f32,
    pub d_mean: f32,
    pub twice_d_xx: f32,
    pub d_xy: f32,
}

#[cube]
impl Similarity {
    /// Computes the index from `μx`, `P`, `Q`, the photograph's mean and `σy² + C2`, and the excess. Products that are added are `fma`,
    /// so that the index has the same bits with and without its derivatives.
    pub fn of(
        mean_x: f32,
        own: f32,
        both: f32,
        mean_y: f32,
        variance_y: f32,
        excess: f32,
        weights: &TermWeights,
    ) -> Similarity {
        let rest_x = fma(mean_x, excess, weights.one - mean_x);
        let rest_y = fma(mean_y, excess, weights.one - mean_y);
        let a1 = fma(2.0 * mean_x, mean_y, comptime!(C1 as f32));
        // The constant comes last: beside one it would lose its digits.
        let a2 = fma(mean_x, rest_y, fma(mean_y, rest_x, -both)) + comptime!(C2 as f32);
        let b1 = fma(mean_x, mean_x, fma(mean_y, mean_y, comptime!(C1 as f32)));
        let b2 = fma(mean_x, rest_x, -own) + variance_y;
        let inverse = 2.0 * weights.share / (b1 * b2);
        let d_xy = inverse * a1;
        let index = d_xy * a2;
        let twice_d_xx = -(index / b2);
        let d_mean = (a2 - a1) * inverse * mean_y - (index / b1 + twice_d_xx) * mean_x;
        Similarity { index, d_mean, twice_d_xx, d_xy }
    }
}

/// Applies the window along the rows of the three moments. Writes each cube's share of the loss, `[cubes]`, and, if they are
/// asked for, the derivatives of `2 S/N` with respect to `μx`, `Kx²` (twice) and `Kxy`, `[3, C, H, W]`.
#[cube(launch_unchecked)]
pub(super) fn index_kernel(
    image: &[f32],
    truth: &[f32],
    mean_y: &[f32],
    variance_y: &[f32],
    moments: &[f32],
    shares: &mut [f32],
    mut derivatives: ComptimeOption<Box<[f32]>>,
    planes: Planes,
    weights: TermWeights,
    cubes: u32,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let (own, strip) = (own_strip(planes, false), comptime!(strip_of(false)));
    let mut share = 0.0f32;
    if own.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let m = own.load(moments, 0usize, strip);
        let mm = own.load(moments, map, strip);
        let mt = own.load(moments, 2 * map, strip);
        #[unroll]
        for i in 0..strip {
            if own.holds(i) {
                let at = own.at(i);
                let (mean_x, own, both) = (windowed(&m, i), windowed(&mm, i), windowed(&mt, i));
                let excess = excess_at(at, &planes, weights.one);
                let found = Similarity::of(mean_x, own, both, mean_y[at], variance_y[at], excess, &weights);
                let apart = (image[at] - truth[at]).abs();
                share += fma(weights.absolute, apart, weights.lambda * fma(-0.5, found.index, weights.share));
                #[comptime]
                if let ComptimeOption::Some(out) = &mut derivatives {
                    out[at] = found.d_mean;
                    out[map + at] = found.twice_d_xx;
                    out[2 * map + at] = found.d_xy;
                }
            }
        }
    }
    if CUBE_POS < cubes as usize {
        let total = cube_sum(share, &mut shared);
        if UNIT_POS == 0 {
            shares[CUBE_POS] = total;
        }
    }
}

/// Number of shares that a unit loads together.
const SHARES_AT_ONCE: usize = 8;

/// Writes the sum of the cubes' shares, by one cube.
#[cube(launch_unchecked)]
pub(super) fn total_kernel(shares: &[f32], total: &mut [f32], cubes: u32) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let mut own = 0.0f32;
    let mut first = UNIT_POS;
    while first < cubes {
        #[unroll]
        for i in 0..comptime!(SHARES_AT_ONCE) {
            let cube = first + comptime!((i * UNITS) as u32);
            own += select(cube < cubes, shares[min(cube, cubes - 1) as usize], 0.0);
        }
        first += comptime!((SHARES_AT_ONCE * UNITS) as u32);
    }
    let sum = cube_sum(own, &mut shared);
    if UNIT_POS == 0 {
        total[0] = sum;
    }
}

/// Applies the window along the rows of the three derivatives, whose columns are already filtered. Writes the gradient of the loss.
#[cube(launch_unchecked)]
pub(super) fn gradient_kernel(
    image: &[f32],
    truth: &[f32],
    derivatives: &[f32],
    gradient: &mut [f32],
    planes: Planes,
    weights: TermWeights,
) {
    let (own, strip) = (own_strip(planes, false), comptime!(strip_of(false)));
    if own.exists {
        let map = (planes.width * planes.height * planes.count) as usize;
        let d_mean = own.load(derivatives, 0usize, strip);
        let d_xx = own.load(derivatives, map, strip);
        let d_xy = own.load(derivatives, 2 * map, strip);
        #[unroll]
        for i in 0..strip {
            if own.holds(i) {
                let at = own.at(i);
                let (x, y) = (image[at], truth[at]);
                let similar = windowed(&d_mean, i) + windowed(&d_xx, i) * x + windowed(&d_xy, i) * y;
                // The subgradient of the absolute value is zero where the two are equal.
                let side = select(x > y, weights.absolute, select(x < y, -weights.absolute, 0.0));
                gradient[at] = side - weights.lambda * similar;
            }
        }
    }
}
