//! LPIPS: how different two pictures look, by the features that a network trained on photographs sees in them.
//!
//! Zhang et al. 2018, "The unreasonable effectiveness of deep features as a perceptual metric", in the version 0.1 of the
//! authors' package `lpips`. With `f` and `g` the features of the two pictures after a tap `l` of the network, unit vectors over
//! the channels `c` at each place `p`,
//!
//! ```text
//! LPIPS = Σ_l  mean_p  Σ_c  w_lc (f_lcp − g_lcp)²
//! ```
//!
//! with weights `w ≥ 0` fitted to the judgement of people. Nothing of a network is in this crate: [`Lpips::read`] takes the
//! weights from a file, whose names and whose export `docs/METRICS.md` describes.
//!
//! Large pictures are compared in parts, with what the features of each look at around it, and the means are over the whole:
//! the values are those of the whole picture, and the memory is bounded.

mod layers;
mod weights;

use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{DType, Device, Tensor};
use thiserror::Error;

pub use self::layers::Net;
use self::layers::{Layer, Part, TAPS, Window, parts};
pub use self::weights::WeightsError;

/// Of the package's `normalize_tensor`, added to the length of a vector of features.
const LENGTH_EPSILON: f64 = 1e-10;

/// Of the package's `ScalingLayer`: the mean and the deviation of photographs' colours, from −1 to 1.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// The longest side of a part on a CPU, px: one that takes some 1.5 GB with either network.
const MOST_ON_CPU: usize = 1088;

/// The same on a GPU: its largest tensor, of 64 channels, is within the 128 MiB that every adapter has for a buffer.
const MOST_ON_GPU: usize = 720;

/// What the network is given of a picture from 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Input {
    /// −1 to 1, as the network's scaling expects.
    #[default]
    Scaled,
    /// 0 to 1 as it is, as the evaluation of 3D Gaussian splatting's original implementation has it, and those that compare
    /// with its numbers. Values are lower than those of [`Self::Scaled`] as a rule.
    Unscaled,
}

impl Input {
    /// The range that the network is given.
    pub fn range(self) -> &'static str {
        match self {
            Self::Scaled => "-1..1",
            Self::Unscaled => "0..1",
        }
    }
}

/// A picture that the network makes no features of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "the picture is {width} x {height} px, and the network {} of LPIPS needs {least} px or more each way",
    net.name()
)]
pub struct TooSmall {
    /// Of the picture, px.
    pub width: usize,
    /// Of the picture, px.
    pub height: usize,
    /// The shortest side that will do, px.
    pub least: usize,
    /// The network that was asked.
    pub net: Net,
}

/// A convolution's weights `[out, in, side, side]` and biases `[out]`.
#[derive(Clone, Debug)]
struct Convolution {
    weight: Tensor<4>,
    bias: Tensor<1>,
}

/// The metric: a network with its weights on a device. Gradients are not followed.
#[derive(Clone, Debug)]
pub struct Lpips {
    net: Net,
    input: Input,
    /// In the order of the network's layers.
    convolutions: Vec<Convolution>,
    /// By tap, `[1, C]`.
    linear: Vec<Tensor<2>>,
    device: Device,
    /// The longest side of a part, px.
    most: usize,
}

impl Lpips {
    /// The network whose weights were read.
    pub fn net(&self) -> Net {
        self.net
    }

    /// What it is given of a picture.
    pub fn input(&self) -> Input {
        self.input
    }

    /// LPIPS of `image` and `truth`, `[H, W, 3]` each, RGB from 0 to 1, clamped first as a screen would: 0 for equal pictures,
    /// and rarely above 1. NaN if either holds what is not finite.
    ///
    /// # Errors
    /// If the pictures have no features at some tap of the network.
    ///
    /// # Panics
    /// If the pictures differ in size.
    pub fn distance(&self, image: Tensor<3>, truth: Tensor<3>) -> Result<f64, TooSmall> {
        let [height, width, _] = image.dims();
        assert_eq!(image.dims(), truth.dims(), "LPIPS compares pictures of one size");
        let features = [height, width].map(|side| self.net.features(side));
        let [Some(rows), Some(columns)] = features else {
            return Err(TooSmall { width, height, least: self.net.least_side(), net: self.net });
        };
        // A ReLU would turn NaN into black.
        let sum: f64 = (image.clone() + truth.clone()).sum().into_scalar();
        if !sum.is_finite() {
            return Ok(f64::NAN);
        }
        let pictures = [image, truth].map(|picture| self.placed(picture));
        let mut sums = [0.0; TAPS];
        for row in parts(self.net, height, self.most) {
            for column in parts(self.net, width, self.most) {
                let found = self.compare(&pictures, &row, &column);
                sums.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
            }
        }
        Ok((0..TAPS).map(|tap| sums[tap] / (rows[tap] * columns[tap]) as f64).sum())
    }

