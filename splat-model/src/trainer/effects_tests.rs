//! Runs with effects, on the capture of `testing.rs`.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use splat_op::{Camera, Extras, RenderOptions, render_view};

use super::testing::{HEIGHT, WIDTH, photos, points, ring, scene};
use super::*;
use crate::effects::Falling;
use crate::effects::background::{Backdrop, Background};
use crate::effects::depth::{DepthConfig, DepthSample};
use crate::effects::grid::GridConfig;
use crate::effects::pose::PoseConfig;
use crate::gaussians::values_of;
use crate::optim::LearningRates;

fn config(steps: usize) -> TrainConfig {
    let learning_rates =
        LearningRates { sh_dc: 0.05, opacities: 0.1, scales: 0.02, rotations: 0.01, ..LearningRates::default() };
    TrainConfig { steps, learning_rates, ..TrainConfig::default() }
}

fn train(photos: Vec<Photo>, config: TrainConfig) -> Trainer {
    let mut trainer = Trainer::new(photos, &points(), config, &Device::flex()).unwrap();
    while !trainer.is_done() {
        trainer.step().unwrap();
    }
    trainer
}

fn losses(trainer: &mut Trainer) -> Vec<f32> {
    let mut losses = Vec::new();
    while !trainer.is_done() {
        losses.push(trainer.step().unwrap().loss.into_scalar::<f32>());
    }
    losses
}

/// The angle between two poses, rad, and the distance between their centres.
fn apart(a: &DAffine3, b: &DAffine3) -> (f64, f64) {
    let between = glam::DQuat::from_mat3(&(a.matrix3 * b.matrix3.transpose()));
    let centre = |pose: &DAffine3| pose.inverse().translation;
    (between.angle_between(glam::DQuat::IDENTITY), centre(a).distance(centre(b)))
}

#[test]
fn a_camera_that_was_turned_finds_back() {
    let true_photos = ring(12);
    let mut given = ring(12);
    let turn = DAffine3::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 1.5_f64.to_radians());
    given[1].cam_from_world = turn * given[1].cam_from_world;
    let config = TrainConfig { poses: Some(PoseConfig::default()), ..config(720) };
    let trainer = train(given.clone(), config.clone());
    let refined = trainer.refined_poses().unwrap();
    assert_eq!(refined[1].0, given[1].name);
    let (before, _) = apart(&given[1].cam_from_world, &true_photos[1].cam_from_world);
    let (after, _) = apart(&refined[1].1, &true_photos[1].cam_from_world);
    assert!(after < 0.5 * before, "from {before} to {after} rad");
    let without = train(given, TrainConfig { poses: None, ..config });
    assert!(without.refined_poses().is_none());
}

/// Photographs of the scene in front of an environment that depends on the direction, and the environment.
fn outdoors() -> (Vec<Photo>, Background) {
    let light = Background::Environment(vec![[0.4, -0.2, 0.1], [0.3, 0.2, -0.3], [-0.2, 0.4, 0.2], [0.1, -0.3, 0.4]]);
    let device = Device::flex();
    let splats = scene(&device).splats();
    let photograph = |photo: Photo| {
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
        let picture = render_view(&splats, &camera, &Extras::default(), &RenderOptions::standard()).unwrap();
        let image = light.behind(picture.colour, picture.alpha, &photo.intrinsics, &photo.cam_from_world);
        let rgb = values_of(image).into_iter().map(|value| (255.0 * value).round() as u8).collect();
        Photo { rgb, ..photo }
    };
    (photos([0.0; 3]).into_iter().map(photograph).collect(), light)
}

#[test]
fn an_environment_is_learnt_beside_the_scene() {
    let (photos, light) = outdoors();
    let with = TrainConfig { backdrop: Backdrop::Environment { degree: 1 }, ..config(240) };
    let mut trainer = Trainer::new(photos.clone(), &points(), with, &Device::flex()).unwrap();
    let with = losses(&mut trainer);
    let mut plain = Trainer::new(photos.clone(), &points(), config(240), &Device::flex()).unwrap();
    let without = losses(&mut plain);
    let last = |losses: &[f32]| losses[220..].iter().sum::<f32>();
    assert!(last(&with) < 0.6 * last(&without), "{} and {}", last(&with), last(&without));
    // At the picture's border, where no Gaussian is in front, the environment is the true one.
    let shown = |background: &Background| {
        let nothing = |channels: usize| Tensor::zeros([HEIGHT, WIDTH, channels], &Device::flex());
        values_of(background.behind(nothing(3), nothing(1), &photos[0].intrinsics, &photos[0].cam_from_world))
    };
    let difference =
        |a: Vec<f32>, b: Vec<f32>| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32;
    let error = difference(shown(&trainer.background()), shown(&light));
    assert!(error < 0.1, "{error}");
    assert_eq!(plain.background(), Background::Colour([0.0; 3]));
}

#[test]
fn a_background_colour_is_learnt() {
    let truth = [0.2, 0.6, 0.9];
    let config = TrainConfig { backdrop: Backdrop::Learned, background: [0.5; 3], ..config(320) };
    let Background::Colour(found) = train(photos(truth), config.clone()).background() else { panic!("a colour") };
    for (found, truth) in found.into_iter().zip(truth) {
        assert!((found - truth).abs() < 0.05, "{found} instead of {truth}");
    }
    let beyond = TrainConfig { backdrop: Backdrop::Environment { degree: 5 }, ..config.clone() };
    let error = Trainer::new(photos(truth), &points(), beyond, &Device::flex()).err().unwrap().to_string();
    assert!(error.contains("environment` is 5") && error.contains("0 to 4"), "{error}");
    let mut cut_out = photos(truth);
    cut_out[2].alpha = Some(vec![7; WIDTH * HEIGHT]);
    let error = Trainer::new(cut_out, &points(), config, &Device::flex()).err().unwrap().to_string();
    assert!(error.contains("`d`") && error.contains("--effects=-alpha"), "{error}");
}

