//! A plain training run, for tests that count or record its operations.

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use splat_model::capture::{Photo, PointCloud};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::Intrinsics;

/// Creates a run on one photograph of 96 × 64 px with a thousand Gaussians on a slope. The SH degree reaches its maximum by step 4.
pub fn slope_trainer(device: &Device) -> Trainer {
    slope_trainer_with(TrainConfig::default(), device)
}

/// As [`slope_trainer`], with other options.
pub fn slope_trainer_with(config: TrainConfig, device: &Device) -> Trainer {
    let (width, height) = (96, 64);
    let rgb = (0..width * height).flat_map(|i| [(i % width * 2) as u8, (i / width * 3) as u8, 90]).collect();
    let cam_from_world = DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0));
    let intrinsics = Intrinsics::centred(width, height, 90.0);
    let photo = Photo { name: "slope".into(), intrinsics, cam_from_world, rgb, alpha: None, mask: None };
    let position = |i: usize| [(i % 40) as f32 / 20.0 - 1.0, (i / 40) as f32 / 20.0 - 0.6, (i % 7) as f32 / 7.0];
    let positions: Vec<[f32; 3]> = (0..1000).map(position).collect();
    let points = PointCloud { colours: vec![[128; 3]; positions.len()], positions };
    let config = TrainConfig { steps: 1_000, sh_every: 1, ..config };
    Trainer::new(vec![photo], &points, config, device).expect("a photograph and steps are given")
}
