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

/// Asserts that the depth of excluded pixels changes no bit of the loss.
struct Excluding(SurfaceLoss);

impl Loss for Excluding {
    fn outputs(&self, options: RenderOptions, step: usize) -> RenderOptions {
        self.0.outputs(options, step)
    }

    fn loss(&mut self, seen: &LossInputs) -> Tensor<1> {
        let excluded = Tensor::from_inner(seen.excluded.unwrap().clone().float().permute([1, 2, 0]));
        let [loss, near, far] = [0.0, -0.5, 3.0].map(|more| {
            let depth = seen.depth.clone().map(|depth| depth + excluded.clone() * more);
            let (image, alpha, normals) = (seen.image.clone(), seen.alpha.clone(), seen.normals.clone());
            self.0.loss(&LossInputs {
                image,
                alpha,
                normals,
                depth,
                excluded: seen.excluded,
                truth: seen.truth,
                input: seen.input,
                gaussians: seen.gaussians,
                step: seen.step,
                view: seen.view,
            })
        });
        let value = loss.clone().into_scalar::<f32>();
        assert_eq!([near, far].map(Tensor::into_scalar::<f32>), [value; 2]);
        loss
    }
}

#[test]
fn the_depth_of_excluded_pixels_counts_nowhere() {
    let mut photos = photos([0.0; 3]);
    let (width, height) = (photos[0].intrinsics.width, photos[0].intrinsics.height);
    // A hole in the middle of what the cameras look at, and another at the border.
    let is_hole = |i: usize| (12..18).contains(&(i % width)) && (8..15).contains(&(i / width)) || i == width - 1;
    photos.iter_mut().for_each(|photo| photo.mask = Some((0..width * height).map(|i| !is_hole(i)).collect()));
    let config = TrainConfig { steps: 4, ..TrainConfig::default() };
    let trainer = Trainer::new(photos, &points(), config, &Device::flex()).unwrap();
    let loss = SurfaceLoss { consistency: 1.0, from: 0, ..SurfaceLoss::new(0.2, 4) };
    let mut trainer = trainer.with_loss(Excluding(loss));
    (0..4).for_each(|_| assert!(trainer.step().unwrap().loss.into_scalar::<f32>() > 0.0));
}
