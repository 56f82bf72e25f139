//! [`Real::Block`]s of a row of values, also where the row ends within one.

use fearless_simd::prelude::*;

use crate::simd::real::Real;

/// Number of values in a block.
#[inline(always)]
pub(crate) const fn block_len<S: Simd, F: Real>() -> usize {
    <F::Block<S> as SimdBase<S>>::LEN
}

#[inline(always)]
pub(crate) fn splat<S: Simd, F: Real>(simd: S, value: F) -> F::Block<S> {
    F::Block::<S>::splat(simd, value)
}

/// Loads the first values of a row, with zeros beyond its end.
#[inline(always)]
pub(crate) fn load<S: Simd, F: Real>(simd: S, row: &[F]) -> F::Block<S> {
    match row.get(..block_len::<S, F>()) {
        Some(whole) => F::Block::<S>::from_slice(simd, whole),
        None => F::Block::<S>::from_fn(simd, |lane| row.get(lane).copied().unwrap_or(F::ZERO)),
    }
}

/// Writes as many values as `row` has room for.
#[inline(always)]
pub(crate) fn store<S: Simd, F: Real>(values: F::Block<S>, row: &mut [F]) {
    match row.get_mut(..block_len::<S, F>()) {
        Some(whole) => values.store_slice(whole),
        None => row.iter_mut().enumerate().for_each(|(lane, out)| *out = values[lane]),
    }
}
