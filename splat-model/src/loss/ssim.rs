//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli 2004, eq. 13), with the settings of 3D Gaussian splatting.
//!
//! With `K` the Gaussian window, `μx = Kx`, `σx² = Kx² − μx²`, `σxy = Kxy − μxμy`:
//!
//! `SSIM = (2 μxμy + C1)(2 σxy + C2) / ((μx² + μy² + C1)(σx² + σy² + C2))`.
//!
//! The window has 11 × 11 taps, σ = 1.5, and sums to 1 inside the picture. Pixels outside the picture count as zero, so the
//! weights near the border sum to less, as in the training and the evaluation of the original code. Channels are independent;
//! the index is the mean over pixels and channels.
//!
//! Variances are differences of moments and are **not** clamped at zero, as is usual in the field. In f32 that leaves errors of
//! about `1e-7 · x²` beside C2 = 9e-4: negligible for pictures in 0..1, dominant for values of 100. The loss takes moments that
//! lose less (see [`splat_op::loss`]): errors of about `1e-7 · x |1 − 2x|`.
//!
//! [`ssim_map`] and [`ssim`] define the metric in plain tensor code. The window is two depthwise convolutions, the fastest of the
//! formulations tried on Burn Flex (banded matrix products, blocked or whole; shifted slices). The autodiff gradient of such a convolution
//! is far slower than the convolution, so [`d_ssim`](super::d_ssim) and the loss are one operation, see [`splat_op::loss`].

use burn::tensor::{Tensor, TensorData, module::conv2d, ops::ConvOptions};

use splat_op::is_tensor_code;
use splat_op::loss::{C1, C2, SIGMA_PX, TAPS, contiguous, moments};

/// The separable window `K` for pictures of the channels, type and device of `like`, `[1, C, H, W]`.
fn separable_window(like: &Tensor<4>) -> impl Fn(Tensor<4>) -> Tensor<4> + use<> {
    let channels = like.dims()[1];
    let centre = (TAPS / 2) as f64;
    let taps: Vec<f64> =
        (0..TAPS).map(|i| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp()).collect();
    let sum: f64 = taps.iter().sum();
    let weights: Vec<f64> = (0..channels).flat_map(|_| taps.iter().map(|tap| tap / sum)).collect();
    let options = (&like.device().inner(), like.dtype());
    let vertical = Tensor::<4>::from_data(TensorData::new(weights, [channels, 1, TAPS, 1]), options);
    let horizontal = vertical.clone().swap_dims(2, 3);
    move |x| {
        let along = |padding| ConvOptions::new([1, 1], padding, [1, 1], channels);
        let x = conv2d(x, vertical.clone(), None, along([TAPS / 2, 0]));
        conv2d(x, horizontal.clone(), None, along([0, TAPS / 2]))
    }
}

/// Converts `[H, W, C]` to `[1, C, H, W]`. A render is a permuted view of planes, so this returns its storage without a copy.
pub(crate) fn planes(image: Tensor<3>) -> Tensor<4> {
    image.permute([2, 0, 1]).unsqueeze()
}

/// A photograph with the moments that SSIM needs, computed once and used at every step. Holds three pictures, no gradient.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The photograph, `[1, C, H, W]`.
    planes: Tensor<4>,
    /// `μy`
    mean: Tensor<4>,
    /// `σy² + C2`
    variance: Tensor<4>,
}

impl Truth {
    /// Prepares `truth`, `[H, W, C]`, 0 to 1. Gradients of `truth` are not tracked.
    pub fn new(truth: Tensor<3>) -> Self {
        let layout = planes(truth.inner());
        if is_tensor_code() {
            let window = separable_window(&layout);
            let mean = window(layout.clone());
            let variance = window(layout.clone().square()) - mean.clone().square() + C2;
            return Self { planes: layout, mean, variance };
        }
        // One copy per photograph instead of a strided read at every step.
        let planes = contiguous(&layout).unwrap_or_else(|error| panic!("{error}"));
        let [mean, variance] = moments(&planes).unwrap_or_else(|error| panic!("{error}"));
        Self { planes, mean, variance }
    }

    /// The loss `(1 − λ) L1 + λ (1 − SSIM)` of a picture `[1, C, H, W]` without autodiff and, if requested, its derivative.
    pub(super) fn loss(&self, x: &Tensor<4>, lambda: f64, with_derivative: bool) -> (Tensor<1>, Option<Tensor<4>>) {
        let photograph = [&self.planes, &self.mean, &self.variance];
        splat_op::loss::photometric(x, photograph, lambda, with_derivative).unwrap_or_else(|error| panic!("{error}"))
    }

    /// The photograph, `[H, W, C]`.
    pub fn image(&self) -> Tensor<3> {
        self.planes.clone().squeeze_dim::<3>(0).permute([1, 2, 0])
    }
}

/// SSIM at every pixel and channel, `[H, W, C]`, of `image` and `truth`, `[H, W, C]`, 0 to 1.
///
/// Plain differentiable tensor code in both arguments, for new losses. [`d_ssim`](super::d_ssim) is many times faster for the mean.
pub fn ssim_map(image: Tensor<3>, truth: Tensor<3>) -> Tensor<3> {
    let (x, y) = (planes(image), planes(truth));
    let window = separable_window(&x);
    let (mean_x, mean_y) = (window(x.clone()), window(y.clone()));
    let (square_x, square_y) = (mean_x.clone().square(), mean_y.clone().square());
    let cross = mean_x * mean_y;
    let variance = window(x.clone().square()) + window(y.clone().square()) - square_x.clone() - square_y.clone();
    let covariance = window(x * y) - cross.clone();
    let index = (cross * 2.0 + C1) * (covariance * 2.0 + C2) / ((square_x + square_y + C1) * (variance + C2));
    index.squeeze_dim::<3>(0).permute([1, 2, 0])
}

/// Mean SSIM, `[1]`, of `image` and `truth`, `[H, W, C]`, 0 to 1; differentiable in both. See [`ssim_map`].
pub fn ssim(image: Tensor<3>, truth: Tensor<3>) -> Tensor<1> {
    ssim_map(image, truth).mean()
}
