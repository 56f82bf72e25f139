//! The filter of the CPU twin: it goes down pictures with a window of eleven rows.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::taps::{HALF, TAPS, half_window};
use crate::simd::{LANES, Real};

/// Size of a plane, px.
#[derive(Clone, Copy)]
pub(crate) struct PlaneSize {
    pub width: usize,
    pub height: usize,
}

impl PlaneSize {
    pub fn pixels(self) -> usize {
        self.width * self.height
    }

    /// Returns the index of the first value of a row of a plane.
    pub fn row(self, plane: usize, row: usize) -> usize {
        (plane * self.height + row) * self.width
    }
}

#[inline(always)]
pub(super) fn splat<S: Simd, F: Real>(simd: S, value: F) -> F::Eight<S> {
    F::Eight::<S>::splat(simd, value)
}

/// A filter that goes down `N` maps at once.
pub(super) struct Sweep<F, const N: usize> {
    /// A row of each map with [`HALF`] zeros before it and zeros behind it.
    padded: [Vec<F>; N],
    /// By map, for each vector of columns: the last [`TAPS`] rows, filtered along their length. Row `r` is in slot `r % TAPS` and again
    /// [`TAPS`] slots later, so that the rows that the window reaches are always adjacent: one bounds check serves all of them.
    slots: [Vec<[[F; LANES]; 2 * TAPS]>; N],
    width: usize,
}

impl<F: Real, const N: usize> Sweep<F, N> {
    pub fn new(width: usize) -> Self {
        let vectors = width.div_ceil(LANES);
        Self {
            padded: std::array::from_fn(|_| vec![F::ZERO; vectors * LANES + 2 * HALF]),
            slots: std::array::from_fn(|_| vec![[[F::ZERO; LANES]; 2 * TAPS]; vectors]),
            width,
        }
    }

    /// Filters rows `rows` of maps of `height` rows. `fill` writes a row of each map. `each` receives `row`, `column`
    /// and the filtered maps at that pixel and the seven pixels after it; values beyond the width mean nothing.
    #[inline(always)]
    pub fn run<S: Simd>(
        &mut self,
        simd: S,
        rows: Range<usize>,
        height: usize,
        mut fill: impl FnMut(usize, [&mut [F]; N]),
        mut each: impl FnMut(usize, usize, [F::Eight<S>; N]),
    ) {
        let width = self.width;
        let mut taps = [F::Eight::<S>::splat(simd, F::ZERO); HALF + 1];
        taps.iter_mut().zip(half_window()).for_each(|(lanes, tap)| *lanes = F::Eight::<S>::splat(simd, F::of(tap)));
        // Rows are counted from HALF above the first, so that none is negative.
        for place in rows.start..rows.end + 2 * HALF {
            let row = place.wrapping_sub(HALF);
            let inside = row < height;
            if inside {
                fill(row, self.padded.each_mut().map(|padded| &mut padded[HALF..HALF + width]));
            }
            for (padded, slots) in self.padded.iter().zip(&mut self.slots) {
                let near = padded.windows(LANES + 2 * HALF).step_by(LANES);
                for (near, slots) in near.zip(slots) {
                    let mut along = [F::ZERO; LANES];
                    if inside {
                        let at = |tap: usize| {
                            near[tap..].first_chunk().expect("as long as a vector and the window around it")
                        };
                        filtered(simd, &taps, at).store_slice(&mut along);
                    }
                    slots[place % TAPS] = along;
                    slots[place % TAPS + TAPS] = along;
                }
            }
            if place < rows.start + 2 * HALF {
                continue;
            }
            // The uppermost row that the window reaches.
            let first = (place + 1) % TAPS;
            for column in (0..width).step_by(LANES) {
                let mut values = [taps[0]; N];
                for map in 0..N {
                    let rows: &[_; TAPS] =
                        self.slots[map][column / LANES][first..].first_chunk().expect("twice as many");
                    let at = |tap: usize| &rows[tap];
                    values[map] = filtered(simd, &taps, at);
                }
                each(place - 2 * HALF, column, values);
            }
        }
    }
}

/// Returns the window on eleven vectors of values; it is symmetric about its middle. The smallest weights come first, so that
/// only the last two sums are rounded to the ulp of the result.
#[inline(always)]
fn filtered<'a, S: Simd, F: Real>(
    simd: S,
    taps: &[F::Eight<S>; HALF + 1],
    at: impl Fn(usize) -> &'a [F; LANES],
) -> F::Eight<S> {
    let pair = |distance: usize| {
        let above = F::Eight::<S>::from_slice(simd, at(HALF - distance));
        above + F::Eight::<S>::from_slice(simd, at(HALF + distance))
    };
    let mut sum = pair(HALF) * taps[HALF];
    for distance in (1..HALF).rev() {
        sum = pair(distance).mul_add(taps[distance], sum);
    }
    F::Eight::<S>::from_slice(simd, at(HALF)).mul_add(taps[0], sum)
}

/// Loads the next eight values of a row, with zeros beyond its end.
#[inline(always)]
pub(super) fn load<S: Simd, F: Real>(simd: S, row: &[F]) -> F::Eight<S> {
    match row.first_chunk::<LANES>() {
        Some(whole) => F::Eight::<S>::from_slice(simd, whole),
        None => F::Eight::<S>::from_fn(simd, |lane| row.get(lane).copied().unwrap_or(F::ZERO)),
    }
}

/// Writes as many of the eight values as `row` has room for.
#[inline(always)]
pub(super) fn store<S: Simd, F: Real, L: SimdFloat<S, Element = F>>(values: L, row: &mut [F]) {
    match row.first_chunk_mut::<LANES>() {
        Some(whole) => values.store_slice(whole),
        None => row.iter_mut().enumerate().for_each(|(lane, out)| *out = values[lane]),
    }
}
