//! Parameters of photographs whose mean over the photographs is kept neutral. A change of the scene could cancel a common
//! change of all parameters without a change in any render, so the common part belongs to the scene.

use burn::tensor::{Gradients, Tensor};

use super::leaf::Leaf;
use super::learned::{EffectContext, Learned};
use crate::state::{State, StateError};

/// One parameter for each photograph, with a neutral mean.
pub struct Centred<const D: usize> {
    all: Vec<Learned<D>>,
    neutral: Tensor<D>,
    /// Steps on all parameters since their mean was last reset.
    since_centred: usize,
}

impl<const D: usize> Centred<D> {
    /// Starts `views` parameters at `neutral`, which is not tracked.
    pub fn new(neutral: Tensor<D>, views: usize) -> Self {
        let all = (0..views).map(|_| Learned::new(neutral.clone())).collect();
        Self { all, neutral, since_centred: 0 }
    }

    /// The tracked parameter of a photograph.
    pub fn tracked(&mut self, view: usize) -> Tensor<D> {
        self.all[view].tracked()
    }

    /// The parameter of a photograph for [`Effect::leaves`](super::Effect::leaves).
    pub fn leaf(&mut self, view: usize) -> Leaf {
        self.all[view].leaf()
    }

    /// The parameter of a photograph without autodiff.
    #[cfg(test)]
    pub fn value(&self, view: usize) -> Tensor<D> {
        self.all[view].value()
    }

    /// The neutral value, without autodiff.
    pub fn neutral(&self) -> Tensor<D> {
        self.neutral.clone()
    }

    /// Takes an Adam step on the photograph's parameter. Once in as many steps as there are photographs, the mean is reset.
    pub fn step(&mut self, gradients: &mut Gradients, rate: f64, at: EffectContext) {
        if !self.all[at.view].step(gradients, rate, at.verdict) {
            return;
        }
        self.since_centred += 1;
        if self.since_centred >= self.all.len() {
            self.since_centred = 0;
            self.centre();
        }
    }

    /// Shifts all parameters by the same amount such that their mean is neutral.
    fn centre(&mut self) {
        let Some(sum) = self.all.iter().map(Learned::value).reduce(|a, b| a + b) else { return };
        let excess = sum / self.all.len() as f32 - self.neutral();
        for one in &mut self.all {
            one.set(one.value() - excess.clone());
        }
    }

    /// Saves all parameters and the number of steps since the last reset.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        Learned::save_all(&self.all, to)?;
        to.tell("since_centred", &self.since_centred)
    }

    /// Restores the state of the same number of photographs.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        Learned::load_all(&mut self.all, from)?;
        self.since_centred = from.told("since_centred")?;
        Ok(())
    }
}
