//! A scene that moves (after Yang et al. 2024, "Deformable 3D Gaussians"): a network of place and time moves the Gaussians of one scene.
//! Each photograph has its own time. Photographs of unseen times and places are scored.
//! Run: `cargo run --release -p splat-gallery --example deformation -- deformation.png`.
use std::f32::consts::PI;

use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};
use burn_optim::{AdamConfig, GradientsParams};
use splat_demo::{DemoOptions, moving};
use splat_gallery::{SMALL, Shot, picture, quality, save, shown};
use splat_model::gaussians::Gaussians;
use splat_model::init;
use splat_model::loss::{DEFAULT_LAMBDA, photometric};
use splat_op::{SplatError, Splats};

const WAVES: usize = 4;
const STEPS: usize = 1500;

/// The network that moves a scene.
#[derive(Module, Debug)]
struct Motion {
    first: Linear,
    second: Linear,
    shift: Linear,
}

/// Sines and cosines of `[N, K]` at frequencies that double, beside the numbers themselves: `[N, K (1 + 2 WAVES)]`.
fn encoded(numbers: Tensor<2>) -> Tensor<2> {
    let numbers = numbers * 0.5;
    let waves = (0..WAVES).flat_map(|i| {
        let angles = numbers.clone() * (PI * (1 << i) as f32 / 2.0);
        [angles.clone().sin(), angles.cos()]
    });
    Tensor::cat(std::iter::once(numbers.clone()).chain(waves).collect(), 1)
}

impl Motion {
    fn new(device: &Device) -> Self {
        let nothing = Initializer::Uniform { min: -1e-3, max: 1e-3 };
        Self {
            first: LinearConfig::new(4 * (1 + 2 * WAVES), 64).init(device),
            second: LinearConfig::new(64, 64).init(device),
            shift: LinearConfig::new(64, 3).with_initializer(nothing).init(device),
        }
    }

    /// The scene at a time, 0 to 1. Centres move by the network alone.
    fn splats(&self, scene: &Gaussians, time: f64) -> Splats {
        let still = still(scene);
        let times = Tensor::full([scene.len(), 1], time, &still.means.device());
        let at = encoded(Tensor::cat(vec![still.means.clone(), times], 1));
        let shift = self.shift.forward(relu(self.second.forward(relu(self.first.forward(at)))));
        Splats { means: still.means.clone() + shift, ..still }
    }
}

/// The scene without motion.
fn still(scene: &Gaussians) -> Splats {
    Splats { means: scene.means().detach(), ..scene.splats() }
}

/// A scene that is trained with or without motion, and the mean over unseen photographs, dB.
fn trained(
    mut scene: Gaussians,
    mut motion: Option<Motion>,
    [seen, unseen]: [&[(Shot, f64)]; 2],
) -> Result<(Gaussians, Option<Motion>, f64), SplatError> {
    let at = |scene: &Gaussians, motion: &Option<Motion>, time: f64| match motion {
        Some(motion) => motion.splats(scene, time),
        None => still(scene),
    };
    let (mut of_scene, mut of_motion) = (AdamConfig::new().init(), AdamConfig::new().init());
    for step in 0..STEPS {
        let (shot, time) = &seen[step * 11 % seen.len()];
        let image = shown(&at(&scene, &motion, *time), &shot.camera)?.colour;
        let mut gradients = photometric(image, &shot.truth, DEFAULT_LAMBDA).backward();
        let rate = 0.01 * 0.1_f64.powf(step as f64 / STEPS as f64);
        if let Some(network) = motion.take() {
            let of_network = GradientsParams::from_module(&mut gradients, &network);
            motion = Some(of_motion.step(0.2 * rate, network, of_network));
        }
        let gradients = GradientsParams::from_grads(gradients, &scene);
        scene = of_scene.step(rate, scene, gradients);
    }
    let found =
        quality(unseen, |(shot, time)| Ok((shown(&at(&scene, &motion, *time), &shot.camera)?.colour, shot.image())))?;
    Ok((scene, motion, found))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = Device::flex().autodiff();
    device.seed(1);
    let (photos, points) = moving(&DemoOptions { views: 60, ..SMALL });
    let shots = photos.into_iter().map(|(photo, time)| (Shot::new(photo, &device), time));
    let (unseen, seen): (Vec<_>, Vec<_>) = shots.enumerate().partition(|(i, _)| i % 8 == 0);
    let [unseen, seen] = [unseen, seen].map(|some| some.into_iter().map(|(_, shot)| shot).collect::<Vec<_>>());
    let start = Gaussians::from_rows(&init::from_points(&points), &device)?;
    let (_, _, without) = trained(start.clone(), None, [&seen, &unseen])?;
    let (scene, motion, with) = trained(start, Some(Motion::new(&device)), [&seen, &unseen])?;
    println!("{} unseen photographs: still {without:.2} dB, moving {with:.2} dB", unseen.len());
    assert!(with > without + 0.5, "the network explains nothing");
    let motion = motion.ok_or("it was trained")?;
    // The planet is at one end of its circle at time 0, and 0.5 from there against x at time 0.5. Points near it stand still.
    let planet = Tensor::<1>::from_floats([0.35, 0.28, 0.56], &device.clone().inner()).unsqueeze::<2>();
    let means = |time| motion.splats(&scene, time).means.inner();
    let of_planet = (scene.means().inner() - planet).square().sum_dim(1).lower_elem(0.36).float();
    let moved = ((means(0.5) - means(0.0)) * of_planet.clone()).sum_dim(0) / of_planet.sum_dim(0);
    let moved: Vec<f32> = moved.into_data().iter::<f32>().collect();
    println!("from time 0 to 0.5 the planet moves by {moved:.2?}");
    assert!(moved[0] < -0.15 && moved[1].abs() < 0.1 && moved[2].abs() < 0.1, "it moves otherwise");
    let at = |time| shown(&motion.splats(&scene, time), &unseen[2].0.camera).map(|seen| seen.colour);
    save(&picture()?, vec![at(0.0)?, at(0.25)?, at(0.5)?, at(0.75)?])
}
