//! Image metrics as the field reports them, as numbers on the host.
//!
//! Pictures are `[H, W, C]` and are clamped to 0..1 first, as in a picture file. Gradients are not tracked. An average over
//! views is the mean of the views' values ([`mean_over_views`]), not the value of the mean error.

mod correct;
pub mod lpips;

use burn::tensor::{Bool, Tensor};

use crate::effects::masks;
use crate::loss::{Truth, d_ssim, ssim_map};

pub use self::correct::colour_corrected;

/// PSNR of equal pictures, dB. The formula gives infinity, which JSON cannot hold and which would make every mean infinite. 100
/// dB is a root mean square error of 1e-5: less than a level of a 16-bit picture, so no real score reaches it.
pub const LARGEST_PSNR_DB: f64 = 100.0;

/// Peak signal-to-noise ratio of `image` against `truth`, dB: `−10 log₁₀ MSE` with peak 1, at most [`LARGEST_PSNR_DB`].
/// NaN if either holds NaN.
pub fn psnr(image: Tensor<3>, truth: Tensor<3>) -> f64 {
    let difference = displayed(image) - displayed(truth);
    psnr_of((difference.clone() * difference).mean().into_scalar::<f64>())
}

/// PSNR, dB, of a mean square error.
fn psnr_of(mean_square: f64) -> f64 {
    let psnr_db = -10.0 * mean_square.log10();
    // Not `min`, which would turn NaN into a perfect score.
    if psnr_db > LARGEST_PSNR_DB { LARGEST_PSNR_DB } else { psnr_db }
}

/// Mean SSIM of `image` against `truth`: 11 × 11 window, σ = 1.5, zero padding, as in the evaluation of the original implementation of 3D
/// Gaussian splatting (see [`mod@crate::loss::ssim`]). Tools with other padding or windows differ in the third decimal.
pub fn ssim(image: Tensor<3>, truth: Tensor<3>) -> f64 {
    let truth = Truth::new(displayed(truth));
    1.0 - d_ssim(displayed(image), &truth).into_scalar::<f64>()
}

/// PSNR (dB) and SSIM over the pixels that `excluded`, `[1, H, W]`, does not mark. The window of SSIM sees excluded pixels as
/// black, like pixels beyond the border. NaN if all pixels are excluded.
pub fn scores_without(image: Tensor<3>, truth: Tensor<3>, excluded: &Tensor<3, Bool>) -> (f64, f64) {
    let [image, truth] = [image, truth].map(|picture| masks::cleared(displayed(picture), excluded));
    let [height, width, channels] = image.dims();
    let counts = excluded.clone().bool_not().float().permute([1, 2, 0]);
    let values = channels as f64 * counts.clone().sum().into_scalar::<f64>();
    let squares: f64 = (image.clone() - truth.clone()).square().sum().into_scalar();
    let similar: f64 = (ssim_map(image, truth) * counts.expand([height, width, channels])).sum().into_scalar();
    (psnr_of(squares / values), similar / values)
}

/// The mean of one metric over views, as tables report it. NaN without views.
pub fn mean_over_views(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The picture as a screen shows it, clamped to 0..1.
fn displayed(image: Tensor<3>) -> Tensor<3> {
    image.inner().clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests;
