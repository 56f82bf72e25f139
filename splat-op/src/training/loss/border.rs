//! `1 − μ` of the CPU twin, with its digits near the border of a white picture.

use fearless_simd::prelude::*;

use super::sweep::{PlaneSize, Sweep, splat};
use super::taps::{HALF, TAPS, half_window};
use crate::simd::{LANES, Real, dispatch};

/// The excess `e` at the pixels whose window leaves the picture; see [`super`].
pub(super) struct Excess<F> {
    /// Vector by vector, a row for each row of a picture that the window leaves, and one for all rows between them.
    rows: Vec<[F; LANES]>,
    size: PlaneSize,
}

impl<F: Real> Excess<F> {
    /// The excess for planes of a size.
    pub fn new(size: PlaneSize) -> Self {
        let height = size.height.min(TAPS);
        let [above, aside] = [height, size.width].map(|len| (0..len).map(|at| beyond(at, len)).collect::<Vec<f64>>());
        let mut rows = Vec::with_capacity(height * size.width.div_ceil(LANES));
        dispatch!(F, simd => {
            let mut sweep = Sweep::<F, 1>::new(size.width);
            let fill = |_, [to]: [&mut [F]; 1]| to.fill(F::ONE);
            sweep.run(simd, 0..height, height, fill, #[inline(always)] |row, column, [ones]| {
                let mut excess = [F::ZERO; LANES];
                for (lane, aside) in aside[column..].iter().take(LANES).enumerate() {
                    let beyond = F::of(above[row] + aside * (1.0 - above[row]));
                    excess[lane] = ((ones[lane] - F::ONE) + beyond) / ones[lane];
                }
                rows.push(excess);
            });
        });
        Self { rows, size }
    }

    /// Returns `1 − μ` for the means `μ` of a vector of pixels, the first at `column` of `row`.
    #[inline(always)]
    pub fn rest<S: Simd, const N: usize>(
        &self,
        simd: S,
        [row, column]: [usize; 2],
        means: [F::Eight<S>; N],
    ) -> [F::Eight<S>; N] {
        let PlaneSize { width, height } = self.size;
        let mut rest = means;
        for (rest, mean) in rest.iter_mut().zip(means) {
            *rest = splat(simd, F::ONE) - mean;
        }
        let inside = row >= HALF && row + HALF < height && column >= HALF && column + LANES + HALF <= width;
        if !inside {
            let like = row.min(HALF).max((row + height.min(TAPS)).saturating_sub(height));
            let excess = F::Eight::<S>::from_slice(simd, &self.rows[like * width.div_ceil(LANES) + column / LANES]);
            for (rest, mean) in rest.iter_mut().zip(means) {
                *rest = mean.mul_add(excess, *rest);
            }
        }
        rest
    }
}

/// Returns the share of the window that lies beyond the ends of a line of `len` values, around the value `at`. The smallest weights
/// come first, so that a small share keeps its digits.
fn beyond(at: usize, len: usize) -> f64 {
    let taps = half_window();
    let outside = |d: usize| usize::from(at < d) + usize::from(at + d >= len);
    (1..=HALF).rev().map(|d| outside(d) as f64 * taps[d]).sum()
}
