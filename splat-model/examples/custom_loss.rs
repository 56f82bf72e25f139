//! A custom loss: L1 with a higher weight for dark pixels, and a penalty on opacities between 0 and 1.
//! Run with a capture: `cargo run --release -p splat-model --example custom_loss -- CAPTURE`.
use std::path::Path;

use burn::tensor::Device;
use splat_model::capture::{Capture, load_all};
use splat_model::evaluate::evaluate;
use splat_model::trainer::{LossInputs, TrainConfig, Trainer};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("pass the folder of a capture")?;
    let capture = Capture::load(Path::new(&folder))?;
    let photos = load_all(&capture.views, Some(96), |_| {})?;
    let config = TrainConfig { steps: 60, ..TrainConfig::default() };
    let device = Device::flex();

    let loss = |seen: &LossInputs| {
        let truth = seen.truth.image();
        let weight = truth.clone().neg() + 1.5;
        let colour = ((seen.image.clone() - truth).abs() * weight).mean();
        let opacity = seen.input.splats.opacities.clone();
        colour + (opacity.clone() * (opacity.neg() + 1.0)).mean() * 0.01
    };
    let mut trainer = Trainer::new(photos.clone(), &capture.points, config, &device)?.with_loss(loss);
    while !trainer.is_done() {
        let report = trainer.step()?;
        if report.step % 20 == 0 {
            println!(
                "step {:3}  loss {:.4}  {} Gaussians",
                report.step,
                report.loss.into_scalar::<f32>(),
                report.splats
            );
        }
    }
    let splats = trainer.gaussians().untracked().splats();
    let scores = evaluate(&splats, &photos, &trainer.background(), &trainer.render_options(), |_, _| {})?;
    println!("PSNR on the photographs themselves: {:.2} dB", scores.psnr);
    Ok(())
}
