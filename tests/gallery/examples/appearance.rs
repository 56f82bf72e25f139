//! Appearance (after Martin-Brualla et al. 2021, "NeRF in the Wild", and Xu et al. 2024, "Splatfacto-W"): photographs differ in exposure and
//! white balance. A network turns a photograph's embedding and a Gaussian's features into the Gaussian's colour there.
//! A held-out photograph gets its embedding from its left half; the right half is scored.
//! Run: `cargo run --release -p splat-gallery --example appearance -- appearance.png [CAPTURE]`.
use burn::module::{Module, Param};
use burn::nn::{Linear, LinearConfig};
use burn::tensor::activation::{relu, sigmoid};
use burn::tensor::{Device, Distribution, Tensor};
use burn_optim::{AdamConfig, GradientsParams};
use splat_demo::DemoOptions;
use splat_gallery::{SMALL, Shot, capture, demo, picture, save, shown};
use splat_model::gaussians::Gaussians;
use splat_model::init;
use splat_model::loss::{DEFAULT_LAMBDA, l1, photometric};
use splat_op::{Colour, SplatError, Splats};

const FEATURES: usize = 16;
const EMBEDDING: usize = 8;
const STEPS: usize = 1500;

/// A scene whose colours depend on the photograph.
#[derive(Module, Debug)]
struct Wild {
    scene: Gaussians,
    /// `[N, FEATURES]`.
    features: Param<Tensor<2>>,
    hidden: Linear,
    output: Linear,
}

/// What a photograph looks like, `[1, EMBEDDING]`.
#[derive(Module, Debug)]
struct Appearance {
    embedding: Param<Tensor<2>>,
}

impl Appearance {
    fn new(device: &Device) -> Self {
        Self { embedding: Param::from_tensor(Tensor::zeros([1, EMBEDDING], device)) }
    }
}

impl Wild {
    fn splats(&self, embedding: &Tensor<2>) -> Splats {
        let (features, splats) = (self.features.val(), self.scene.splats());
        let count = features.dims()[0];
        let inputs = Tensor::cat(vec![features.clone(), embedding.clone().repeat_dim(0, count)], 1);
        // The first three features are the colour itself, so that the network learns what the photograph changes.
        let colour = features.narrow(1, 0, 3) + self.output.forward(relu(self.hidden.forward(inputs)));
        // Centres stay where the survey found them, so that one learning rate suits everything else.
        Splats { means: splats.means.clone().detach(), colour: Colour::Features(sigmoid(colour)), ..splats }
    }

    /// The photograph's render, `[H, W, 3]`.
    fn image(&self, appearance: &Appearance, shot: &Shot) -> Result<Tensor<3>, SplatError> {
        Ok(shot.seen(shown(&self.splats(&appearance.embedding.val()), &shot.camera)?.colour))
    }
}

/// The left half of a picture.
fn half(picture: Tensor<3>) -> Tensor<3> {
    let width = picture.dims()[1];
    picture.narrow(1, 0, width / 2)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    device.seed(1);
    let (mut shots, points) = match std::env::args().nth(2) {
        Some(folder) => capture(folder.as_ref(), &device)?,
        None => demo(DemoOptions { exposure: true, ..SMALL }, &device)?,
    };
    let held_out = shots.split_off(shots.len() - shots.len() / 6);
    let scene = Gaussians::from_rows(&init::from_points(&points), &device)?;
    let count = scene.len();
    let mut wild = Wild {
        scene,
        features: Param::from_tensor(Tensor::random([count, FEATURES], Distribution::Uniform(-0.5, 0.5), &device)),
        hidden: LinearConfig::new(FEATURES + EMBEDDING, 32).init(&device),
        output: LinearConfig::new(32, 3).init(&device),
    };
    let mut looks: Vec<Appearance> = shots.iter().map(|_| Appearance::new(&device)).collect();
    let (mut of_scene, mut of_looks) = (AdamConfig::new().init(), AdamConfig::new().init());
    for step in 0..STEPS {
        let view = step * 7 % shots.len();
        let loss = photometric(wild.image(&looks[view], &shots[view])?, &shots[view].truth, DEFAULT_LAMBDA);
        let mut gradients = loss.backward();
        let rate = 0.01 * 0.1_f64.powf(step as f64 / STEPS as f64);
        let of_look = GradientsParams::from_module(&mut gradients, &looks[view]);
        looks[view] = of_looks.step(5.0 * rate, looks[view].clone(), of_look);
        let of_wild = GradientsParams::from_grads(gradients, &wild);
        wild = of_scene.step(rate, wild, of_wild);
    }

    let (mut plain, mut fitted, mut pictures) = (0.0, 0.0, Vec::new());
    for shot in &held_out {
        let mut look = Appearance::new(&device);
        let score = |look: &Appearance| -> Result<f64, SplatError> {
            let width = shot.camera.intrinsics.width;
            Ok(shot.score(wild.image(look, shot)?, width / 2..width))
        };
        plain += score(&look)? / held_out.len() as f64;
        pictures = vec![shot.image(), wild.image(&look, shot)?];
        let mut optimiser = AdamConfig::new().init();
        for _ in 0..60 {
            let seen = half(wild.image(&look, shot)?);
            let loss = l1(seen, Tensor::from_inner(half(shot.image())));
            let gradients = GradientsParams::from_grads(loss.backward(), &look);
            look = optimiser.step(0.05, look, gradients);
        }
        fitted += score(&look)? / held_out.len() as f64;
        pictures.push(wild.image(&look, shot)?);
    }
    println!("{count} Gaussians; right halves of {} unseen photographs", held_out.len());
    println!("mean appearance {plain:.2} dB, appearance of the left half {fitted:.2} dB");
    assert!(fitted > plain + 1.0, "embeddings explain nothing");
    save(&picture()?, pictures)
}
