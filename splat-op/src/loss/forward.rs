//! Kernels of the four passes of the loss and of the plain window. A unit holds a strip of values along the axis of its
//! pass.

use cubecl::prelude::*;

use super::taps::{C1, C2, TAPS, half_window};
use crate::gpu::UNITS;
use crate::gpu::reduce::cube_sum;

/// Number of taps on one side of the middle.
pub(super) const HALF: usize = TAPS / 2;

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
        sum += comptime!(taps[d]) * (values[comptime!(middle - d)] + values[comptime!(middle + d)]);
    }
    sum + values[middle] * comptime!(taps[0])
}

/// Applies the window along one axis.
#[cube(launch_unchecked)]
pub(super) fn window_kernel(from: &[f32], to: &mut [f32], planes: Planes, #[comptime] vertical: bool) {
    let (own, strip) = (own_strip(planes, vertical), comptime!(strip_of(vertical)));
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
    /// Computes the index from `μx`, `P`, `Q`, and the photograph's mean and `σy² + C2`. `share` is `1/N`.
    pub fn of(mean_x: f32, own: f32, both: f32, mean_y: f32, variance_y: f32, share: f32) -> Similarity {
        let rest_x = 1.0 - mean_x;
        let rest_y = 1.0 - mean_y;
        let a1 = 2.0 * mean_x * mean_y + comptime!(C1 as f32);
        let a2 = mean_x * rest_y + mean_y * rest_x - both + comptime!(C2 as f32);
        let b1 = mean_x * mean_x + mean_y * mean_y + comptime!(C1 as f32);
        let b2 = mean_x * rest_x - own + variance_y;
        let inverse = 2.0 * share / (b1 * b2);
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
                let found = Similarity::of(mean_x, own, both, mean_y[at], variance_y[at], weights.share);
                let apart = (image[at] - truth[at]).abs();
                share += weights.absolute * apart + weights.lambda * (weights.share - 0.5 * found.index);
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
const AT_ONCE: usize = 8;

/// Writes the sum of the cubes' shares, by one cube.
#[cube(launch_unchecked)]
pub(super) fn total_kernel(shares: &[f32], total: &mut [f32], cubes: u32) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    let mut own = 0.0f32;
    let mut first = UNIT_POS;
    while first < cubes {
        #[unroll]
        for i in 0..comptime!(AT_ONCE) {
            let cube = first + comptime!((i * UNITS) as u32);
            own += select(cube < cubes, shares[min(cube, cubes - 1) as usize], 0.0);
        }
        first += comptime!((AT_ONCE * UNITS) as u32);
    }
    let sum = cube_sum(own, &mut shared);
    if UNIT_POS == 0 {
        total[0] = sum;
    }
}

/// Applies the window along the rows of the three derivatives, whose columns are already filtered. Writes the gradient
/// of the loss.
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
