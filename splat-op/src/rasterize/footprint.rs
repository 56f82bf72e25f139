//! Footprint of a Gaussian in the CPU twin's loops over a tile's pixels: its extent and its whitened coordinates.

use fearless_simd::prelude::*;

use crate::intersect::TILE;
use crate::intersect::extent::{half_extent, widened_limit};
use crate::project::Ellipse;
use crate::simd::real::Real;

/// Number of pixels along a row of a block.
pub(crate) const WIDTH: usize = 8;

/// Number of rows of a block. The widest SIMD vectors hold a block's 16 pixels; narrower ones hold a part of it.
pub(crate) const ROWS: usize = 2;

/// Number of blocks along a row of a tile.
const COLUMNS: usize = TILE / WIDTH;

/// `√(log₂e / 2)`. In whitened coordinates scaled by it, a Gaussian is `2^−(u² + v²)`.
pub(crate) const WHITEN: f64 = 0.849_321_800_288_019_1;

/// Inverse of [`WHITEN`]. It takes the scale out of a sum again, once for each scaled factor of its terms.
pub(super) const UNWHITEN: f64 = 1.0 / WHITEN;

/// An ellipse in the form that the loop over pixels multiplies by.
#[derive(Clone, Copy, Default)]
pub(super) struct Footprint<F> {
    pub mean_px: [F; 2],
    /// Scaled by [`WHITEN`], like `inverse_v`.
    pub inverse_u: F,
    pub inverse_v: F,
    pub shear: F,
    pub opacity: F,
    /// Largest `u² + v²`: beyond it the alpha is certainly below `alpha_min`, or not a number.
    pub extent: F,
    /// Half the width and height of the bounding box, px.
    pub half: [F; 2],
}

impl<F: Real> Footprint<F> {
    pub fn new(ellipse: &Ellipse<F>, alpha_min: F) -> Self {
        let limit = widened_limit(ellipse.opacity, alpha_min);
        Self {
            mean_px: ellipse.mean_px,
            inverse_u: F::of(WHITEN) / ellipse.sigma_u,
            inverse_v: F::of(WHITEN) / ellipse.sigma_v,
            shear: ellipse.shear,
            opacity: ellipse.opacity,
            extent: (limit * F::of(WHITEN * WHITEN)).min_of(F::EXP2_MAX),
            half: half_extent(ellipse, limit),
        }
    }

    /// Returns the window of the bounding box in the tile at `origin` px.
    #[inline(always)]
    pub fn window(&self, origin: [F; 2]) -> TileWindow {
        TileWindow::of(self.mean_px, self.half, origin)
    }
}

impl TileWindow {
    /// Returns the rows, and the columns of blocks, of the tile at `origin` px that the box around `middle` meets, px, of
    /// half the size `half`. The range of rows is extended to multiples of [`ROWS`].
    #[inline(always)]
    pub fn of<F: Real>(middle: [F; 2], half: [F; 2], origin: [F; 2]) -> Self {
        // Pixel `i` has its centre at `origin + i + 0.5`; the margin covers rounding.
        let span = |axis: usize| {
            let margin = F::of(0.01) + F::of(8.0) * F::EPSILON * (middle[axis].abs() + half[axis]);
            let centre = middle[axis] - origin[axis] - F::of(0.5);
            let last = F::of((TILE - 1) as f64);
            let low = (centre - half[axis] - margin).within(F::ZERO, last + F::ONE);
            let high = (centre + half[axis] + margin).within(-F::ONE, last);
            // Truncation only lowers `low`; `high + 1` is positive or zero.
            (low.index(), (high + F::ONE).index())
        };
        let ((first_pixel, end_pixel), (first_row, end_row)) = (span(0), span(1));
        Self {
            first_row: first_row - first_row % ROWS,
            end_row: end_row.next_multiple_of(ROWS),
            first_column: first_pixel / WIDTH,
            end_column: end_pixel.div_ceil(WIDTH).min(COLUMNS),
        }
    }
}

/// Rectangle within a tile, in rows and columns of blocks.
#[derive(Clone, Copy)]
pub(crate) struct TileWindow {
    pub first_row: usize,
    pub end_row: usize,
    pub first_column: usize,
    pub end_column: usize,
}

/// A Gaussian's constants, one copy in each lane.
#[derive(Clone, Copy)]
pub(super) struct FootprintSimd<S: Simd, F: Real> {
    pub footprint: Footprint<F>,
    mean_x: F::Block<S>,
    /// Offset along y of the centres of the tile's first row from the mean, px.
    rise: F::Block<S>,
    pub inverse_u: F::Block<S>,
    pub inverse_v: F::Block<S>,
    shear: F::Block<S>,
    pub opacity: F::Block<S>,
    pub extent: F::Block<S>,
}

impl<S: Simd, F: Real> FootprintSimd<S, F> {
    /// Constants of a Gaussian for the tile whose upper border is at `top` px.
    #[inline(always)]
    pub fn new(simd: S, footprint: Footprint<F>, top: F) -> Self {
        let lanes = |value| F::Block::<S>::splat(simd, value);
        Self {
            footprint,
            mean_x: lanes(footprint.mean_px[0]),
            rise: lanes(top + F::of(0.5) - footprint.mean_px[1]),
            inverse_u: lanes(footprint.inverse_u),
            inverse_v: lanes(footprint.inverse_v),
            shear: lanes(footprint.shear),
            opacity: lanes(footprint.opacity),
            extent: lanes(footprint.extent),
        }
    }

    /// Returns the values of the pixels with centres `x`, px, that do not depend on their rows.
    #[inline(always)]
    pub fn column(&self, x: F::Block<S>) -> Column<S, F> {
        let dx = x - self.mean_x;
        let u = dx * self.inverse_u;
        Column { dx, u, square: u * u }
    }

    /// Returns `v`, scaled by [`WHITEN`], of the pixels of `column` on the rows `row` of the tile.
    #[inline(always)]
    pub fn v(&self, column: &Column<S, F>, row: F::Block<S>) -> F::Block<S> {
        // The sum comes before the scaling, so that `v` is exactly zero at the mean.
        (-self.shear).mul_add(column.dx, self.rise + row) * self.inverse_v
    }
}

/// Values of a Gaussian at a vector of pixels that do not depend on their rows.
#[derive(Clone, Copy)]
pub(super) struct Column<S: Simd, F: Real> {
    /// Scaled by [`WHITEN`].
    pub u: F::Block<S>,
    /// `u²`
    pub square: F::Block<S>,
    dx: F::Block<S>,
}
