//! The same training run on the CPU and on the GPU: two to four minutes on a driver in software.

use std::path::PathBuf;

use burn::tensor::Device;
use splat_model::capture::{Capture, Photo, Split, load_all};
use splat_model::density::AdaptiveConfig;
use splat_model::evaluate::evaluate;
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::witness;
use splat_tests::gpu;
use splat_tests::reference::announce;

/// Rounding moves Gaussians across the threshold of densification one by one.
const COUNT_TOLERANCE: f64 = 0.01;
const PSNR_TOLERANCE_DB: f64 = 0.2;
/// Less growth would leave density control unproven.
const GROWTH: f64 = 1.2;

fn fox_small() -> Option<PathBuf> {
    let standard = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data");
    let folder = std::env::var_os("SPLAT_DATA_DIR").map_or_else(|| PathBuf::from(standard), PathBuf::from);
    let folder = folder.join("fox_small");
    if !folder.exists() {
        announce(&format!("SKIPPED: no {}; set SPLAT_DATA_DIR to the real captures", folder.display()));
        return None;
    }
    Some(folder)
}

/// Gaussians before, Gaussians after, and the PSNR of the test views.
fn train(capture: &Capture, device: &Device) -> (usize, usize, f64) {
    let split = Split::every(&capture.views, 8);
    let photos = |views: &[usize]| -> Vec<Photo> {
        load_all(views.iter().map(|view| &capture.views[*view]), None, |_| ()).expect("readable photographs")
    };
    let density = AdaptiveConfig { from: 50, every: 50, until_share: 1.0, ..AdaptiveConfig::default() };
    let config = TrainConfig { steps: 200, density, ..TrainConfig::default() };
    let (background, options) = (config.background, config.render_options());
    let mut trainer = Trainer::new(photos(&split.train), &capture.points, config, device).expect("a valid run");
    let before = trainer.gaussians().len();
    while !trainer.is_done() {
        trainer.step().expect("a valid scene");
    }
    let gaussians = trainer.gaussians().untracked();
    let scores = evaluate(&gaussians.splats(), &photos(&split.test), background, &options, |_, _| ());
    (before, gaussians.len(), scores.expect("a valid scene").psnr)
}

#[test]
fn training_on_the_gpu_is_training_on_the_cpu() {
    let (Some(device), Some(folder)) = (gpu(), fox_small()) else { return };
    // The proofs of the kernels poison; here it would only take time.
    witness::poison(false);
    let capture = Capture::load(&folder).expect("a readable capture");
    let (before, cpu_count, cpu_psnr) = train(&capture, &Device::flex());
    announce(&format!("on the CPU: {before} to {cpu_count} Gaussians, {cpu_psnr:.3} dB"));
    let (_, gpu_count, gpu_psnr) = train(&capture, &device);
    announce(&format!("on the GPU: {before} to {gpu_count} Gaussians, {gpu_psnr:.3} dB"));
    let growth = cpu_count as f64 / before as f64;
    assert!(growth >= GROWTH, "the count grew only {growth:.3} times");
    let difference = (gpu_count as f64 / cpu_count as f64 - 1.0).abs();
    assert!(difference <= COUNT_TOLERANCE, "{cpu_count} Gaussians on the CPU, {gpu_count} on the GPU");
    let difference = (gpu_psnr - cpu_psnr).abs();
    assert!(difference <= PSNR_TOLERANCE_DB, "{cpu_psnr:.3} dB on the CPU, {gpu_psnr:.3} dB on the GPU");
}
