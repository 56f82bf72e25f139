//! A photograph on the device in four bytes per pixel, as decoded. Prepared for the loss it takes nine times as much. A
//! capture that does not fit prepared may fit packed, and nothing is uploaded twice.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use super::Photo;
use super::image::over;

/// Bits of a channel.
const BITS: usize = 8;

/// A packed photograph.
#[derive(Clone, Debug)]
pub(crate) struct PackedPhoto {
    /// `[H, W]`, i32: red in the lowest byte, then green, blue and alpha.
    words: Tensor<2, Int>,
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
        let size = [photo.intrinsics.height, photo.intrinsics.width];
        let words = Tensor::from_data(TensorData::new(words, size), (device, DType::I32));
        Self { words, opaque: photo.alpha.is_none() }
    }

    /// `[H, W, 3]`: what [`Photo::rgb_over`] gives, computed on the device.
    pub fn rgb_over(&self, background: [f32; 3]) -> Tensor<3> {
        let planes = Tensor::cat([0, 1, 2].map(|channel| self.channel(channel)).to_vec(), 0);
        let alpha = (!self.opaque).then(|| self.channel(3).permute([1, 2, 0]));
        over(planes.permute([1, 2, 0]), alpha, background)
    }

    /// `[1, H, W]`, 0 to 1.
    fn channel(&self, channel: usize) -> Tensor<3> {
        let low = self.words.clone().bitwise_right_shift_scalar((BITS * channel) as i32);
        // The shift may be arithmetic; the mask removes the bits that it fills in.
        (low.bitwise_and_scalar(i32::from(u8::MAX)).float() / f32::from(u8::MAX)).unsqueeze()
    }
}

#[cfg(test)]
mod tests;
