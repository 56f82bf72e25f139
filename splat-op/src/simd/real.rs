//! The two float types of the CPU twins, with their SIMD vectors.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use burn::tensor::DType;
use fearless_simd::{f32x8, f32x16, f64x2, f64x8, prelude::*, u32x8};

use super::each;

/// The largest number of lanes of [`Real::Lanes`], and that of [`Real::Eight`].
pub(crate) const LANES: usize = 8;

pub(crate) const EXP2_CONSTANTS: usize = 8;

/// f32 or f64.
pub trait Real:
    SimdFloatElement
    + PartialOrd
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
{
    /// A vector of Gaussians: eight, in f64 two. Wide vectors of which a processor has a quarter take four times as long to compile.
    type Lanes<S: Simd>: SimdFloat<S, Element = Self>;
    /// A vector of eight values.
    type Eight<S: Simd>: SimdFloat<S, Element = Self>;
    /// A vector of 64 bytes, the widest: narrower processors take it in parts, so that sums over its lanes are the same on all.
    type Block<S: Simd>: SimdFloat<S, Element = Self>;
    /// An unsigned integer that sorts like this float, for non-negative values.
    type SortKey: Ord + Copy + Send + Sync;
    /// The type of tensors of this float.
    const DTYPE: DType;
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// The largest finite value.
    const MAX: Self;
    /// The smallest positive number that is not subnormal.
    const MIN_POSITIVE: Self;
    /// The distance from one to the next larger value.
    const EPSILON: Self;
    /// Rounds a constant or option to the nearest value.
    fn of(value: f64) -> Self;
    /// Widens the value.
    fn f64(self) -> f64;
    /// `√x`.
    fn sqrt(self) -> Self;
    /// The natural logarithm.
    fn ln(self) -> Self;
    /// `|x|`.
    fn abs(self) -> Self;
    /// Whether the value is neither infinite nor NaN.
    fn finite(self) -> bool;
    /// Returns the key of a non-negative value.
    fn sort_key(self) -> Self::SortKey;
    /// Sorts by key, stably.
    fn sort_by_key(rows: &mut [(Self::SortKey, u32)]);
    /// Returns the integer part of a value between 0 and 2³¹, faster than a conversion to `usize`.
    fn index(self) -> usize;
    /// The largest `q` that [`Self::exp2_lanes`] supports: `2^−q` is not subnormal.
    const EXP2_MAX: Self;
    /// The constants of [`Self::exp2_lanes`].
    const EXP2: [Self; EXP2_CONSTANTS];
    /// Returns `2^−q` for `0 <= q <= EXP2_MAX`, within 2 ulp; arbitrary elsewhere. `constants` are [`Self::EXP2`], one copy in each lane.
    fn exp2_lanes<S: Simd, L: SimdFloat<S, Element = Self>>(q: L, constants: &[L; EXP2_CONSTANTS]) -> L;
    /// Writes the sum over the lanes of each vector, with the bits of `reduce_sum`.
    #[inline(always)]
    fn reduce_sums<S: Simd>(vectors: &[Self::Block<S>], sums: &mut [Self]) {
        for (sum, vector) in sums.iter_mut().zip(vectors) {
            *sum = vector.reduce_sum();
        }
    }
    /// Returns `eˣ` within 1 ulp: zero or infinite beyond the range of the float type, arbitrary for NaN.
    fn exp_lanes<S: Simd>(x: Self::Lanes<S>) -> Self::Lanes<S>;

    /// The larger value; `self` beside NaN.
    fn max_of(self, other: Self) -> Self {
        if other > self { other } else { self }
    }
    /// The smaller value; `self` beside NaN.
    fn min_of(self, other: Self) -> Self {
        if other < self { other } else { self }
    }
    /// Clamps `self` between `low` and `high`.
    fn within(self, low: Self, high: Self) -> Self {
        self.max_of(low).min_of(high)
    }
}

/// Functions of the same name in the standard library.
macro_rules! inherent {
    ($float:ty: $($name:ident),*) => {$(
        #[inline(always)]
        fn $name(self) -> Self {
            <$float>::$name(self)
        }
    )*};
}

macro_rules! scalar_functions {
    ($float:ty, $bits:ty, $dtype:expr) => {
        type SortKey = $bits;
        const DTYPE: DType = $dtype;
        const ZERO: Self = 0.0;
        const ONE: Self = 1.0;
        const MAX: Self = <$float>::MAX;
        const MIN_POSITIVE: Self = <$float>::MIN_POSITIVE;
        const EPSILON: Self = <$float>::EPSILON;
        #[inline(always)]
        fn of(value: f64) -> Self {
            value as $float
        }
        #[inline(always)]
        fn f64(self) -> f64 {
            self.into()
        }
        inherent!($float: sqrt, ln, abs);
        #[inline(always)]
        fn finite(self) -> bool {
            self.is_finite()
        }
        #[inline(always)]
        fn index(self) -> usize {
            self as i32 as usize
        }
        #[inline(always)]
        fn sort_key(self) -> Self::SortKey {
            self.to_bits()
        }
        fn sort_by_key(rows: &mut [(Self::SortKey, u32)]) {
            radsort::sort_by_key(rows, |row| row.0);
        }
    };
}