/// A photograph that is transparent where the scene is empty, over black, which could be mistaken for dark Gaussians.
#[test]
fn random_backgrounds_make_alpha_right() {
    let device = Device::flex();
    let splats = scene(&device).splats();
    let mut cut_out = photos([0.0; 3]);
    let mut alphas = Vec::new();
    for photo in &mut cut_out {
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
        let picture = render_view(&splats, &camera, &Extras::default(), &RenderOptions::standard()).unwrap();
        let alpha: Vec<f32> = values_of(picture.alpha);
        let straight = |(value, alpha): (f32, f32)| (255.0 * value / alpha.max(1e-3)).round().min(255.0) as u8;
        let colours = values_of(picture.colour);
        photo.rgb = colours.iter().enumerate().map(|(i, &value)| straight((value, alpha[i / 3]))).collect();
        photo.alpha = Some(alpha.iter().map(|alpha| (255.0 * alpha).round() as u8).collect());
        alphas.push(alpha);
    }
    let error_with = |backdrop| {
        let trainer = train(cut_out.clone(), TrainConfig { backdrop, ..config(240) });
        let found = trainer.gaussians().untracked().splats();
        let mut error = 0.0;
        for (photo, truth) in cut_out.iter().zip(&alphas) {
            let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
            let picture = render_view(&found, &camera, &Extras::default(), &RenderOptions::standard()).unwrap();
            let alpha = values_of(picture.alpha);
            error += alpha.iter().zip(truth).map(|(a, b)| (a - b).abs()).sum::<f32>() / alpha.len() as f32;
        }
        error / cut_out.len() as f32
    };
    let (random, black) = (error_with(Backdrop::Random), error_with(Backdrop::Fixed));
    assert!(random < 0.7 * black, "{random} with random backgrounds, {black} over black");
}

#[test]
fn a_smoothed_run_leaves_smoothed_gaussians() {
    let trainer = train(photos([0.0; 3]), TrainConfig { smoothing: true, ..config(12) });
    let (rows, parameters) = (trainer.rows(), trainer.gaussians().to_rows());
    assert_eq!(trainer.parts_of_rows().collect::<Vec<_>>(), std::slice::from_ref(&rows));
    assert_eq!(rows.means, parameters.means);
    let grown = rows.log_scales.as_flattened().iter().zip(parameters.log_scales.as_flattened());
    assert!(grown.clone().all(|(baked, plain)| baked >= plain) && grown.clone().any(|(baked, plain)| baked > plain));
    let plain = train(photos([0.0; 3]), config(12));
    assert_eq!(plain.rows(), plain.gaussians().to_rows());
}

/// A run with all effects is reproducible and improves.
#[test]
fn all_effects_run_together() {
    let everything = TrainConfig {
        smoothing: true,
        antialias: true,
        backdrop: Backdrop::Environment { degree: 2 },
        exposure: Some(Default::default()),
        grid: Some(GridConfig::default()),
        poses: Some(PoseConfig::default()),
        depth: Some(DepthConfig::default()),
        ..config(40)
    };
    let samples = vec![vec![DepthSample { at: [0.5, 0.5], depth: 3.0 }]; 4];
    let run = || {
        let trainer = Trainer::new(outdoors().0, &points(), everything.clone(), &Device::flex()).unwrap();
        let mut trainer = trainer.with_depths(samples.clone());
        (losses(&mut trainer), trainer.rows())
    };
    let (first, second) = (run(), run());
    assert_eq!(first, second);
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    assert!(mean(&first.0[32..]) < 0.7 * mean(&first.0[..8]), "{:?}", first.0);
}

/// Known depths nearer than the points move the scene nearer.
#[test]
fn known_depths_pull_the_scene() {
    let place = |x: usize, y: usize| [(x as f32 + 0.5) / 8.0, (y as f32 + 0.5) / 6.0];
    let samples: Vec<DepthSample> = (0..48).map(|i| DepthSample { at: place(i % 8, i / 8), depth: 2.5 }).collect();
    let depth_of = |weight: f64| {
        let weight = Falling { from: weight, to: weight };
        let config = TrainConfig { depth: Some(DepthConfig { weight, ..DepthConfig::default() }), ..config(160) };
        let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
        let mut trainer = trainer.with_depths(vec![samples.clone(), vec![], vec![], vec![]]);
        losses(&mut trainer);
        let photo = &photos([0.0; 3])[0];
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &Device::flex());
        let options = RenderOptions::standard().with_depth(true);
        let splats = trainer.gaussians().untracked().splats();
        let picture = render_view(&splats, &camera, &Extras::default(), &options).unwrap();
        let (depth, alpha) = (values_of(picture.depth.unwrap()), values_of(picture.alpha));
        let covered: Vec<f32> = depth.iter().zip(&alpha).filter(|(_, a)| **a > 0.5).map(|(d, a)| d / a).collect();
        covered.iter().map(|depth| (depth - 2.5).abs()).sum::<f32>() / covered.len() as f32
    };
    let (with, without) = (depth_of(3.0), depth_of(1e-9));
    assert!(with < 0.6 * without, "{with} and {without}");
}
