//! A layer at the pixels of a unit, on a driver in software: four pixels of a row at a time, as one vector. For few channels.
//!
//! Vectors keep what the kernels say of a pixel short, and nothing more: such a driver takes them apart. It loads and stores the
//! four numbers one by one, and its compiler puts one pixel's chain of instructions behind the other again.

#![allow(clippy::too_many_arguments, reason = "functions of a kernel take what it was launched with")]

use cubecl::prelude::*;

use super::layer::{Footprint, Limits, Shape};
use super::power::power;
use crate::tile::{TILE, TILE_PIXELS};

/// Four numbers, in most cases of four pixels side by side.
pub(super) type Quad = Vector<f32, Const<4>>;

/// Pixels of a [`Quad`].
pub(super) const QUAD: usize = 4;

/// Quads of a tile, row by row, and of one of its rows.
pub(super) const TILE_QUADS: usize = TILE_PIXELS / QUAD;
pub(super) const ROW_QUADS: usize = TILE / QUAD;

/// `√(log₂(e)/2)`: `u` and `v` times this are such that `exp(−(u² + v²)/2) = 2^−(u² + v²)`.
const TO_BINARY: f32 = 0.849_321_8;

/// Above every alpha.
const NEVER: f32 = 2.0;

/// The numbers `first, first + 1, first + 2, first + 3`.
#[cube]
pub(super) fn ascending(first: f32) -> Quad {
    let mut quad = Quad::new(first);
    quad.insert(1usize, first + 1.0);
    quad.insert(2usize, first + 2.0);
    quad.insert(3usize, first + 3.0);
    quad
}

/// The sum of the four.
#[cube]
pub(super) fn across(quad: Quad) -> f32 {
    (quad.extract(0usize) + quad.extract(1usize)) + (quad.extract(2usize) + quad.extract(3usize))
}

/// As many numbers for each of four arrays, one after the other: a driver's compiler takes time with the square of the numbers
/// that it sets to zero at once, so arrays are short and a loop follows each.
#[cube]
pub(super) fn quads_of(value: f32, #[comptime] len: usize) -> Sequence<Array<f32>> {
    let mut arrays = Sequence::<Array<f32>>::new();
    #[unroll]
    for _ in 0..QUAD {
        let mut values = Array::<f32>::new(len);
        for i in 0..comptime!(len as u32) {
            values[i as usize] = value;
        }
        arrays.push(values);
    }
    arrays
}

/// Quad `at` of four arrays, a number of each.
#[cube]
pub(super) fn gather(from: &Sequence<Array<f32>>, at: usize) -> Quad {
    let mut quad = Quad::new(from[0][at]);
    #[unroll]
    for k in 1..QUAD {
        quad.insert(k, from[k][at]);
    }
    quad
}

/// Writes quad `at` of four arrays.
#[cube]
pub(super) fn scatter(to: &mut Sequence<Array<f32>>, at: usize, quad: Quad) {
    #[unroll]
    for k in 0..QUAD {
        to.index_mut(k)[at] = quad.extract(k);
    }
}

/// [`power`] of each of the four.
#[cube]
fn powers(q: Quad) -> Quad {
    let mut found = Quad::new(0.0);
    #[unroll]
    for k in 0..QUAD {
        found.insert(k, power(q.extract(k)));
    }
    found
}

/// What the rows of a block have in common of a Gaussian.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(super) struct Columns {
    /// `u √(log₂(e)/2)` in each column, and its square.
    pub u: Quad,
    uu: Quad,
    /// How far each column's pixel in the tile's first row lies below the ellipse's axis, px.
    pub below: Quad,
    /// Of one px, `v √(log₂(e)/2)`.
    inverse_v: f32,
    opacity: f32,
}

#[cube]
impl Columns {
    /// In columns at `x` px, of a tile whose first row lies at `top` px. Rounds as [`Footprint::along_column`] does.
    pub fn of(footprint: &Footprint, x: Quad, top: f32) -> Columns {
        let dx = x - Quad::new(footprint.x);
        let u = dx * Quad::new(footprint.inverse_u * TO_BINARY);
        let below = Quad::new(top - footprint.y) - Quad::new(footprint.shear) * dx;
        Columns { u, uu: u * u, below, inverse_v: footprint.inverse_v * TO_BINARY, opacity: footprint.opacity }
    }

    /// `v √(log₂(e)/2)`, `row` rows below the tile's first one.
    pub fn v(&self, row: f32) -> Quad {
        (self.below + Quad::new(row)) * Quad::new(self.inverse_v)
    }

    /// As [`Self::v`] of columns that are no longer there, from the ellipse's `inverse_v`.
    pub fn v_of(below: Quad, inverse_v: f32, row: f32) -> Quad {
        (below + Quad::new(row)) * Quad::new(inverse_v * TO_BINARY)
    }