impl Real for f32 {
    type Lanes<S: Simd> = f32x8<S>;
    type Eight<S: Simd> = f32x8<S>;
    type Block<S: Simd> = f32x16<S>;
    scalar_functions!(f32, u32, DType::F32);

    const EXP2_MAX: Self = 126.0;

    /// First `1.5 · 2²³`, whose addition rounds to an integer and leaves it in the low bits, plus 127, the bias of an exponent. Then the
    /// polynomial of degree 6 for `2^−s`, `|s| <= 1/2`, of least relative error, 2e-9 (Remez's exchange), a thirtieth of an ulp.
    const EXP2: [f32; EXP2_CONSTANTS] = [
        12_583_039.0,
        1.534_581_2e-4,
        -1.339_993_1e-3,
        9.618_489e-3,
        -5.550_328_8e-2,
        2.402_264_7e-1,
        -6.931_472e-1,
        1.0,
    ];

    #[inline(always)]
    fn exp2_lanes<S: Simd, L: SimdFloat<S, Element = f32>>(q: L, constants: &[L; EXP2_CONSTANTS]) -> L {
        // q = n + s with an integer n and |s| <= 1/2.
        let shifted = constants[0] - q;
        let s = q + (shifted - constants[0]);
        let mut p = constants[1];
        for c in &constants[2..] {
            p = p.mul_add(s, *c);
        }
        // `to_bits` would do, but is a function of its own.
        p * (shifted.bitcast::<L::Bits>() << 23).bitcast::<L>()
    }

    /// Four vectors at a time, whose shuffles they share.
    #[inline(always)]
    fn reduce_sums<S: Simd>(vectors: &[f32x16<S>], sums: &mut [f32]) {
        let (fours, rest) = vectors.as_chunks::<4>();
        let (sums_of_fours, sums_of_rest) = sums.split_at_mut(4 * fours.len());
        for (four, sums) in fours.iter().zip(sums_of_fours.as_chunks_mut::<4>().0) {
            let quarters = each!(*four, |vector| {
                let (low, high) = vector.split();
                let (low, high) = (low + high).split();
                low + high
            });
            let pairs =
                each!([0, 2], |i| quarters[i].unzip_low(quarters[i + 1]) + quarters[i].unzip_high(quarters[i + 1]));
            (pairs[0].unzip_low(pairs[1]) + pairs[0].unzip_high(pairs[1])).store_slice(sums);
        }
        for (sum, vector) in sums_of_rest.iter_mut().zip(rest) {
            *sum = vector.reduce_sum();
        }
    }

    #[inline(always)]
    fn exp_lanes<S: Simd>(x: f32x8<S>) -> f32x8<S> {
        // x = n ln 2 + s with an integer n and |s| <= (ln 2) / 2, as above; ln 2 is split in two parts, the first with few digits.
        const ROUND: f32 = 12_582_912.0;
        const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
        let simd = x.token();
        let lanes = |value: f32| f32x8::splat(simd, value);
        let x = x.max(lanes(-104.0)).min(lanes(89.0));
        let shifted = x.mul_add(lanes(std::f32::consts::LOG2_E), lanes(ROUND));
        let n = shifted - ROUND;
        let s = n.mul_add(lanes(-LN_2[1]), n.mul_add(lanes(-LN_2[0]), x));
        // Taylor series to degree 7; the truncation error is at most a tenth of an ulp.
        let mut p = lanes(1.0 / 5040.0);
        for factorial in [720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0] {
            p = p.mul_add(s, lanes(1.0 / factorial));
        }
        // 2ⁿ is split in two factors, because n exceeds the exponents of a float on both sides.
        let half = (n * 0.5).floor();
        let powers = each!([half, n - half], |n| {
            let exponent = ((n + ROUND).bitcast::<u32x8<S>>() << 23) + (127 << 23);
            exponent.bitcast::<f32x8<S>>()
        });
        p * powers[0] * powers[1]
    }
}

impl Real for f64 {
    type Lanes<S: Simd> = f64x2<S>;
    type Eight<S: Simd> = f64x8<S>;
    type Block<S: Simd> = f64x8<S>;
    scalar_functions!(f64, u64, DType::F64);

    const EXP2_MAX: Self = 1022.0;
    const EXP2: [f64; EXP2_CONSTANTS] = [0.0; EXP2_CONSTANTS];

    // The f64 path is the reference: the library function, lane by lane.
    #[inline(always)]
    fn exp2_lanes<S: Simd, L: SimdFloat<S, Element = f64>>(q: L, _: &[L; EXP2_CONSTANTS]) -> L {
        L::from_fn(q.token(), |lane| (-q[lane]).exp2())
    }

    #[inline(always)]
    fn exp_lanes<S: Simd>(x: f64x2<S>) -> f64x2<S> {
        f64x2::from_fn(x.token(), |lane| x[lane].exp())
    }
}

#[cfg(test)]
mod tests;
