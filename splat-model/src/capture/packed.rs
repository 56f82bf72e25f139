//! A photograph on the device in four bytes per pixel, as decoded. Prepared for the loss it takes nine times as much. A
//! capture that does not fit prepared may fit packed, and nothing is uploaded twice.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use super::Photo;
use super::image::over;

/// Bits of a channel.
const BITS: i32 = 8;

#[derive(Clone, Debug)]
pub(crate) struct PackedPhoto {
    /// `[1, H, W]`, i32: red in the lowest byte, then green, blue and alpha.
    words: Tensor<3, Int>,
    /// `[3, 1, 1]`: the first bits of red, green and blue.
    first_bits: Tensor<3, Int>,
    opaque: bool,
}

impl PackedPhoto {
    /// Bytes of a pixel.
    pub const PIXEL: usize = size_of::<i32>();

    /// Uploads a photograph.
    pub fn new(photo: &Photo, device: &Device) -> Self {
        let (colours, _) = photo.rgb.as_chunks::<3>();
        let word = |(i, &[r, g, b]): (usize, &[u8; 3])| {
            let alpha = photo.alpha.as_ref().map_or(u8::MAX, |alpha| alpha[i]);
            i32::from_le_bytes([r, g, b, alpha])
        };
        let words: Vec<i32> = colours.iter().enumerate().map(word).collect();
        let ints = |values, shape| Tensor::from_data(TensorData::new(values, shape), (device, DType::I32));
        Self {
            words: ints(words, [1, photo.intrinsics.height, photo.intrinsics.width]),
            first_bits: ints((0..3).map(|channel| BITS * channel).collect(), [3, 1, 1]),
            opaque: photo.alpha.is_none(),
        }
    }

    /// `[H, W, 3]`: what [`Photo::rgb_over`] gives, computed on the device. Few operations do it: a launch costs the host more than the work
    /// costs the device.
    pub fn rgb_over(&self, background: [f32; 3]) -> Tensor<3> {
        let colours = unpacked(self.words.clone().bitwise_right_shift(self.first_bits.clone()));
        let alpha = (!self.opaque)
            .then(|| unpacked(self.words.clone().bitwise_right_shift_scalar(3 * BITS)).permute([1, 2, 0]));
        over(colours.permute([1, 2, 0]), alpha, background)
    }
}

/// The lowest byte of each word, 0 to 1. The shift before may be arithmetic; the mask removes the bits that it fills in.
fn unpacked(shifted: Tensor<3, Int>) -> Tensor<3> {
    shifted.bitwise_and_scalar(i32::from(u8::MAX)).float() / f32::from(u8::MAX)
}

#[cfg(test)]
mod tests;
