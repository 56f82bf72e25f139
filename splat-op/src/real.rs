//! The two float types of the CPU twins, with their SIMD lanes.

use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use burn::tensor::DType;
use fearless_simd::{f32x8, f64x8, prelude::*, u32x8};

/// Lanes per vector, for both float types, so that a tile splits the same way for both.
pub(crate) const LANES: usize = 8;

/// f32 or f64.
pub(crate) trait Real:
    SimdFloatElement
    + Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Sum
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + burn::tensor::Element
    + bytemuck::Pod
    + 'static
{
    /// Eight values.
    type Lanes<S: Simd>: SimdFloat<S, Element = Self>;
    /// An unsigned integer that sorts as this float does, for non-negative values.
    type SortKey: Ord + Copy + Send + Sync;
    const DTYPE: DType;
    const ZERO: Self;
    const ONE: Self;
    /// The largest finite value.
    const MAX: Self;
    /// The step from one to the next value.
    const EPSILON: Self;
    /// The nearest value to a constant or option.
    fn of(value: f64) -> Self;
    fn f64(self) -> f64;
    fn sqrt(self) -> Self;
    fn ln(self) -> Self;
    /// The library's function; for many values at once see [`Self::exp_lanes`].
    fn exp(self) -> Self;
    fn abs(self) -> Self;
    fn finite(self) -> bool;
    fn sort_key(self) -> Self::SortKey;
    /// `exp(x)` for `x <= 0`, within 2 ulp; zero where the result would be subnormal.
    fn exp_lanes<S: Simd>(x: Self::Lanes<S>) -> Self::Lanes<S>;

    fn max_of(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
    fn min_of(self, other: Self) -> Self {
        if other < self { other } else { self }
    }
    /// `self` held between `low` and `high`.
    fn within(self, low: Self, high: Self) -> Self {
        self.max_of(low).min_of(high)
    }
}

macro_rules! scalar_functions {
    ($float:ty, $bits:ty, $dtype:expr) => {
        type SortKey = $bits;
        const DTYPE: DType = $dtype;
        const ZERO: Self = 0.0;
        const ONE: Self = 1.0;
        const MAX: Self = <$float>::MAX;
        const EPSILON: Self = <$float>::EPSILON;
        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $float
        }
        #[inline(always)]
        fn f64(self) -> f64 {
            self.into()
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            <$float>::sqrt(self)
        }
        #[inline(always)]
        fn ln(self) -> Self {
            <$float>::ln(self)
        }
        #[inline(always)]
        fn exp(self) -> Self {
            <$float>::exp(self)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            <$float>::abs(self)
        }
        #[inline(always)]
        fn finite(self) -> bool {
            self.is_finite()
        }
        #[inline(always)]
        fn sort_key(self) -> Self::SortKey {
            self.to_bits()
        }
    };
}

impl Real for f32 {
    type Lanes<S: Simd> = f32x8<S>;
    scalar_functions!(f32, u32, DType::F32);

    #[inline(always)]
    fn exp_lanes<S: Simd>(x: f32x8<S>) -> f32x8<S> {
        // Below this the result is subnormal: no picture can show it, and subnormals are slow.
        const SMALLEST: f32 = -87.0;
        // x = n ln 2 + r with |r| <= ln 2 / 2. Adding 1.5 * 2^23 rounds to an integer and leaves it in the low bits.
        const ROUND: f32 = 12_582_912.0;
        // ln 2 in two parts, the first with enough trailing zeros that its product with n is exact (Cody and Waite).
        const LN2_HIGH: f32 = 0.693_359_4;
        const LN2_LOW: f32 = -2.121_944_4e-4;
        let simd = x.token();
        let clamped = x.max(f32x8::splat(simd, SMALLEST));
        let shifted = clamped.mul_add(f32x8::splat(simd, std::f32::consts::LOG2_E), f32x8::splat(simd, ROUND));
        let n = shifted - ROUND;
        let r = n.mul_add(f32x8::splat(simd, -LN2_HIGH), clamped);
        let r = n.mul_add(f32x8::splat(simd, -LN2_LOW), r);
        // The Taylor series to degree 7: its remainder on |r| <= 0.347 is 5e-9, a twelfth of an ulp.
        let mut p = f32x8::splat(simd, 1.0 / 5040.0);
        for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
            p = p.mul_add(r, f32x8::splat(simd, c));
        }
        let exponent: u32x8<S> = (shifted.to_bits() << 23) + (127 << 23);
        let result = p * f32x8::from_bits(exponent);
        x.simd_lt(f32x8::splat(simd, SMALLEST)).select(f32x8::splat(simd, 0.0), result)
    }
}

impl Real for f64 {
    type Lanes<S: Simd> = f64x8<S>;
    scalar_functions!(f64, u64, DType::F64);

    // The f64 path is the yardstick: the library's function, lane by lane.
    #[inline(always)]
    fn exp_lanes<S: Simd>(x: f64x8<S>) -> f64x8<S> {
        f64x8::from_fn(x.token(), |lane| x[lane].exp())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn exp_stays_within_two_ulp_and_underflows_to_zero() {
        let mut worst = 0.0_f64;
        for i in 0..400_000 {
            let x = -(i as f32) * 2.17e-4;
            let got = dispatch!(Level::new(), simd => f32::exp_lanes(f32x8::splat(simd, x))[3]);
            let want = f64::from(x).exp();
            worst = worst.max((f64::from(got) - want).abs() / (want * f64::from(f32::EPSILON)));
        }
        assert!(worst <= 2.0, "{worst} ulp");
        let zero = dispatch!(Level::new(), simd => f32::exp_lanes(f32x8::splat(simd, f32::NEG_INFINITY))[0]);
        assert_eq!(zero, 0.0);
        let one = dispatch!(Level::new(), simd => f32::exp_lanes(f32x8::splat(simd, 0.0))[0]);
        assert_eq!(one, 1.0);
    }
}
