//! Feature splatting (after Zhou et al. 2024, "Feature 3DGS"): each Gaussian carries 16 features, whose render learns a map of
//! features of each photograph. A click on a pixel then selects the Gaussians that look alike in them.
//! Run with a capture: `cargo run --release -p splat-gallery --example feature_splatting -- CAPTURE selected.png`.
use std::f32::consts::TAU;

use burn::tensor::{Device, Tensor};
use splat_gallery::{capture, save, shown};
use splat_model::gaussians::GroupOptions;
use splat_model::loss::{DEFAULT_LAMBDA, photometric};
use splat_model::trainer::{LossInputs, TrainConfig, Trainer};
use splat_op::{Colour, Splats};

const FEATURES: usize = 16;

/// The map to learn, `[H, W, 16]`, of a photograph, `[H, W, 3]`. A network such as CLIP or DINO takes this place; here it is waves
/// over colour space (Rahimi and Recht 2007), which are alike where colours are.
fn teacher(photograph: Tensor<3>) -> Tensor<3> {
    let [height, width, _] = photograph.dims();
    let waves: Vec<f32> = (0..3 * FEATURES).map(|i| 4.0 * ((i * 7919 % 101) as f32 / 101.0 - 0.5)).collect();
    let phases: Vec<f32> = (0..FEATURES).map(|i| TAU * i as f32 / FEATURES as f32).collect();
    let device = photograph.device();
    let waves = Tensor::<1>::from_floats(&waves[..], &device).reshape([3, FEATURES]);
    let phases = Tensor::<1>::from_floats(&phases[..], &device).reshape([1, FEATURES]);
    (photograph.reshape([height * width, 3]).matmul(waves) + phases).cos().reshape([height, width, FEATURES])
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("pass the folder of a capture")?;
    let picture = arguments.next().ok_or("pass the picture to write")?;
    let (device, config) = (Device::flex(), TrainConfig::for_steps(200));
    let (shots, points) = capture(folder.as_ref(), &device)?;
    let photos = shots.iter().map(|shot| shot.photo.clone()).collect();
    let options = GroupOptions { rate: 0.02, final_share: 0.1, ..GroupOptions::default() };
    let mut trainer = Trainer::new(photos, &points, config, &device)?
        .with_group("features", FEATURES, options)?
        .with_loss(|seen: &LossInputs| {
            let features = seen.features(seen.group("features")).expect("16 features for each Gaussian");
            let error = (features - teacher(seen.truth.image())).abs().mean();
            photometric(seen.image.clone(), seen.truth, DEFAULT_LAMBDA) + error
        });
    while !trainer.is_done() {
        let report = trainer.step()?;
        if report.step % 50 == 0 {
            let loss = report.loss.into_scalar::<f32>();
            println!("step {:3}  loss {loss:.4}  {} Gaussians", report.step, report.splats);
        }
    }

    // A click on the spotted sphere of the demo's first photograph.
    let scene = trainer.gaussians().untracked();
    let features = scene.group("features").ok_or("the scene has the group")?.values();
    let show = |splats: &Splats| shown(splats, &shots[0].camera);
    let splats = scene.splats();
    let map = show(&Splats { colour: Colour::Features(features.clone()), ..splats.clone() })?.colour;
    let [height, width, _] = map.dims();
    let [x, y] = [3 * width / 4, 5 * height / 9];
    let clicked = map.clone().narrow(0, y, 1).narrow(1, x, 1).reshape([1, FEATURES]);
    let length = |rows: Tensor<2>| rows.square().sum_dim(1).sqrt().clamp_min(1e-6);
    let likeness = (features.clone() * clicked.clone()).sum_dim(1) / (length(features) * length(clicked));
    let alike = likeness.greater_elem(0.95).squeeze_dim::<1>(1);
    let chosen = alike.clone().int().sum().into_scalar::<i64>();
    println!("{chosen} of {} Gaussians are like pixel {x}, {y}", scene.len());

    let opacities = splats.opacities.clone().mask_fill(alike.bool_not(), 0.0);
    let selected = show(&Splats { opacities, ..splats })?.colour;
    // Three of the features as colours.
    save(&picture, vec![shots[0].image(), map.narrow(2, 0, 3) * 0.5 + 0.5, selected])
}
