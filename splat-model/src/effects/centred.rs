//! A parameter for each photograph, whose mean over the photographs is kept neutral. The scene and all of these could change
//! together and no photograph would tell; what they all agree on is the scene's.

use burn::tensor::{Gradients, Tensor};

use super::learned::{Learned, Moment};
use crate::state::{State, StateError};

/// Such parameters.
pub struct Centred<const D: usize> {
    all: Vec<Learned<D>>,
    neutral: Tensor<D>,
    /// Steps of all of them since their mean was last set back.
    since_centred: usize,
}

impl<const D: usize> Centred<D> {
    /// `neutral`, not tracked, for so many photographs.
    pub fn new(neutral: Tensor<D>, views: usize) -> Self {
        let all = (0..views).map(|_| Learned::new(neutral.clone())).collect();
        Self { all, neutral, since_centred: 0 }
    }

    /// That of a photograph, tracked.
    pub fn tracked(&mut self, view: usize) -> Tensor<D> {
        self.all[view].tracked()
    }

    /// The same without autodiff.
    #[cfg(test)]
    pub fn value(&self, view: usize) -> Tensor<D> {
        self.all[view].value()
    }

    /// What their mean is, without autodiff.
    pub fn neutral(&self) -> Tensor<D> {
        self.neutral.clone()
    }

    /// Adam's step on that of the photograph. Once every as many steps as there are photographs the mean is set back.
    pub fn step(&mut self, gradients: &mut Gradients, rate: f64, at: Moment) {
        if !self.all[at.view].step(gradients, rate, at.verdict) {
            return;
        }
        self.since_centred += 1;
        if self.since_centred >= self.all.len() {
            self.since_centred = 0;
            self.centre();
        }
    }

    /// Moves all alike, so that their mean is neutral.
    fn centre(&mut self) {
        let Some(sum) = self.all.iter().map(Learned::value).reduce(|a, b| a + b) else { return };
        let excess = sum / self.all.len() as f32 - self.neutral();
        for one in &mut self.all {
            one.set(one.value() - excess.clone());
        }
    }

    /// Keeps all, and how long ago their mean was set back.
    ///
    /// # Errors
    /// None that is to be expected.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        Learned::save_all(&self.all, to)?;
        to.tell("since_centred", &self.since_centred)
    }

    /// Goes on from what was kept for as many photographs.
    ///
    /// # Errors
    /// If something is missing or of another shape.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        Learned::load_all(&mut self.all, from)?;
        self.since_centred = from.told("since_centred")?;
        Ok(())
    }
}
