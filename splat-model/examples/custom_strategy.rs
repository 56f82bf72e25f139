//! A custom density strategy: at regular intervals it clones the Gaussians with the largest accumulated gradients of their
//! centres, up to a budget, and prunes nearly transparent ones.
//! Run with a capture: `cargo run --release -p splat-model --example custom_strategy -- CAPTURE`.
use std::path::Path;

use burn::tensor::{DType, Device, Tensor};
use rand::Rng;
use splat_model::capture::{Capture, load_all};
use splat_model::density::rows::{RowEdit, Trained};
use splat_model::density::{Observed, RefineReport, Signals, Strategy, StrategyContext, counts, largest, picked};
use splat_model::evaluate::evaluate;
use splat_model::gaussians::RowsError;
use splat_model::state::{State, StateError};
use splat_model::trainer::{TrainConfig, Trainer};

struct Budget {
    every: usize,
    most: usize,
    /// `[N]`: accumulated length of the gradient of each centre since the last change of rows.
    pulled: Option<Tensor<1>>,
}

impl Strategy for Budget {
    fn listens_at(&self, _step: usize) -> Signals {
        Signals { gradient: true, ..Signals::default() }
    }

    fn observe(&mut self, seen: Observed) {
        let Some(gradient) = seen.gradient else { return };
        let length = gradient.square().sum_dim(1).sqrt().squeeze_dim::<1>(1);
        self.pulled = Some(match self.pulled.take() {
            Some(pulled) => pulled + length,
            None => length,
        });
    }

    fn acts_at(&self, step: usize) -> bool {
        step.is_multiple_of(self.every)
    }

    fn act(
        &mut self,
        scene: &mut Trained,
        at: &StrategyContext,
        _rng: &mut dyn Rng,
    ) -> Result<Option<RefineReport>, RowsError> {
        if !self.acts_at(at.step) || at.step == at.steps {
            return Ok(None);
        }
        let Some(pulled) = self.pulled.take() else { return Ok(None) };
        // All of this is on the device; only the number of rows to keep is read.
        let rows = scene.gaussians.len();
        let device = pulled.device();
        // The logit of 0.01.
        let stays = scene.gaussians.logit_opacities().inner().greater_elem(-4.6);
        let [kept] = counts([stays.clone()]);
        let cloned = self.most.saturating_sub(kept).min(kept / 5);
        let (clones, _) = largest(&pulled, &stays, cloned);
        let order = Tensor::arange(0..rows as i64, (&device, DType::I32));
        let keep = picked(&order, &stays, kept);
        scene.edit(&RowEdit::new(keep, picked(&order, &clones, cloned)))?;
        Ok(Some(RefineReport { cloned, pruned: rows - kept, ..RefineReport::default() }))
    }

    // Saved so that an interrupted run continues without a difference.
    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.pulled.iter().for_each(|pulled| to.put("pulled", pulled.clone()));
        Ok(())
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.pulled = if from.has("pulled") { Some(from.take("pulled", device)?) } else { None };
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("pass the folder of a capture")?;
    let capture = Capture::load(Path::new(&folder))?;
    let photos = load_all(&capture.views, Some(96), |_| {})?;
    let config = TrainConfig { steps: 100, ..TrainConfig::default() };
    let budget = Budget { every: 20, most: 20_000, pulled: None };
    let mut trainer = Trainer::new(photos.clone(), &capture.points, config, &Device::flex())?.with_strategy(budget)?;
    while !trainer.is_done() {
        let report = trainer.step()?;
        if let Some(refined) = report.refined {
            println!("step {:3}  {} Gaussians, {} of them new", report.step, report.splats, refined.cloned);
        }
    }
    let splats = trainer.gaussians().untracked().splats();
    let scores = evaluate(&splats, &photos, &trainer.background(), &trainer.render_options(), |_, _| {})?;
    println!("PSNR on the photographs themselves: {:.2} dB", scores.psnr);
    Ok(())
}
