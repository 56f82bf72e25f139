//! The program `splat` with a loss, a density strategy and an effect of one's own:
//! `cargo run --release -p splat-train --example own_program -- train CAPTURE --loss squares --strategy still --effects=+dim`.
use std::process::ExitCode;

use burn::tensor::Tensor;
use rand::Rng;
use splat_model::density::rows::Trained;
use splat_model::density::{RefineReport, Strategy, StrategyContext};
use splat_model::effects::{Effect, EffectContext, RenderInput};
use splat_model::gaussians::RowsError;
use splat_model::trainer::{LossInputs, Trainer};
use splat_op::Rendered;
use splat_train::registry::{Registry, main_with};

splat_train::allocator!();

/// Keeps the Gaussians that a run starts with.
struct Still;

impl Strategy for Still {
    fn acts_at(&self, _: usize) -> bool {
        false
    }

    fn act(
        &mut self,
        _: &mut Trained,
        _: &StrategyContext,
        _: &mut dyn Rng,
    ) -> Result<Option<RefineReport>, RowsError> {
        Ok(None)
    }
}

/// Shows every photograph through a grey filter.
struct Dim;

impl Effect for Dim {
    fn name(&self) -> &'static str {
        "dim"
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, _: EffectContext) -> Tensor<3> {
        image * 0.8
    }
}

pub fn registry() -> Registry {
    let squares = || |seen: &LossInputs| (seen.image.clone() - seen.truth.image()).square().mean();
    let registry = Registry::new().loss("squares", squares).strategy("still", |_, _| Still);
    registry.effect("dim", |_: &Trainer| Dim)
}

fn main() -> ExitCode {
    main_with(registry())
}
