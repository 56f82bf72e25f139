//! Features in half precision, two in a word: see [`crate::Storage`] and [`crate::gpu::half`].

use cubecl::prelude::*;

use super::Layers;
use super::layer::Shape;
use crate::gpu::half::{from_half, to_half};
use crate::gpu::{Buffer, Gpu, elementwise};

/// Channel `channel` of a Gaussian, from rows of words.
#[cube]
pub(super) fn load_half(words: &[f32], gaussian: usize, channel: usize, #[comptime] shape: Shape) -> f32 {
    let word = u32::reinterpret(words[gaussian * comptime!(words_of(shape.features)) + channel / 2]);
    from_half((word >> (channel as u32 % 2 * 16)) & 0xffff)
}

/// Words of a Gaussian's features.
const fn words_of(features: usize) -> usize {
    features.div_ceil(2)
}

/// A word from two features of a Gaussian. Beside the last of an odd number lies zero.
#[cube(launch_unchecked)]
fn blend_halve_kernel(features: &[f32], words: &mut [f32], count: u32, #[comptime] features_of: usize) {
    let word = ABSOLUTE_POS;
    if word < count as usize {
        let per_row = comptime!(words_of(features_of));
        let row = word / per_row;
        let first = word % per_row * 2;
        let low = to_half(features[row * features_of + first]);
        let mut high = 0u32;
        if first + 1 < features_of {
            high = to_half(features[row * features_of + first + 1]);
        }
        words[word] = f32::reinterpret(low | (high << 16));
    }
}

/// The features as [`load_half`] reads them.
pub(super) fn launch_halve(gpu: &Gpu, inputs: &Layers<Buffer<f32>>) -> Buffer<f32> {
    let features = inputs.background.len;
    let words = Buffer::new(gpu, inputs.count() * words_of(features));
    let (grid, dim) = elementwise(words.len);
    // SAFETY: every access is guarded by the number of words.
    unsafe {
        blend_halve_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            inputs.features.arg(),
            words.arg(),
            words.len as u32,
            features,
        );
    }
    words
}