    /// `[1, 3, H, W]` on the network's device.
    fn placed(&self, picture: Tensor<3>) -> Tensor<4> {
        let picture = picture.inner().cast(DType::F32).to_device(&self.device).clamp(0.0, 1.0);
        picture.permute([2, 0, 1]).unsqueeze()
    }

    /// By tap: the sum over the features that are wanted of a part of both pictures.
    fn compare(&self, pictures: &[Tensor<4>; 2], row: &Part, column: &Part) -> [f64; TAPS] {
        let [mut a, mut b] = pictures
            .each_ref()
            .map(|picture| self.scaled(picture.clone().slice([0..1, 0..3, row.seen.clone(), column.seen.clone()])));
        let mut convolutions = self.convolutions.iter();
        let mut sums = Vec::with_capacity(TAPS);
        for ((slice, view), linear) in self.net.slices().into_iter().zip(self.net.views()).zip(&self.linear) {
            for layer in slice {
                [a, b] = match *layer {
                    Layer::Pool { window } => [a, b].map(|features| pooled(features, window)),
                    Layer::Conv { window, .. } => {
                        let convolution = convolutions.next().expect("read for every layer of the table");
                        [a, b].map(|features| convolution.over(features, window))
                    }
                };
            }
            let [_, channels, height, width] = a.dims();
            let (rows, columns) = (row.wanted(view.stride, height), column.wanted(view.stride, width));
            sums.push(match rows.is_empty() || columns.is_empty() {
                true => Tensor::zeros([1], &self.device),
                false => {
                    let (height, width) = (rows.len(), columns.len());
                    let wanted = [0..1, 0..channels, rows, columns];
                    let [a, b] = [&a, &b].map(|features| {
                        let wanted = features.clone().slice(wanted.clone());
                        unit(wanted.permute([0, 2, 3, 1]).reshape([height * width, channels]))
                    });
                    let distances = ((a - b).square() * linear.clone()).sum_dim(1);
                    // By rows: a backend may add a million numbers one after the other.
                    distances.reshape([height, width]).sum_dim(1).sum()
                }
            });
        }
        // Read together: each reading waits for the device.
        let sums: Vec<f64> = Tensor::cat(sums, 0).into_data().iter::<f64>().collect();
        sums.try_into().expect("a sum for every tap")
    }

    /// As the network wants its colours.
    fn scaled(&self, picture: Tensor<4>) -> Tensor<4> {
        let picture = match self.input {
            Input::Scaled => picture * 2.0 - 1.0,
            Input::Unscaled => picture,
        };
        let colour = |of: [f32; 3]| Tensor::<1>::from_floats(of, &self.device).reshape([1, 3, 1, 1]);
        (picture - colour(SHIFT)) / colour(SCALE)
    }
}

impl Convolution {
    fn over(&self, features: Tensor<4>, Window { stride, padding, .. }: Window) -> Tensor<4> {
        let options = ConvOptions::new([stride; 2], [padding; 2], [1; 2], 1);
        relu(conv2d(features, self.weight.clone(), Some(self.bias.clone()), options))
    }
}

fn pooled(features: Tensor<4>, Window { side, stride, .. }: Window) -> Tensor<4> {
    max_pool2d(features, MaxPoolOptions::new([side; 2]).with_stride([stride; 2]))
}

/// Unit vectors from rows of features, and zeros where there is none. Rows, because Burn 0.22.1 fuses the sum over the channels of a
/// convolution's `[1, C, 1, 1]` with the root of it into a kernel for GPUs that gives something else.
fn unit(features: Tensor<2>) -> Tensor<2> {
    let length = features.clone().square().sum_dim(1).sqrt();
    features / (length + LENGTH_EPSILON)
}

#[cfg(test)]
pub(crate) mod tests;
