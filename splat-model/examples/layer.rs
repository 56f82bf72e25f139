//! Splatting as the last layer of a Burn model: an MLP predicts the colours of a fixed grid of Gaussians, and learns
//! through the render to paint a picture. Geometry and network train together.
use burn::module::{Module, Param};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Tensor};
use burn_optim::{AdamConfig, GradientsParams};
use glam::DAffine3;
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, render};

const SIDE: usize = 24;

/// A network from positions to a picture.
#[derive(Module, Debug)]
struct Painter {
    hidden: Linear,
    output: Linear,
    log_scales: Param<Tensor<2>>,
}

impl Painter {
    fn new(device: &Device) -> Self {
        Self {
            hidden: LinearConfig::new(2, 32).init(device),
            output: LinearConfig::new(32, 3).init(device),
            log_scales: Param::from_tensor(Tensor::full([SIDE * SIDE, 3], -3.0, device)),
        }
    }

    fn forward(&self, means: &Tensor<2>, camera: &Camera) -> Tensor<3> {
        let count = means.dims()[0];
        let device = means.device();
        let plane = means.clone().slice([0..count, 0..2]);
        let colours = sigmoid(self.output.forward(relu(self.hidden.forward(plane * 4.0))));
        let splats = Splats {
            means: means.clone(),
            rotations: Tensor::<2>::from_floats([[1.0, 0.0, 0.0, 0.0]], &device).repeat_dim(0, count),
            scales: self.log_scales.val().exp(),
            opacities: Tensor::full([count], 0.8, &device),
            colour: Colour::Features(colours),
        };
        let rendered = render(&splats, std::slice::from_ref(camera), &Extras::default(), &RenderOptions::standard());
        rendered.expect("shapes are right by construction").colour.squeeze_dim(0)
    }
}

fn main() {
    let device = Device::flex().autodiff();
    let camera = Camera::new(Intrinsics::centred(64, 64, 64.0), &DAffine3::IDENTITY, &device);
    let step = |i: usize| (i as f32 + 0.5) / SIDE as f32 - 0.5;
    let grid: Vec<f32> = (0..SIDE * SIDE).flat_map(|i| [step(i % SIDE), step(i / SIDE), 1.0]).collect();
    let means = Tensor::<1>::from_floats(grid.as_slice(), &device).reshape([SIDE * SIDE, 3]);
    let target = target(&device);

    let mut painter = Painter::new(&device);
    let mut optimiser = AdamConfig::new().init();
    let mut first = None;
    for i in 1..=200 {
        let loss = (painter.forward(&means, &camera) - target.clone()).square().mean();
        let value = loss.clone().into_scalar::<f32>();
        first.get_or_insert(value);
        if i % 50 == 0 {
            println!("step {i:3}  loss {value:.5}");
        }
        let gradients = GradientsParams::from_grads(loss.backward(), &painter);
        painter = optimiser.step(0.01, painter, gradients);
    }
    let last = (painter.forward(&means, &camera) - target).square().mean().into_scalar::<f32>();
    println!("from {:.5} to {last:.5}", first.unwrap_or_default());
    assert!(last < 0.25 * first.unwrap_or_default(), "the model did not learn");
}

/// A yellow disc on blue.
fn target(device: &Device) -> Tensor<3> {
    let pixel = |i: usize| (i as f32 - 31.5) / 32.0;
    let paint = |x: f32, y: f32| if x * x + y * y < 0.4 { [0.9, 0.8, 0.1] } else { [0.1, 0.2, 0.6] };
    let values: Vec<f32> = (0..64 * 64).flat_map(|i| paint(pixel(i % 64), pixel(i / 64))).collect();
    Tensor::<1>::from_floats(values.as_slice(), device).reshape([64, 64, 3])
}
