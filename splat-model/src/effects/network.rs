//! A Burn module that is learned along with the scene, as [`Learned`] is a tensor.

use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Gradients, Int, Tensor};

use super::{Leaf, Learned};
use crate::state::{State, StateError};

/// A Burn module of an effect or a loss, with Adam's moments of each of its float parameters. Parameters of other kinds stay as they are.
pub struct Network<M> {
    module: M,
    /// The parameters in the order in which Burn maps them, in one dimension each.
    all: Vec<Learned<1>>,
}

impl<M: Module> Network<M> {
    /// A module without optimiser history, on any device.
    pub fn new(module: M) -> Self {
        let mut all = Vec::new();
        let module = module.map(&mut Each(|flat: Tensor<1>| {
            let flat = if flat.is_autodiff() { flat.inner() } else { flat };
            all.push(Learned::new(flat.clone()));
            flat
        }));
        Self { module, all }
    }

    /// The module with tracked parameters, for renders and losses.
    pub fn tracked(&mut self) -> M {
        let mut all = self.all.iter_mut();
        self.module.clone().map(&mut Each(|flat| all.next().map_or(flat, Learned::tracked)))
    }

    /// The module without autodiff.
    pub fn value(&self) -> M {
        let mut all = self.all.iter();
        self.module.clone().map(&mut Each(|flat| all.next().map_or(flat, Learned::value)))
    }

    /// The parameters for [`Loss::leaves`](crate::trainer::Loss::leaves) and [`Effect::leaves`](super::Effect::leaves).
    pub fn leaves(&mut self) -> Vec<Leaf> {
        self.all.iter_mut().map(Learned::leaf).collect()
    }

    /// Takes one Adam step on every parameter that the loss depends on, by the gradients of the last [`Self::tracked`], as
    /// [`Learned::step`].
    pub fn step(&mut self, gradients: &mut Gradients, rate: f64, verdict: Option<&Tensor<1, Int>>) {
        for one in &mut self.all {
            one.step(gradients, rate, verdict);
        }
    }

    /// Saves parameters, moments and step counts.
    ///
    /// # Errors
    /// None expected.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        Learned::save_all(&self.all, to)
    }

    /// Restores the state of a module of the same shapes.
    ///
    /// # Errors
    /// If a value is missing or has another shape.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        Learned::load_all(&mut self.all, from)
    }
}

/// Replaces each float parameter by what a function makes of it in one dimension.
struct Each<F>(F);

impl<F: FnMut(Tensor<1>) -> Tensor<1>> ModuleMapper for Each<F> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, value) = (param.id, param.val());
        let (shape, count) = (value.dims(), value.shape().num_elements());
        // Not `Param::from_tensor`, which would track a tensor that is no leaf.
        Param::initialized(id, (self.0)(value.reshape([count])).reshape(shape))
    }
}

#[cfg(test)]
mod tests;
