use burn::tensor::Device;

use super::super::testing::{photos, points};
use super::super::{TrainConfig, Trainer};
use super::*;
use crate::gaussians::values_of;

/// Mean thickness and loss after some steps.
fn run(loss: SurfaceLoss) -> (f32, Vec<f32>) {
    let config = TrainConfig { steps: 30, ..TrainConfig::default() };
    let trainer = Trainer::new(photos([0.0; 3]), &points(), config, &Device::flex()).unwrap();
    let mut trainer = trainer.with_loss(loss);
    let losses = (0..30).map(|_| trainer.step().unwrap().loss.into_scalar::<f32>()).collect();
    let scales = trainer.gaussians().untracked().log_scales().exp();
    (values_of(thickness(scales))[0], losses)
}

#[test]
fn gaussians_become_flat_and_normals_join_in_time() {
    let with = |consistency, flatness| SurfaceLoss { consistency, flatness, ..SurfaceLoss::new(0.2, 30) };
    let (plain, before) = run(with(0.0, 0.0));
    let (flat, _) = run(with(0.0, 1.0));
    assert!(flat < 0.9 * plain, "{flat} of {plain}");
    let (_, joined) = run(with(1.0, 0.0));
    let from = SurfaceLoss::new(0.2, 30).from;
    assert_eq!(joined[..from - 1], before[..from - 1]);
    assert!(joined[from - 1] > before[from - 1]);
}
