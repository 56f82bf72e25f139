//! Half-precision floats in buffers of words, two to a word.
//!
//! By integer arithmetic, for few devices compute in half precision or even load it, and all have integers. The words travel in
//! buffers of f32, of which they are the bits, so that a kernel's arguments are the same however numbers are stored.

use cubecl::prelude::*;

use super::math::Vec3;
use crate::real::HALF_MAX;

/// The bits of the least half-precision float that is not subnormal, 2⁻¹⁴, in f32; and of what an exponent's bias differs by.
const NORMAL: u32 = 113 << 23;
const BIAS: u32 = 112 << 23;

/// A half-precision float's bits that are no number.
const NAN: u32 = 0x7e00;

/// The bits of the nearest half-precision float, of two as near the even one, of at most [`HALF_MAX`].
#[cube]
pub(crate) fn to_half(value: f32) -> u32 {
    let bits = u32::reinterpret(value);
    let sign = (bits >> 16) & 0x8000;
    let size = bits & 0x7fff_ffff;
    let held = min(size, comptime!(HALF_MAX.to_bits()));
    // Thirteen digits go: half of the last that stays, less one unless that is odd, and what is carried goes on.
    let normal = (held - BIAS + 0x0fff + ((held >> 13) & 1)) >> 13;
    // In steps of 2⁻²⁴.
    let steps = f32::reinterpret(min(held, NORMAL)) * 16_777_216.0;
    let whole = u32::cast_from(steps.floor());
    let rest = steps - steps.floor();
    let up = rest > 0.5 || (rest == 0.5 && (whole & 1) == 1);
    let small = whole + select(up, 1u32, 0u32);
    let rounded = select(held >= NORMAL, normal, small);
    sign | select(size > 0x7f80_0000, NAN, rounded)
}

/// The float of the bits of a half-precision one. No infinity: [`to_half`] makes none.
#[cube]
pub(crate) fn from_half(bits: u32) -> f32 {
    let sign = (bits & 0x8000) << 16;
    let size = bits & 0x7fff;
    let normal = (size << 13) + BIAS;
    // A subnormal one is an integer of steps; its bits, shifted, would be a subnormal f32, which devices may take for zero.
    let small = u32::reinterpret(f32::cast_from(size) * 5.960_464_5e-8);
    let found = select(size >= 0x0400, normal, small);
    f32::reinterpret(sign | select(size >= 0x7c00, 0x7fc0_0000u32, found))
}

/// Numbers `at` to `at + 2` of those that lie packed in the words, the first in the lower half of its word.
#[cube]
pub(crate) fn load_three_halves(words: &[f32], at: usize) -> Vec3 {
    let (first, second) = (u32::reinterpret(words[at / 2]), u32::reinterpret(words[at / 2 + 1]));
    let odd = at % 2 == 1;
    let (low, high) = (first & 0xffff, first >> 16);
    let (next, last) = (second & 0xffff, second >> 16);
    Vec3::new(from_half(select(odd, high, low)), from_half(select(odd, next, high)), from_half(select(odd, last, next)))
}

#[cfg(test)]
mod tests {
    use burn::tensor::f16;

    use super::*;
    use crate::gpu::{Buffer, elementwise};
    use crate::real::Real;
    use crate::testing::gpu::gpus;
    use crate::testing::random::Random;

    #[cube(launch_unchecked)]
    fn halves_kernel(from: &[f32], bits: &mut [u32], back: &mut [f32], count: u32) {
        if ABSOLUTE_POS < count as usize {
            let half = to_half(from[ABSOLUTE_POS]);
            bits[ABSOLUTE_POS] = half;
            back[ABSOLUTE_POS] = from_half(half);
        }
    }

    /// All half-precision floats, what lies in the middle between two and on both sides of that, what is too large or too small,
    /// and numbers of every size.
    fn values() -> Vec<f32> {
        let finite: Vec<f32> =
            (0..=u16::MAX).map(|bits| f16::from_bits(bits).to_f32()).filter(|v| v.is_finite()).collect();
        let middles: Vec<f32> = (0..0x7bff_u16)
            .map(|bits| 0.5 * (f16::from_bits(bits).to_f32() + f16::from_bits(bits + 1).to_f32()))
            .flat_map(|middle| [middle.next_down(), middle, middle.next_up(), -middle])
            .collect();
        let mut random = Random::new(50);
        let sizes =
            (0..50_000).map(|_| (random.between(-1.0, 1.0).signum() * random.between(-40.0, 20.0).exp2()) as f32);
        let beyond = [65_519.0, 65_520.0, 1e6, -1e30, f32::INFINITY, f32::NEG_INFINITY, f32::MIN_POSITIVE, -1e-30];
        finite.into_iter().chain(middles).chain(sizes).chain(beyond).collect()
    }

    #[test]
    fn halves_are_those_of_the_twin_bit_by_bit() {
        let mut values = values();
        values.push(f32::NAN);
        for (form, gpu) in gpus() {
            let given = Buffer::from_slice(&gpu, &values);
            let (bits, back) = (Buffer::<u32>::new(&gpu, values.len()), Buffer::<f32>::new(&gpu, values.len()));
            let (grid, dim) = elementwise(values.len());
            let count = values.len() as u32;
            // SAFETY: every access is guarded by the length.
            unsafe {
                halves_kernel::launch_unchecked(&gpu.client, grid, dim, given.arg(), bits.arg(), back.arg(), count);
            }
            let (bits, back) = (bits.read(&gpu), back.read(&gpu));
            let last = values.len() - 1;
            for (i, value) in values[..last].iter().enumerate() {
                let expected = value.halved();
                assert_eq!(bits[i], u32::from(f16::from_f32(expected).to_bits()), "{form}: {value:e}");
                assert_eq!(back[i].to_bits(), expected.to_bits(), "{form}: {value:e} becomes {:e}", back[i]);
            }
            assert!(back[last].is_nan() && f32::NAN.halved().is_nan(), "{form}: what is no number stays none");
        }
    }

    #[test]
    fn the_twin_stays_finite_and_within_half_a_unit_of_the_last_place() {
        for value in values() {
            let halved = value.halved();
            assert!(halved.abs() <= HALF_MAX && f64::from(halved) == f64::from(value).halved(), "{value:e}");
            let error = (f64::from(value.clamp(-HALF_MAX, HALF_MAX)) - f64::from(halved)).abs();
            let unit = f64::from(value.abs()).max(2.0_f64.powi(-14)) * 2.0_f64.powi(-11);
            assert!(error <= unit, "{value:e} becomes {halved:e}");
        }
    }
}
