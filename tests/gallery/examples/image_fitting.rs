//! A picture as Gaussians (after Zhang et al. 2024, "GaussianImage"): flat Gaussians in front of one camera fit a photograph with
//! Burn's own optimiser. Prints bytes, at nine numbers of two bytes for each Gaussian, against dB.
//! Run with a picture: `cargo run --release -p splat-gallery --example image_fitting -- PICTURE fitted.png`.
use burn::module::{Module, Param};
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use burn_optim::{AdamConfig, GradientsParams};
use glam::DAffine3;
use splat_gallery::{save, shown};
use splat_model::loss::{Truth, photometric};
use splat_model::metrics::psnr;
use splat_op::{Camera, Colour, Intrinsics, SplatError, Splats};

/// Largest side of the fitted picture, px.
const SIDE: u32 = 96;
const STEPS: usize = 200;

/// Gaussians in the plane z = 1.
#[derive(Module, Debug)]
struct Picture {
    /// `[N, 2]`: centres, in shares of the longer side.
    centres: Param<Tensor<2>>,
    /// `[N, 2]`: logarithms of the standard deviations.
    log_scales: Param<Tensor<2>>,
    /// `[N, 1]`: angles, rad.
    angles: Param<Tensor<2>>,
    /// `[N, 4]`: logits of colour and opacity.
    paint: Param<Tensor<2>>,
}

impl Picture {
    fn new(count: usize, device: &Device) -> Self {
        let random = |width, low, high| {
            Param::from_tensor(Tensor::random([count, width], Distribution::Uniform(low, high), device))
        };
        let size = (0.5 / (count as f64).sqrt()).ln();
        Self {
            centres: random(2, -0.5, 0.5),
            log_scales: random(2, size - 0.2, size + 0.2),
            angles: random(1, 0.0, 3.0),
            paint: random(4, -0.5, 0.5),
        }
    }

    /// The render, `[H, W, 3]`.
    fn forward(&self, camera: &Camera) -> Result<Tensor<3>, SplatError> {
        let (centres, log_scales) = (self.centres.val(), self.log_scales.val());
        let flat = centres.clone().narrow(1, 0, 1);
        let (ones, half) = (flat.ones_like(), self.angles.val() * 0.5);
        let zeros = flat.zeros_like();
        let paint = sigmoid(self.paint.val());
        let splats = Splats {
            means: Tensor::cat(vec![centres, ones.clone()], 1),
            rotations: Tensor::cat(vec![half.clone().cos(), zeros.clone(), zeros, half.sin()], 1),
            scales: Tensor::cat(vec![log_scales.exp(), ones * 1e-3], 1),
            opacities: paint.clone().narrow(1, 3, 1).squeeze_dim(1),
            colour: Colour::Features(paint.narrow(1, 0, 3)),
        };
        Ok(shown(&splats, camera)?.colour)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let source = arguments.next().ok_or("pass a picture")?;
    let target = arguments.next().ok_or("pass the picture to write")?;
    let device = Device::flex().autodiff();
    let picture = image::open(&source)?.thumbnail(SIDE, SIDE).to_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let numbers: Vec<f32> = picture.iter().map(|value| f32::from(*value) / 255.0).collect();
    let truth: Tensor<3> = Tensor::from_data(TensorData::new(numbers, [height, width, 3]), &device.clone().inner());
    let prepared = Truth::new(truth.clone());
    let focal = width.max(height) as f64;
    let camera = Camera::new(Intrinsics::centred(width, height, focal), &DAffine3::IDENTITY, &device);

    let (mut before, mut pictures) = (0.0, vec![truth.clone()]);
    for count in [50, 200, 800] {
        let mut model = Picture::new(count, &device);
        let mut optimiser = AdamConfig::new().init();
        for step in 0..STEPS {
            let loss = photometric(model.forward(&camera)?, &prepared, 0.1);
            let gradients = GradientsParams::from_grads(loss.backward(), &model);
            let rate = 0.02 * 0.1_f64.powf(step as f64 / STEPS as f64);
            model = optimiser.step(rate, model, gradients);
        }
        let fitted = model.forward(&camera)?.inner().clamp(0.0, 1.0);
        let found = psnr(fitted.clone(), truth.clone());
        println!("{count:4} Gaussians  {:6} bytes  {found:.2} dB", 18 * count);
        assert!(found > before, "more Gaussians fit no better");
        before = found;
        pictures.push(fitted);
    }
    save(&target, pictures)
}
