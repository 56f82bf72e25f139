//! `f32` and `f64` with their SIMD vectors, their rows of vectors, and the transposition of tensor rows into columns of such vectors.

pub(crate) mod blocks;
pub(crate) mod lanes;
pub(crate) mod real;

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

/// Returns an array as long as another.
#[inline(always)]
pub(crate) fn filled<T, U: Copy, const N: usize>(_: &[T; N], value: U) -> [U; N] {
    [value; N]
}
