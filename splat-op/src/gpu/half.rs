//! Half-precision floats in buffers of words, two to a word.
//!
//! The conversion uses integer arithmetic: few devices compute in half precision or even load it, and all devices have integers.
//! The words are integers in buffers and registers too. As floats, two halves are often a subnormal number, which a device may
//! turn into zero wherever it loads or moves it.

use cubecl::prelude::*;

use super::math::Vec3;

/// Difference between the exponent biases of f32 and half precision, as bits of an f32.
const BIAS: u32 = 112 << 23;

/// Converts the bits of a half-precision float to a float. Infinities become NaN.
#[cube]
fn from_half(bits: u32) -> f32 {
    let sign = (bits & 0x8000) << 16;
    let size = bits & 0x7fff;
    let normal = (size << 13) + BIAS;
    // A subnormal is an integer number of steps. Its shifted bits would be a subnormal f32, which devices may flush to zero.
    let small = u32::reinterpret(f32::cast_from(size) * 5.960_464_5e-8);
    let found = select(size >= 0x0400, normal, small);
    f32::reinterpret(sign | select(size >= 0x7c00, 0x7fc0_0000u32, found))
}

/// Returns the two numbers of a word; the first is in its lower half.
#[cube]
pub(crate) fn halves_of(word: u32) -> (f32, f32) {
    (from_half(word & 0xffff), from_half(word >> 16))
}

/// Reads the numbers `at` to `at + 2` of packed words, one word at a time.
#[cube]
pub(crate) fn load_three_halves<N: Size>(words: &[Vector<u32, N>], at: usize) -> Vec3 {
    let (first, second) = (words[at / 2].extract(0usize), words[at / 2 + 1].extract(0usize));
    let odd = at % 2 == 1;
    let (low, high) = (first & 0xffff, first >> 16);
    let (next, last) = (second & 0xffff, second >> 16);
    Vec3::new(from_half(select(odd, high, low)), from_half(select(odd, next, high)), from_half(select(odd, last, next)))
}

#[cfg(test)]
mod tests;
