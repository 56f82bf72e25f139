//! LPIPS: the perceptual difference of two pictures, by the features of a network trained on photographs.
//!
//! Zhang et al. 2018, "The unreasonable effectiveness of deep features as a perceptual metric", in version 0.1 of the authors'
//! package `lpips`. With `f` and `g` the features of the two pictures after tap `l` of the network, normalised to unit length
//! over the channels `c` at each position `p`,
//!
//! ```text
//! LPIPS = Σ_l  mean_p  Σ_c  w_lc (f_lcp − g_lcp)²
//! ```
//!
//! with weights `w ≥ 0` fitted to human judgements. This crate contains no network weights: [`Lpips::read`] reads them from a
//! file. `docs/METRICS.md` describes the names in that file and how to export it.
//!
//! Large pictures are compared in parts that include the receptive fields of their features, and the means are over the whole
//! picture. The values are those of the whole picture, and the memory is bounded.

mod layers;
mod weights;

use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{DType, Device, Tensor};
use thiserror::Error;

pub use self::layers::Net;
use self::layers::{NetworkLayer, SidePart, TAPS, parts};

/// Added to the length of a feature vector, as in the package's `normalize_tensor`.
const LENGTH_EPSILON: f64 = 1e-10;

/// Mean and deviation of the colours of photographs on a scale from −1 to 1, from the package's `ScalingLayer`.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

/// The longest side of a part on a CPU, px. Such a part takes about 1.5 GB with either network.
const MOST_ON_CPU: usize = 1088;

/// The longest side of a part on a GPU, px. The largest tensor of such a part, of 64 channels, fits into the 128 MiB that every
/// adapter supports for a buffer.
const MOST_ON_GPU: usize = 720;

/// A picture that is too small for the network.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct TooSmall(String);

/// A convolution's weights `[out, in, side, side]` and biases `[out]`.
#[derive(Clone, Debug)]
struct Convolution {
    weight: Tensor<4>,
    bias: Tensor<1>,
}

/// The metric: a network with its weights on a device. Gradients are not tracked.
#[derive(Clone, Debug)]
pub struct Lpips {
    net: Net,
    /// Convolutions, in the order of the network's layers.
    convolutions: Vec<Convolution>,
    /// Weights of the taps, `[1, C]` each.
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

    /// LPIPS of `image` and `truth`, `[H, W, 3]` each, RGB from 0 to 1, clamped first. Equal pictures have 0, and values above
    /// 1 are rare. NaN if either picture holds a value that is not finite.
    ///
    /// # Errors
    /// [`TooSmall`] if the pictures have no features at some tap of the network.
    ///
    /// # Panics
    /// If the pictures differ in size.
    pub fn distance(&self, image: Tensor<3>, truth: Tensor<3>) -> Result<f64, TooSmall> {
        let [height, width, _] = image.dims();
        assert_eq!(image.dims(), truth.dims(), "LPIPS compares pictures of one size");
        let features = [height, width].map(|side| self.net.features(side));
        let [Some(rows), Some(columns)] = features else {
            let (net, least) = (self.net.name(), self.net.least_side());
            let expected = format!("the network {net} of LPIPS needs at least {least} px in each direction");
            return Err(TooSmall(format!("the picture is {width} x {height} px, and {expected}")));
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

    /// The picture as `[1, 3, H, W]` on the network's device, clamped to 0..1.
    fn placed(&self, picture: Tensor<3>) -> Tensor<4> {
        let picture = picture.inner().cast(DType::F32).to_device(&self.device).clamp(0.0, 1.0);
        picture.permute([2, 0, 1]).unsqueeze()
    }

    /// The weighted squared differences of a part of both pictures by tap, summed over the features that belong to the part.
    fn compare(&self, pictures: &[Tensor<4>; 2], row: &SidePart, column: &SidePart) -> [f64; TAPS] {
        let [mut a, mut b] = pictures
            .each_ref()
            .map(|picture| self.scaled(picture.clone().slice([0..1, 0..3, row.seen.clone(), column.seen.clone()])));
        let mut convolutions = self.convolutions.iter();
        let mut sums = Vec::with_capacity(TAPS);
        for ((slice, view), linear) in self.net.slices().into_iter().zip(self.net.views()).zip(&self.linear) {
            for &NetworkLayer { convolution, side, stride, padding } in slice {
                [a, b] = if convolution.is_some() {
                    let Convolution { weight, bias } = convolutions.next().expect("read for every layer of the table");
                    let options = || ConvOptions::new([stride; 2], [padding; 2], [1; 2], 1);
                    [a, b].map(|features| relu(conv2d(features, weight.clone(), Some(bias.clone()), options())))
                } else {
                    let options = || MaxPoolOptions::new([side; 2]).with_stride([stride; 2]);
                    [a, b].map(|features| max_pool2d(features, options()))
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
                    // Summed by rows, because a backend may add a million numbers one after the other.
                    distances.reshape([height, width]).sum_dim(1).sum()
                }
            });
        }
        // Read together, because each read waits for the device.
        let sums: Vec<f64> = Tensor::cat(sums, 0).into_data().iter::<f64>().collect();
        sums.try_into().expect("a sum for every tap")
    }

    /// Scales colours to the network's input.
    fn scaled(&self, picture: Tensor<4>) -> Tensor<4> {
        let picture = picture * 2.0 - 1.0;
        let colour = |of: [f32; 3]| Tensor::<1>::from_floats(of, &self.device).reshape([1, 3, 1, 1]);
        (picture - colour(SHIFT)) / colour(SCALE)
    }
}

/// Normalises rows of features to unit length; rows of zeros stay zero. The features are rows because Burn 0.22.1 fuses the sum
/// over the channels of a convolution's `[1, C, 1, 1]` and its square root into a GPU kernel with a wrong result.
fn unit(features: Tensor<2>) -> Tensor<2> {
    let length = features.clone().square().sum_dim(1).sqrt();
    features / (length + LENGTH_EPSILON)
}

#[cfg(test)]
pub(crate) mod tests;
