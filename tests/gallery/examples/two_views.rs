//! Gaussians from two photographs in one pass (after Charatan et al. 2024, "pixelSplat", and Chen et al. 2024, "MVSplat"): a network
//! compares the features of both along each pixel's ray and predicts a Gaussian for each pixel. It is scored on unseen pairs.
//! Run: `cargo run --release -p splat-gallery --example two_views -- two_views.png`.
use burn::module::Module;
use burn::nn::PaddingConfig2d::Same;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::tensor::activation::{relu, sigmoid, softmax};
use burn::tensor::ops::{GridSampleOptions, InterpolateMode};
use burn::tensor::{Device, Tensor, TensorData};
use burn_optim::{AdamConfig, GradientsParams};
use splat_demo::DemoOptions;
use splat_gallery::{SMALL, Shot, demo, picture, quality, rays, rows, save, shown, transformed};
use splat_model::capture::Photo;
use splat_model::loss::{DEFAULT_LAMBDA, photometric};
use splat_op::{Colour, Intrinsics, SplatError, Splats};

const FEATURES: usize = 16;
/// Depths that are compared, scene units, evenly spaced in 1 / depth.
const DEPTHS: usize = 16;
const NEAR_FAR: [f64; 2] = [2.5, 14.0];
const STEPS: usize = 300;

fn depth(k: usize) -> f64 {
    let [near, far] = NEAR_FAR.map(f64::recip);
    1.0 / (near + (far - near) * k as f64 / (DEPTHS - 1) as f64)
}

/// Where the other photograph shows each pixel at each depth: `[DEPTHS, H, W, 2]`, from −1 to 1.
fn places(own: &Photo, other: &Photo, device: &Device) -> Tensor<4> {
    let Intrinsics { width, height, fx, fy, cx, cy, .. } = other.intrinsics;
    let all = (0..DEPTHS).map(|k| rays(own, device) * depth(k)).collect();
    let at = transformed(&(other.cam_from_world * own.cam_from_world.inverse()), Tensor::cat(all, 0));
    let of = |axis| at.clone().narrow(1, axis, 1);
    let z = of(2).clamp_min(1e-3);
    let x = (of(0) / z.clone() * fx + cx) * (2.0 / width as f64) - 1.0;
    let y = (of(1) / z * fy + cy) * (2.0 / height as f64) - 1.0;
    Tensor::cat(vec![x, y], 1).reshape([DEPTHS, height, width, 2])
}

#[derive(Module, Debug)]
struct TwoViews {
    first: Conv2d,
    second: Conv2d,
    /// From the features' likeness at each depth.
    likeness: Conv2d,
    /// Size and opacity.
    shape: Conv2d,
}

impl TwoViews {
    fn new(device: &Device) -> Self {
        let conv = |from, to| Conv2dConfig::new([from, to], [3, 3]).with_padding(Same).init(device);
        Self {
            first: conv(3, FEATURES),
            second: conv(FEATURES, FEATURES),
            likeness: conv(DEPTHS, DEPTHS),
            shape: conv(FEATURES + DEPTHS, 2),
        }
    }

    fn features(&self, shot: &Shot) -> Tensor<4> {
        let image = Tensor::from_inner(shot.image()).permute([2, 0, 1]).unsqueeze::<4>();
        self.second.forward(relu(self.first.forward(image)))
    }

    /// Centres, scales, opacities and colours of a Gaussian for each pixel of a photograph, which is compared with the other.
    fn half(&self, own: &Shot, other: &Shot, device: &Device) -> [Tensor<2>; 4] {
        let (of_own, of_other) = (self.features(own), self.features(other).repeat_dim(0, DEPTHS));
        let options = GridSampleOptions::new(InterpolateMode::Bilinear);
        let alike = of_other.grid_sample_2d(places(&own.photo, &other.photo, device), options) * of_own.clone();
        let alike = alike.sum_dim(1).permute([1, 0, 2, 3]);
        let at_depth = softmax(alike.clone() + self.likeness.forward(alike), 1);
        let inverse: Vec<f64> = (0..DEPTHS).map(|k| depth(k).recip()).collect();
        let inverse = Tensor::from_data(TensorData::new(inverse, [DEPTHS, 1]), device);
        let depth = rows(at_depth.clone()).matmul(inverse).recip();
        let shape = rows(self.shape.forward(Tensor::cat(vec![of_own, at_depth], 1)));
        let size = depth.clone() * (sigmoid(shape.clone().narrow(1, 0, 1)) / own.photo.intrinsics.fx);
        let means = transformed(&own.photo.cam_from_world.inverse(), rays(&own.photo, device) * depth);
        let colours = Tensor::from_inner(own.image()).reshape([-1, 3]);
        [means, size.repeat_dim(1, 3), sigmoid(shape.narrow(1, 1, 1) + 2.0), colours]
    }

    /// The target's picture, `[H, W, 3]`, from two photographs.
    fn forward(&self, [a, b]: [&Shot; 2], target: &Shot, device: &Device) -> Result<Tensor<3>, SplatError> {
        let halves = self.half(a, b, device).into_iter().zip(self.half(b, a, device));
        let mut both = halves.map(|(one, two)| Tensor::cat(vec![one, two], 0));
        let mut next = || both.next().expect("four tensors");
        let (means, scales, opacities, colours) = (next(), next(), next().squeeze_dim(1), next());
        let rotations = Tensor::<2>::from_floats([[1.0, 0.0, 0.0, 0.0]], device).repeat_dim(0, means.dims()[0]);
        let splats = Splats { means, rotations, scales, opacities, colour: Colour::Features(colours) };
        Ok(shown(&splats, &target.camera)?.colour)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    device.seed(1);
    // Photographs three apart stand at one height, 15° apart. The last fifth of the circle is for scoring.
    let (shots, _) = demo(DemoOptions { width: 48, height: 36, views: 72, ..SMALL }, &device)?;
    let unseen = 60..68;
    let mut network = TwoViews::new(&device);
    let image_of = |network: &TwoViews, i: usize| network.forward([&shots[i - 3], &shots[i + 3]], &shots[i], &device);
    let quality_of = |network: &TwoViews| quality(unseen.clone(), |i| Ok((image_of(network, i)?, shots[i].image())));
    let before = quality_of(&network)?;
    let mut optimiser = AdamConfig::new().init();
    for step in 0..STEPS {
        let i = 3 + step * 17 % 51;
        let loss = photometric(image_of(&network, i)?, &shots[i].truth, DEFAULT_LAMBDA);
        if step % 50 == 0 {
            println!("step {step:3}  loss {:.4}", loss.clone().into_scalar::<f32>());
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &network);
        network = optimiser.step(0.005, network, gradients);
    }
    let after = quality_of(&network)?;
    println!("unseen pairs: {before:.2} dB at first, {after:.2} dB trained");
    assert!(after > before + 1.0, "the network learnt nothing");
    let (i, image) = (unseen.start, image_of(&network, unseen.start)?);
    save(&picture()?, vec![shots[i - 3].image(), shots[i + 3].image(), image, shots[i].image()])
}
