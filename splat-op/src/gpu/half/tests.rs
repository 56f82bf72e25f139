use burn::tensor::f16;

use super::*;
use crate::gpu::{Buffer, elementwise};
use crate::testing::gpu::gpus;

#[cube(launch_unchecked)]
fn threes_kernel<N: Size>(words: &[Vector<u32, N>], threes: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        load_three_halves(words, ABSOLUTE_POS).store(threes, 3 * ABSOLUTE_POS);
    }
}

#[cube(launch_unchecked)]
fn pairs_kernel(words: &[u32], pairs: &mut [f32], count: u32) {
    if ABSOLUTE_POS < count as usize {
        let (low, high) = halves_of(words[ABSOLUTE_POS]);
        pairs[2 * ABSOLUTE_POS] = low;
        pairs[2 * ABSOLUTE_POS + 1] = high;
    }
}

fn assert_widened(what: &str, found: &[f32], halves: &[f16]) {
    for (found, half) in found.iter().zip(halves) {
        let same = match half.is_finite() {
            true => found.to_bits() == half.to_f32().to_bits(),
            false => found.is_nan(),
        };
        assert!(same, "{what}: {half} becomes {found:e}");
    }
}

/// Every half beside a zero: as the bits of floats, a quarter of these words are subnormal.
#[test]
fn words_that_would_be_subnormal_floats_survive() {
    let numbers = (0..=u16::MAX).flat_map(|bits| [[bits, 0], [0, bits & 0x807f]].concat());
    let halves: Vec<f16> = numbers.map(f16::from_bits).collect();
    let words: Vec<u32> = halves.chunks_exact(2).map(word).collect();
    let subnormal = |word: &&u32| f32::from_bits(**word).is_subnormal();
    assert!(words.iter().filter(subnormal).count() > words.len() / 4);
    for (form, gpu) in gpus() {
        let pairs = Buffer::<f32>::new(&gpu, halves.len());
        let (grid, dim) = elementwise(words.len());
        let given = Buffer::from_slice(&gpu, &words);
        // SAFETY: every access is guarded by the count.
        unsafe {
            pairs_kernel::launch_unchecked(&gpu.client, grid, dim, given.arg(), pairs.arg(), words.len() as u32);
        }
        assert_widened(form, &pairs.read(&gpu), &halves);
    }
}

fn word(two: &[f16]) -> u32 {
    u32::from(two[0].to_bits()) | u32::from(two[1].to_bits()) << 16
}

#[test]
fn all_half_precision_floats_are_widened_bit_by_bit() {
    let halves: Vec<f16> = (0..=u16::MAX).map(f16::from_bits).collect();
    let words: Vec<u32> = halves.chunks_exact(2).map(word).collect();
    // The test reads at every offset, even and odd, that is followed by two more numbers and whose last word exists.
    let count = halves.len() - 3;
    for (form, gpu) in gpus() {
        let threes = Buffer::<f32>::new(&gpu, 3 * count);
        let (grid, dim) = elementwise(count);
        // SAFETY: every access is guarded by the count.
        unsafe {
            threes_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                1,
                Buffer::from_slice(&gpu, &words).arg(),
                threes.arg(),
                count as u32,
            );
        }
        for (at, three) in threes.read(&gpu).chunks_exact(3).enumerate() {
            assert_widened(form, three, &halves[at..]);
        }
    }
}