    /// `u` and `v` of one from those that this holds.
    pub fn unit() -> f32 {
        comptime!(1.0 / TO_BINARY).runtime()
    }

    /// The alpha at `v`; zero below `least`.
    fn alpha(&self, v: Quad, least: Quad, alpha_max: f32, #[comptime] shape: Shape) -> Quad {
        let share = if comptime!(shape.polynomial) {
            powers(self.uu + v * v)
        } else {
            (-(self.uu + v * v) * Quad::new(core::f32::consts::LN_2)).exp()
        };
        let value = share * Quad::new(self.opacity);
        let most = Quad::new(alpha_max);
        let value = select_many(value.less_than(&most), value, most);
        select_many(value.greater_equal(&least), value, Quad::new(0.0))
    }
}

/// How far a pass through a bucket has come at a unit's pixels, in quads. The contract of each number is that of
/// [`super::layer::layer`], but what is let through stays positive, and a finished pixel has an alpha that shows at least
/// which none reaches.
#[derive(CubeType)]
pub(super) struct Quads {
    /// The transmittance before the bucket, negative where the pixel was finished.
    pub before: Array<Quad>,
    pub through: Array<Quad>,
    pub stopped: Array<Quad>,
    least: Array<Quad>,
}

#[cube]
impl Quads {
    /// Of pixels that [`Self::open`] is still to be called for.
    pub fn new(#[comptime] quads: usize) -> Quads {
        Quads {
            before: Array::<Quad>::new(quads),
            through: Array::<Quad>::new(quads),
            stopped: Array::<Quad>::new(quads),
            least: Array::<Quad>::new(quads),
        }
    }

    /// Goes to the front of a bucket.
    pub fn open(&mut self, before: Quad, alpha_min: f32, #[comptime] q: usize) {
        self.before[q] = before;
        self.through[q] = Quad::new(1.0);
        self.stopped[q] = Quad::new(0.0);
        self.least[q] = select_many(before.greater_equal(&Quad::new(0.0)), Quad::new(alpha_min), Quad::new(NEVER));
    }

    /// Passes a Gaussian: its alpha, zero where it does not contribute, and that times what the bucket's layers before it let
    /// through.
    pub fn pass(
        &mut self,
        columns: &Columns,
        v: Quad,
        limits: Limits,
        #[comptime] shape: Shape,
        #[comptime] q: usize,
    ) -> (Quad, Quad) {
        let (through, stopped, least) = (self.through[q], self.stopped[q], self.least[q]);
        let zero = Quad::new(0.0);
        let alpha = columns.alpha(v, least, limits.alpha_max, shape);
        let stops = alpha * through + stopped;
        let next = select_many(stops.less_than(&Quad::new(0.5)), Quad::new(1.0) - stops, through - alpha * through);
        let finishes = (self.before[q] * next).less_equal(&Quad::new(limits.transmittance_min));
        let alpha = select_many(finishes, zero, alpha);
        self.through[q] = select_many(finishes, through, next);
        self.stopped[q] = select_many(finishes, stopped, stops);
        self.least[q] = select_many(finishes, Quad::new(NEVER), least);
        (alpha, alpha * through)
    }

    /// As [`super::layer::checkpoint`].
    pub fn checkpoint(&self, #[comptime] q: usize) -> Quad {
        let (through, stopped) = (self.through[q], self.stopped[q]);
        let tiny = Quad::new(f32::MIN_POSITIVE);
        let through = select_many(through.greater_than(&tiny), through, tiny);
        let open = select_many(stopped.less_than(&Quad::new(0.5)), stopped, -through);
        select_many(self.least[q].less_than(&Quad::new(NEVER)), open, Quad::new(NEVER))
    }

    /// As [`super::layer::restore`].
    pub fn restore(&mut self, from: Quad, alpha_min: f32, #[comptime] q: usize) {
        let one = Quad::new(1.0);
        let faint = from.greater_equal(&Quad::new(0.0));
        self.through[q] = select_many(faint, one - from, -from);
        self.stopped[q] = select_many(faint, from, one);
        self.least[q] = select_many(from.less_than(&Quad::new(NEVER)), Quad::new(alpha_min), Quad::new(NEVER));
    }

    /// As [`super::layer::behind_bucket`].
    pub fn behind(&self, #[comptime] q: usize) -> Quad {
        let (before, through, stopped) = (self.before[q], self.through[q], self.stopped[q]);
        let left = select_many(stopped.less_than(&Quad::new(0.5)), before - stopped * before, before * through);
        let left = select_many(self.least[q].less_than(&Quad::new(NEVER)), left, -left);
        select_many(before.greater_equal(&Quad::new(0.0)), left, before)
    }
}
