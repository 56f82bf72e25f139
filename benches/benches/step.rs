//! One whole training step: render, loss, backward, Adam. The run is first compared with what it is known to reach.
//!
//! `cargo bench -p splat-benches --bench step`

use burn::tensor::{DType, Device};
use divan::{Bencher, black_box};
use glam::DAffine3;
use splat_benches::{SMALL, SyntheticView, values};
use splat_model::capture::{Photo, PointCloud};
use splat_model::trainer::{TrainConfig, Trainer};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    divan::main();
}

/// A run on one picture of the synthetic scene, from its centres in grey, with every degree of the harmonics in use.
fn trainer(view: SyntheticView) -> Trainer {
    let device = Device::flex();
    let rgb = values(view.picture(&device, DType::F32)).iter().map(|v| (v * 255.0).round() as u8).collect();
    let intrinsics = view.camera(&device, DType::F32).intrinsics;
    let photo = Photo { name: "synthetic".into(), intrinsics, cam_from_world: DAffine3::IDENTITY, rgb, alpha: None };
    let means = values(view.scene(&device, DType::F32).means);
    let positions: Vec<[f32; 3]> = means.as_chunks::<3>().0.iter().map(|mean| mean.map(|v| v as f32)).collect();
    let points = PointCloud { colours: vec![[128; 3]; positions.len()], positions };
    let config = TrainConfig { steps: 100_000, sh_every: 0, ..TrainConfig::default() };
    Trainer::new(vec![photo], &points, config, &device).expect("a photograph and steps are given")
}

#[divan::bench(args = [SMALL], sample_count = 40)]
fn training_step(bencher: Bencher, view: SyntheticView) {
    let mut run = trainer(view);
    let mut loss = || run.step().expect("shapes fit").loss.into_scalar::<f32>();
    let first = loss();
    let last = (0..200).map(|_| loss()).last().unwrap_or(f32::NAN);
    assert!(last < 0.8 * first, "the loss went from {first} to {last}: this is not training");
    bencher.bench_local(|| black_box(run.step()));
}
