//! SIMD lanes as a [`Number`].

use std::ops::{Add, Div, Mul, Neg, Sub};

use fearless_simd::prelude::*;

use super::lanes::{Columns, Lanes, MaskOf, norm, width};
use super::real::{LANES, Real};
use super::{each, is_f32};
use crate::linalg::Number;

/// A number in each lane.
#[derive(Clone, Copy)]
pub(crate) struct LaneNumber<S: Simd, F: Real>(pub Lanes<S, F>);

impl<S: Simd, F: Real> LaneNumber<S, F> {
    /// Returns the same number in all lanes.
    #[inline(always)]
    pub fn splat(simd: S, value: F) -> Self {
        Self(Lanes::<S, F>::splat(simd, value))
    }

    /// Wraps the lanes of a row.
    #[inline(always)]
    pub fn row<const C: usize>(lanes: [Lanes<S, F>; C]) -> [Self; C] {
        each!(lanes, |lanes| Self(lanes))
    }

    /// Unwraps the lanes of a row.
    #[inline(always)]
    pub fn lanes<const C: usize>(row: [Self; C]) -> [Lanes<S, F>; C] {
        each!(row, |number| number.0)
    }
}

impl<F: Real, const C: usize> Columns<F, C> {
    /// Returns [`Self::all_lanes`] as numbers.
    #[inline(always)]
    pub fn numbers<S: Simd>(&self, simd: S, first: usize) -> [LaneNumber<S, F>; C] {
        LaneNumber::row(self.all_lanes(simd, first))
    }
}

macro_rules! operators {
    ($($trait:ident :: $name:ident),*) => {$(
        impl<S: Simd, F: Real> $trait for LaneNumber<S, F> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self($trait::$name(self.0, other.0))
            }
        }

        impl<S: Simd, F: Real> $trait<f64> for LaneNumber<S, F> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                Self($trait::$name(self.0, F::of(other)))
            }
        }
    )*};
}

operators!(Add::add, Sub::sub, Mul::mul, Div::div);

impl<S: Simd, F: Real> Neg for LaneNumber<S, F> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

macro_rules! functions {
    ($($name:ident($($other:ident)?)),*) => {$(
        #[inline(always)]
        fn $name(self $(, $other: Self)?) -> Self {
            Self(self.0.$name($($other.0)?))
        }
    )*};
}

macro_rules! comparisons {
    ($($name:ident = $lanes:ident),*) => {$(
        #[inline(always)]
        fn $name(self, other: Self) -> Self::Mask {
            self.0.$lanes(other.0)
        }
    )*};
}

impl<S: Simd, F: Real> Number for LaneNumber<S, F> {
    type Mask = MaskOf<S, F>;
    const DOUBLE: bool = !is_f32::<F>();

    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        Self::splat(self.0.token(), F::of(value))
    }

    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self(self.0.mul_add(factor.0, addend.0))
    }

    #[inline(always)]
    fn ln(self) -> Self {
        let mut values = [F::ZERO; LANES];
        let values = &mut values[..width::<S, F>()];
        self.0.store_slice(values);
        for value in &mut *values {
            *value = value.ln();
        }
        Self(Lanes::<S, F>::from_slice(self.0.token(), values))
    }

    functions!(sqrt(), abs(), min(other), max(other));
    comparisons!(lt = simd_lt, le = simd_le, gt = simd_gt, ge = simd_ge, eq = simd_eq);

    #[inline(always)]
    fn finite(self) -> Self::Mask {
        self.0.abs().simd_le(Lanes::<S, F>::splat(self.0.token(), F::MAX))
    }

    #[inline(always)]
    fn select(mask: Self::Mask, then: Self, or: Self) -> Self {
        Self(mask.select(then.0, or.0))
    }

    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask.any_true()
    }

    #[inline(always)]
    fn length([x, y, z]: [Self; 3]) -> Self {
        Self(norm::<S, F>(x.0.token(), [x.0, y.0, z.0]))
    }
}
