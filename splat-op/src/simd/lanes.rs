//! Transposition of rows of a few numbers, as in tensors, into columns, as SIMD lanes read them, and back.

use fearless_simd::prelude::*;

use crate::linalg::dot;
use crate::simd::real::{LANES, Real};

/// A vector of Gaussians.
pub(crate) type Lanes<S, F> = <F as Real>::Lanes<S>;

/// A flag for each lane.
pub(crate) type MaskOf<S, F> = <Lanes<S, F> as SimdBase<S>>::Mask;

/// Vectors of three components.
pub(crate) type Vector<S, F> = [Lanes<S, F>; 3];

/// Number of lanes of [`Real::Lanes`].
#[inline(always)]
pub(crate) const fn width<S: Simd, F: Real>() -> usize {
    <F::Lanes<S> as SimdBase<S>>::LEN
}

/// Number of rows transposed at a time: enough that stores have completed when lanes read them, few enough to stay in the nearest cache.
pub(crate) const ROW_BLOCK: usize = 64;

/// Up to [`ROW_BLOCK`] rows of `C` numbers, stored by columns.
pub(crate) struct Columns<F, const C: usize>([[F; ROW_BLOCK]; C]);

impl<F: Real, const C: usize> Columns<F, C> {
    /// Returns columns of zeros.
    #[inline(always)]
    pub fn new() -> Self {
        Self([[F::ZERO; ROW_BLOCK]; C])
    }

    /// Reads up to [`ROW_BLOCK`] rows. Rows beyond those read keep their values.
    #[inline(always)]
    pub fn read(&mut self, rows: &[F]) {
        for (i, row) in (0..ROW_BLOCK).zip(rows.as_chunks::<C>().0) {
            for column in 0..C {
                self.0[column][i] = row[column];
            }
        }
    }

    /// Writes the rows back; the inverse of [`Self::read`].
    #[inline(always)]
    pub fn write(&self, rows: &mut [F]) {
        for (i, row) in (0..ROW_BLOCK).zip(rows.as_chunks_mut::<C>().0) {
            for column in 0..C {
                row[column] = self.0[column][i];
            }
        }
    }

    /// Returns all rows of one column.
    #[inline(always)]
    pub fn column(&self, column: usize) -> &[F; ROW_BLOCK] {
        &self.0[column]
    }

    #[inline(always)]
    pub fn lanes<S: Simd>(&self, simd: S, column: usize, first: usize) -> F::Lanes<S> {
        F::Lanes::<S>::from_slice(simd, &self.0[column][first..first + width::<S, F>()])
    }

    /// Returns a vector of rows of all columns.
    #[inline(always)]
    pub fn all_lanes<S: Simd>(&self, simd: S, first: usize) -> [F::Lanes<S>; C] {
        let mut all = [F::Lanes::<S>::splat(simd, F::ZERO); C];
        for (column, lanes) in all.iter_mut().enumerate() {
            *lanes = self.lanes(simd, column, first);
        }
        all
    }

    /// Stores a vector of rows of all columns; the inverse of [`Self::all_lanes`].
    #[inline(always)]
    pub fn store<S: Simd>(&mut self, first: usize, lanes: [F::Lanes<S>; C]) {
        for (column, lanes) in self.0.iter_mut().zip(lanes) {
            lanes.store_slice(&mut column[first..first + width::<S, F>()]);
        }
    }
}

/// Fills `out` with the result of `f` on the values at the same positions, a vector at a time.
#[inline(always)]
pub(crate) fn map_lanes<S: Simd, F: Real, const N: usize>(
    simd: S,
    values: [&[F]; N],
    out: &mut [F],
    f: impl Fn([F::Lanes<S>; N]) -> F::Lanes<S>,
) {
    let width = width::<S, F>();
    for (number, out) in out.chunks_mut(width).enumerate() {
        let mut lanes = [F::Lanes::<S>::splat(simd, F::ZERO); N];
        for (lanes, values) in lanes.iter_mut().zip(values) {
            let values = &values[number * width..number * width + out.len()];
            if out.len() == width {
                *lanes = F::Lanes::<S>::from_slice(simd, values);
            } else {
                let mut padded = [F::ZERO; LANES];
                padded[..values.len()].copy_from_slice(values);
                *lanes = F::Lanes::<S>::from_slice(simd, &padded[..width]);
            }
        }
        let result = f(lanes);
        if out.len() == width {
            result.store_slice(out);
        } else {
            let mut padded = [F::ZERO; LANES];
            result.store_slice(&mut padded[..width]);
            out.copy_from_slice(&padded[..out.len()]);
        }
    }
}

/// Length of vectors, without intermediate overflow or underflow.
#[inline(always)]
pub(crate) fn norm<S: Simd, F: Real>(simd: S, v: Vector<S, F>) -> F::Lanes<S> {
    let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
    let squared = dot(v, v);
    // Within these bounds no square has overflowed, and squares that underflowed are negligible.
    let in_range = squared.simd_gt(lanes(1e-20)) & squared.simd_lt(lanes(1e30));
    let plain = squared.sqrt();
    if in_range.all_true() {
        return plain;
    }
    let largest = v[0].abs().max(v[1].abs()).max(v[2].abs());
    let unit = [v[0] / largest, v[1] / largest, v[2] / largest];
    let scaled = largest.simd_gt(lanes(0.0)).select(largest * dot(unit, unit).sqrt(), largest);
    in_range.select(plain, scaled)
}
