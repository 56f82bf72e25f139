//! A custom effect: the filter in front of every other photograph, trained together with the scene. The example darkens them.
//! Run with a capture: `cargo run --release -p splat-model --example custom_effect -- CAPTURE`.
use burn::tensor::{Device, Gradients, Tensor};
use splat_model::capture::{Capture, load_all};
use splat_model::effects::{Effect, EffectContext, Leaf, Learned, RenderInput};
use splat_model::state::{State, StateError};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::Rendered;

/// Removes a share of the light of photographs 1, 3, 5 and so on, counted from 0.
struct Filter(Learned<1>);

impl Effect for Filter {
    fn name(&self) -> &'static str {
        "filter"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        if at.view.is_multiple_of(2) {
            return image;
        }
        image * (self.0.tracked().neg() + 1.0).reshape([1, 1, 1])
    }

    fn leaves(&mut self, _: EffectContext) -> Vec<Leaf> {
        vec![self.0.leaf()]
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        self.0.step(gradients, 0.01, at.verdict);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.0.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.0.load(from)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let capture = Capture::load(std::env::args().nth(1).ok_or("pass the folder of a capture")?.as_ref())?;
    let mut photos = load_all(&capture.views, Some(96), |_| {})?;
    for photo in photos.iter_mut().skip(1).step_by(2) {
        photo.rgb.iter_mut().for_each(|value| *value = (f32::from(*value) * 0.6) as u8);
    }
    let (device, config) = (Device::flex(), TrainConfig { steps: 150, ..TrainConfig::default() });
    let filter = Filter(Learned::new(Tensor::zeros([1], &device)));
    let mut trainer = Trainer::new(photos, &capture.points, config, &device)?.with_effect(filter);
    while !trainer.is_done() {
        let report = trainer.step()?;
        if report.step % 30 == 0 {
            let Filter(share) = trainer.effect().ok_or("the trainer has the effect")?;
            println!("step {:3}  light removed: {:.3} of 0.4", report.step, share.value().into_scalar::<f32>());
        }
    }
    Ok(())
}
