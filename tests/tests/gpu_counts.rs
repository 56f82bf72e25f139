//! What a training step launches and allocates on a GPU: counts, which do not depend on how busy the machine is. A process
//! of its own: what is counted must be this test's alone.

use std::collections::BTreeMap;

use burn::tensor::Device;
use glam::{DAffine3, DVec3};
use splat_model::capture::{Photo, PointCloud};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Intrinsics, witness};
use splat_tests::places;

/// Kernels per step on a driver in software. On a card it is some less.
const LAUNCHES: f64 = 69.0;

/// Bytes per step of the buffers that the operations ask for.
const BYTES: f64 = 1_479_172.0;

/// What a regression is.
const GROWTH: f64 = 1.05;

/// Steps before those that count: all degrees of the harmonics are there by then, and the photograph is prepared.
const BEFORE: usize = 6;
const STEPS: usize = 8;

/// A run on one photograph of 96 × 64 px, of a thousand Gaussians on a slope.
fn trainer(device: &Device) -> Trainer {
    let (width, height) = (96, 64);
    let rgb = (0..width * height).flat_map(|i| [(i % width * 2) as u8, (i / width * 3) as u8, 90]).collect();
    let cam_from_world = DAffine3::from_translation(DVec3::new(0.0, 0.0, 3.0));
    let intrinsics = Intrinsics::centred(width, height, 90.0);
    let photo = Photo { name: "slope".into(), intrinsics, cam_from_world, rgb, alpha: None, mask: None };
    let position = |i: usize| [(i % 40) as f32 / 20.0 - 1.0, (i / 40) as f32 / 20.0 - 0.6, (i % 7) as f32 / 7.0];
    let positions: Vec<[f32; 3]> = (0..1000).map(position).collect();
    let points = PointCloud { colours: vec![[128; 3]; positions.len()], positions };
    let config = TrainConfig { steps: 1_000, sh_every: 1, ..TrainConfig::default() };
    Trainer::new(vec![photo], &points, config, device).expect("a photograph and steps are given")
}

#[test]
fn a_training_step_launches_and_allocates_no_more_than_it_did() {
    let Some(place) = places().into_iter().find(|place| place.device != Device::flex() && place.name == "gpu") else {
        return;
    };
    if !place.software {
        return;
    }
    let mut run = trainer(&place.device);
    let mut step = || run.step().expect("a sound run").loss.into_scalar::<f32>();
    let first = step();
    for _ in 1..BEFORE {
        step();
    }
    let mut last = 0.0;
    let bytes_before = witness::allocated_bytes();
    let counts = witness::launches(|| (0..STEPS).for_each(|_| last = step()));
    let bytes = (witness::allocated_bytes() - bytes_before) as f64 / STEPS as f64;
    assert!(last < first, "the loss went from {first} to {last}: this is not training");
    let per_step: BTreeMap<&str, f64> =
        counts.iter().map(|(name, count)| (*name, *count as f64 / STEPS as f64)).collect();
    let launches: f64 = per_step.values().sum();
    println!("{launches} launches and {bytes} bytes a step: {per_step:#?}");
    for (what, found, committed) in [("launches", launches, LAUNCHES), ("bytes", bytes, BYTES)] {
        assert!(found <= GROWTH * committed, "{found} {what} a step instead of {committed}: {per_step:#?}");
        assert!(found >= committed / GROWTH, "{found} {what} a step instead of {committed}: commit the new figure");
    }
}
