//! `f32` and `f64` with their SIMD vectors, their rows of vectors, and the transposition of tensor rows into columns of such vectors.

pub(crate) mod blocks;
pub(crate) mod lanes;
pub(crate) mod number;
pub(crate) mod real;

pub(crate) use self::blocks::{block_len, load, splat, store};
pub(crate) use self::lanes::{Columns, Lanes, MaskOf, ROW_BLOCK, Vector, map_lanes, norm, width};
pub(crate) use self::number::LaneNumber;
pub(crate) use self::real::{LANES, Real};

/// `each!(array, |element| value)`: the array of the values. A closure that the compiler leaves out of line lacks the vector
/// instructions of its caller, and every operation on a vector in it is a call; so does `map` of an array. This is a loop without a
/// closure. `.ci/run inlined` finds the calls that remain.
macro_rules! each {
    ($from:expr, |$element:pat_param| $value:expr) => {{
        let from = $from;
        let mut to = {
            let $element = from[0];
            $crate::simd::filled(&from, $value)
        };
        for i in 1..from.len() {
            let $element = from[i];
            to[i] = $value;
        }
        to
    }};
}
pub(crate) use each;

/// `dispatch!(F, simd => value)`: the value, computed with vector instructions whose token is `simd`. Every function called has to be
/// `#[inline(always)]`, and so do closures. All of it is compiled once for each set of instructions, so that it belongs around a whole task
/// and not into a loop.
///
/// Of x86-64 these are AVX2 in f32, and SSE2, which every processor has, in f64. A processor without AVX2 computes operations in f32 as
/// those in f64 ([`f32_in_f64`]). Of other processors they are those of [`fearless_simd::dispatch`].
macro_rules! dispatch {
    ($float:ty, $simd:ident => $value:expr) => {
        $crate::simd::dispatch!($float, false, $simd => $value)
    };
    ($float:ty, $has_avx512:literal, $simd:ident => $value:expr) => {{
        #[cfg(target_arch = "x86_64")]
        {
            let level = fearless_simd::Level::new();
            macro_rules! on {
                ($token:expr) => {{
                    let $simd = $token;
                    fearless_simd::Simd::vectorize(
                        $simd,
                        #[inline(always)]
                        || $value,
                    )
                }};
            }
            if const { !$crate::simd::is_f32::<$float>() } {
                on!(level.as_sse2().expect("x86-64 has SSE2"))
            } else if const { $has_avx512 } && let Some(token) = level.as_avx512() {
                on!(token)
            } else {
                on!(level.as_avx2().expect("processors without AVX2 compute f32 in f64"))
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            fearless_simd::dispatch!(fearless_simd::Level::new(), $simd => $value)
        }
    }};
}
pub(crate) use dispatch;

/// As [`dispatch`], with AVX-512 too. A version for it takes as long to compile as that for AVX2. It is for the pass that takes most of a step
/// and whose vectors, [`Real::Block`], are wider than AVX2's.
macro_rules! dispatch_widest {
    ($float:ty, $simd:ident => $value:expr) => {
        $crate::simd::dispatch!($float, true, $simd => $value)
    };
}
pub(crate) use dispatch_widest;

/// Whether a float type is f32. Versions in f64, which serves as a reference, would take as long to compile as those in f32.
pub(crate) const fn is_f32<F: Real>() -> bool {
    matches!(F::DTYPE, burn::tensor::DType::F32)
}

/// Whether operations in f32 are computed in f64 and rounded: on processors of x86-64 without AVX2, those before 2013 and a few after. Code in
/// f32 for them would take a fifth of the time that this crate takes to compile.
pub(crate) fn f32_in_f64() -> bool {
    #[cfg(target_arch = "x86_64")]
    let lacks_avx2 = fearless_simd::Level::new().as_avx2().is_none();
    #[cfg(not(target_arch = "x86_64"))]
    let lacks_avx2 = false;
    lacks_avx2 || crate::counters::is_f32_in_f64_forced()
}

/// Returns an array as long as another.
#[inline(always)]
pub(crate) fn filled<T, U: Copy, const N: usize>(_: &[T; N], value: U) -> [U; N] {
    [value; N]
}
