//! Tests of the trainer on a GPU: its GPU-only code, and tensor code that no other test runs on a GPU.

use std::cell::RefCell;
use std::rc::Rc;

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use splat_model::accuracy::Setting;
use splat_model::capture::{Photo, PointCloud};
use splat_model::density::{AdaptiveConfig, McmcConfig};
use splat_model::effects::background::Backdrop;
use splat_model::effects::depth::{DepthConfig, DepthSample};
use splat_model::effects::exposure::ExposureConfig;
use splat_model::effects::grid::GridConfig;
use splat_model::effects::optics::OpticsConfig;
use splat_model::effects::pose::PoseConfig;
use splat_model::trainer::{LossInputs, TrainConfig, Trainer};
use splat_op::Intrinsics;
use splat_tests::gpu;
use splat_tests::scene::host;

/// Photographs that do not fit the cache of prepared photographs are uploaded packed and unpacked on the device.
#[test]
fn a_loss_sees_packed_photographs_as_they_are() {
    let Some(device) = gpu() else { return };
    let (width, height) = (53, 38);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |name: &str, alpha: Option<Vec<u8>>| Photo {
        name: name.into(),
        intrinsics: Intrinsics::centred(width, height, 50.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0)),
        rgb: (0..width * height).flat_map(|i| [byte(i), byte(3 * i + 200), byte(255 - i % 256)]).collect(),
        alpha,
        mask: None,
    };
    let translucent = (0..width * height).map(|i| byte(7 * i + 100)).collect();
    let photos = vec![photo("opaque", None), photo("translucent", Some(translucent))];
    let background = [0.1, 0.5, 0.9];
    let expected: Vec<(String, Vec<f64>)> =
        photos.iter().map(|photo| (photo.name.clone(), host(photo.rgb_over(background, &Device::flex())))).collect();
    let points = PointCloud { positions: vec![[0.0; 3], [0.5, 0.2, 0.1]], colours: vec![[128; 3]; 2] };
    let config = TrainConfig { steps: 2, cache_mib: 0, background, ..TrainConfig::default() };
    let seen_by_loss = Rc::new(RefCell::new(Vec::new()));
    let record = seen_by_loss.clone();
    let loss = move |seen: &LossInputs| {
        record.borrow_mut().push((seen.view.to_owned(), host(seen.truth.image())));
        (seen.image.clone() - seen.truth.image()).square().mean()
    };
    let mut run = Trainer::new(photos, &points, config, &device).expect("photographs and steps").with_loss(loss);
    (0..2).for_each(|_| drop(run.step().expect("a sound run")));
    let mut seen = seen_by_loss.take();
    seen.sort_by(|a, b| a.0.cmp(&b.0));
    for ((name, seen), (view, expected)) in seen.iter().zip(&expected) {
        assert_eq!(name, view);
        for (seen, expected) in seen.iter().zip(expected) {
            assert!((seen - expected).abs() <= 1e-6, "{name}: {seen} instead of {expected}");
        }
    }
    assert_eq!(seen.len(), expected.len());
}

/// Three photographs of noise, from cameras `step` apart. The photograph `masked` has a mask.
fn photos(step: f64, masked: Option<usize>) -> Vec<Photo> {
    let (width, height) = (48, 36);
    let byte = |i: usize| (i % 256) as u8;
    let photo = |view: usize| Photo {
        name: format!("{view}"),
        intrinsics: Intrinsics::centred(width, height, 50.0),
        cam_from_world: DAffine3::from_translation(DVec3::new(step * view as f64, 0.0, 3.0)),
        rgb: (0..width * height).flat_map(|i| [byte(2 * i), byte(90 * view + i / 9), byte(i / 7)]).collect(),
        alpha: None,
        mask: (masked == Some(view)).then(|| (0..width * height).map(|i| i % width < 30).collect()),
    };
    (0..3).map(photo).collect()
}

/// Points in front of the cameras.
fn points() -> PointCloud {
    let position = |i: usize| [(i % 8) as f32 / 4.0 - 0.9, (i / 8) as f32 / 4.0 - 0.7, (i % 3) as f32 / 4.0];
    PointCloud { positions: (0..48).map(position).collect(), colours: vec![[90, 140, 60]; 48] }
}

