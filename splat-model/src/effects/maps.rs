//! Colour maps of photographs, learned along with the scene, whose mean over the photographs is kept neutral. A change of the scene could
//! cancel a common change of all maps without a change in any render, so the common part belongs to the scene.

use burn::tensor::{Device, Gradients, Tensor};
use splat_op::Rendered;

use super::{Effect, EffectContext, EffectKind, Falling, Leaf, Learned, RenderInput};
use crate::state::{State, StateError};

/// What sets the maps of one effect apart from those of another.
pub(super) struct MapKind<const D: usize> {
    pub effect: EffectKind,
    /// Learning rate.
    pub rate: Falling,
    /// The map that changes nothing, not tracked.
    pub neutral: Tensor<D>,
    /// Applies a map to a picture, `[H, W, 3]`.
    pub apply: fn(&Tensor<3>, &Tensor<D>) -> Tensor<3>,
    /// The penalty, `[1]`, of a map beside the neutral one.
    pub penalty: fn(Tensor<D>, Tensor<D>) -> Tensor<1>,
    /// Weight of the penalty in the loss.
    pub weight: f64,
}

/// The colour maps of all photographs of a run.
pub struct ColourMaps<const D: usize> {
    kind: MapKind<D>,
    all: Vec<Learned<D>>,
    /// Steps on all maps since their mean was last reset.
    since_centred: usize,
}

impl<const D: usize> ColourMaps<D> {
    /// Neutral maps for `views` photographs.
    pub(super) fn of_kind(kind: MapKind<D>, views: usize) -> Self {
        let all = (0..views).map(|_| Learned::new(kind.neutral.clone())).collect();
        Self { kind, all, since_centred: 0 }
    }

    /// The penalty for a step on `view`, `[1]`.
    fn pull(&mut self, view: usize) -> Tensor<1> {
        let neutral = Tensor::from_inner(self.kind.neutral.clone());
        (self.kind.penalty)(self.all[view].tracked(), neutral) * self.kind.weight
    }

    /// Shifts all maps by the same amount such that their mean is neutral.
    fn centre(&mut self) {
        let Some(sum) = self.all.iter().map(Learned::value).reduce(|a, b| a + b) else { return };
        let excess = sum / self.all.len() as f32 - self.kind.neutral.clone();
        for one in &mut self.all {
            one.set(one.value() - excess.clone());
        }
    }
}

impl<const D: usize> Effect for ColourMaps<D> {
    fn name(&self) -> &'static str {
        self.kind.effect.name()
    }

    /// The result is not clamped: beyond 0 and 1 the gradient leads back.
    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        (self.kind.apply)(&image, &self.all[at.view].tracked())
    }

    fn penalty(&mut self, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        Some(self.pull(at.view))
    }

    fn leaves(&mut self, at: EffectContext) -> Vec<Leaf> {
        vec![self.all[at.view].leaf()]
    }

    /// Once in as many steps as there are photographs, the mean is reset.
    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        let rate = self.kind.rate.at(at.step, at.steps);
        if !self.all[at.view].step(gradients, rate, at.verdict) {
            return;
        }
        self.since_centred += 1;
        if self.since_centred >= self.all.len() {
            self.since_centred = 0;
            self.centre();
        }
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        Learned::save_all(&self.all, to)?;
        to.tell("since_centred", &self.since_centred)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        Learned::load_all(&mut self.all, from)?;
        self.since_centred = from.told("since_centred")?;
        Ok(())
    }
}

#[cfg(test)]
mod tests;
