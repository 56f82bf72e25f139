//! A custom effect: a vignette, trained together with the scene on photographs that the example darkens towards their corners.
//! Run with a capture: `cargo run --release -p splat-model --example custom_effect -- CAPTURE`.
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use splat_model::capture::{Capture, load_all};
use splat_model::effects::{Effect, EffectContext, Learned, RenderInput};
use splat_model::state::{State, StateError};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::Rendered;

/// Multiplies a pixel at distance `r` from the centre by `1 − strength · r²`; the corners are at distance 1.
struct Vignette(Learned<1>);

fn squared_radii(width: usize, height: usize) -> Vec<f32> {
    let from_middle = |at: usize, size: usize| at as f32 + 0.5 - size as f32 / 2.0;
    let squared = |i: usize| from_middle(i % width, width).powi(2) + from_middle(i / width, height).powi(2);
    (0..width * height).map(|i| 4.0 * squared(i) / (width * width + height * height) as f32).collect()
}

impl Effect for Vignette {
    fn name(&self) -> &'static str {
        "vignette"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, _: EffectContext) -> Tensor<3> {
        let [height, width, _] = image.dims();
        let radii = TensorData::new(squared_radii(width, height), [height, width, 1]);
        let lost = Tensor::from_data(radii, &image.device()) * self.0.tracked().reshape([1, 1, 1]);
        image * (lost.neg() + 1.0)
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
    for photo in &mut photos {
        let radii = squared_radii(photo.intrinsics.width, photo.intrinsics.height);
        photo.rgb.iter_mut().enumerate().for_each(|(i, v)| *v = (f32::from(*v) * (1.0 - 0.4 * radii[i / 3])) as u8);
    }
    let (device, config) = (Device::flex(), TrainConfig { steps: 150, ..TrainConfig::default() });
    let vignette = Vignette(Learned::new(Tensor::zeros([1], &device)));
    let mut trainer = Trainer::new(photos, &capture.points, config, &device)?.with_effect(vignette);
    while !trainer.is_done() {
        let report = trainer.step()?;
        let Some(Vignette(strength)) = trainer.effect().filter(|_| report.step % 30 == 0) else { continue };
        println!("step {:3}  strength {:.3} of 0.4", report.step, strength.value().into_scalar::<f32>());
    }
    Ok(())
}