/// Trains each of the other effects alone: tensor code that no other test runs on a GPU.
#[test]
fn each_effect_trains_as_on_the_cpu() {
    let Some(device) = gpu() else { return };
    let plain = TrainConfig { steps: 9, ..TrainConfig::default() };
    let optics = |optics: OpticsConfig| TrainConfig { optics, ..plain.clone() };
    let nothing = OpticsConfig::default();
    let effects = [
        ("smoothing", TrainConfig { smoothing: true, antialias: true, ..plain.clone() }),
        ("random background", TrainConfig { backdrop: Backdrop::Random, ..plain.clone() }),
        ("learned background", TrainConfig { backdrop: Backdrop::Learned, background: [0.5; 3], ..plain.clone() }),
        ("environment", TrainConfig { backdrop: Backdrop::Environment { degree: 2 }, ..plain.clone() }),
        ("grid", TrainConfig { grid: Some(GridConfig::default()), ..plain.clone() }),
        ("poses", TrainConfig { poses: Some(PoseConfig::default()), ..plain.clone() }),
        ("depth", TrainConfig { depth: Some(DepthConfig::default()), ..plain.clone() }),
        ("motion blur", optics(OpticsConfig { motion: true, ..nothing })),
        ("rolling shutter", optics(OpticsConfig { rolling: true, ..nothing })),
    ];
    let samples =
        || vec![vec![DepthSample { at: [0.5, 0.5], depth: 2.0 }, DepthSample { at: [0.3, 0.4], depth: 2.5 }]; 3];
    let losses = |name: &str, config: &TrainConfig, device: &Device| -> Vec<f64> {
        let run = Trainer::new(photos(0.1, None), &points(), config.clone(), device).expect("photographs and steps");
        let mut run = run.with_depths(samples());
        let mut step = || run.step().unwrap_or_else(|error| panic!("{name} on {device:?}: {error}"));
        (0..config.steps).map(|_| host(step().loss)[0]).collect()
    };
    let without = losses("nothing", &plain, &Device::flex());
    for (name, config) in effects {
        let (expected, found) = (losses(name, &config, &Device::flex()), losses(name, &config, &device));
        for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!((found - expected).abs() <= 2e-3 * expected, "{name}, step {step}: {found} instead of {expected}");
        }
        // The effect changes a step: one that returns to photographs already trained on, if it starts as the identity.
        let changed = without.iter().zip(&expected).any(|(without, with)| (without - with).abs() > 1e-6 * with);
        assert!(changed, "{name}: {expected:?} and {without:?}");
    }
}

/// Trains with exposures and masks, tensor code that no other test runs on a GPU.
#[test]
fn effects_train_as_on_the_cpu() {
    let Some(device) = gpu() else { return };
    let (photos, points) = (|| photos(0.1, Some(1)), points());
    let config = TrainConfig { steps: 12, exposure: Some(ExposureConfig::default()), ..TrainConfig::default() };
    let losses = |config: &TrainConfig, device: &Device| -> Vec<f64> {
        let mut run = Trainer::new(photos(), &points, config.clone(), device).expect("photographs and steps");
        (0..config.steps).map(|_| host(run.step().expect("a sound run").loss)[0]).collect()
    };
    let (expected, found) = (losses(&config, &Device::flex()), losses(&config, &device));
    for (step, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert!((found - expected).abs() <= 1e-3 * expected, "step {step}: {found} instead of {expected}");
    }
    // The exposure maps change the last step, which returns to photographs already trained on.
    let without = losses(&TrainConfig { exposure: None, ..config }, &Device::flex());
    assert!((without[11] - expected[11]).abs() > 5e-3 * expected[11], "{} and {}", without[11], expected[11]);
}

/// With ordered sums over intersections, the same seed gives the same bits, for each strategy and for batches.
#[test]
fn a_seed_decides_every_strategy_bit_for_bit() {
    let Some(device) = gpu() else { return };
    let dials = Setting::new([("accumulation", "ordered")]).expect("a dial and a value of it");
    let adaptive =
        AdaptiveConfig { every: 4, from: 4, grad_threshold: 1e-5, max_splats: 80, ..AdaptiveConfig::default() };
    let mcmc =
        McmcConfig { every: 4, from: 4, growth: 1.2, dead_opacity: 0.3, max_splats: 80, ..McmcConfig::default() };
    let strategies =
        [(adaptive.into(), 1), (AdaptiveConfig { absolute: true, ..adaptive }.into(), 2), (mcmc.into(), 1)];
    for (density, batch) in strategies {
        let config =
            TrainConfig { steps: 10, batch, sh_every: 3, density, dials: dials.clone(), ..TrainConfig::default() };
        let run = |seed| {
            let config = TrainConfig { seed, ..config.clone() };
            let mut run = Trainer::new(photos(0.2, None), &points(), config, &device).expect("photographs and steps");
            (0..10).for_each(|_| drop(run.step().expect("a sound run")));
            run.gaussians().untracked().to_rows()
        };
        let rows = run(1);
        assert!(rows.len() > 48, "{density:?}: {} of 48 Gaussians, nothing was added", rows.len());
        assert_eq!(rows, run(1), "{density:?}");
        assert_ne!(rows, run(2), "{density:?}");
    }
}

/// Coefficients that a step makes unusable mask their Gaussians from the next step on, as on a CPU, which looks at all of them in every
/// step.
#[test]
fn coefficients_that_a_step_spoils_are_masked_in_the_next() {
    let Some(device) = gpu() else { return };
    let losses = |device: &Device| {
        let mut config = TrainConfig { steps: 4, sh_every: 1, ..TrainConfig::default() };
        config.learning_rates.sh_dc = 1e25;
        let photo = Photo {
            name: "plain".into(),
            intrinsics: Intrinsics::centred(40, 36, 40.0),
            cam_from_world: DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0)),
            rgb: [200, 60, 20].repeat(40 * 36),
            alpha: None,
            mask: None,
        };
        let positions: Vec<[f32; 3]> =
            (0..64).map(|i| [(i % 8) as f32 / 4.0 - 1.0, (i / 8) as f32 / 4.0 - 1.0, 0.0]).collect();
        let points = PointCloud { colours: vec![[128; 3]; positions.len()], positions };
        let mut run = Trainer::new(vec![photo], &points, config, device).expect("a photograph and steps");
        (0..4).map(|_| run.step().expect("a sound run").loss.into_scalar::<f32>()).collect::<Vec<_>>()
    };
    let (found, expected) = (losses(&device), losses(&Device::flex()));
    assert!(expected[2] == expected[3], "no coefficient was spoilt, as the pictures differ: {expected:?}");
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() <= 1e-4 * expected, "{found} instead of {expected}");
    }
}
