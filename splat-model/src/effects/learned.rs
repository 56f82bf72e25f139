//! A parameter that is learned along with the scene. It has its own Adam state and step count: a parameter of one photograph gets a
//! gradient only when that photograph is trained on, and Adam moves a parameter even if its gradient is zero.

use burn::tensor::{Gradients, Int, Tensor};
use serde::{Deserialize, Serialize};

use super::leaf::Leaf;
use crate::optim::{Adam, MomentBits, Moments};
use crate::state::{State, StateError};

/// A learning rate that falls by a constant factor per step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Falling {
    /// Rate at the first step.
    pub from: f64,
    /// Rate at the last step.
    pub to: f64,
}

impl Falling {
    /// The rate at `step`, counted from 1, in a run of `steps` steps.
    pub fn at(&self, step: usize, steps: usize) -> f64 {
        let share = (step - 1) as f64 / steps.saturating_sub(1).max(1) as f64;
        self.from * (self.to / self.from).powf(share.min(1.0))
    }
}

/// Position in a run: the step and its photograph.
#[derive(Clone, Copy, Debug)]
pub struct EffectContext<'a> {
    /// Index of the photograph.
    pub view: usize,
    /// Number of the step, counted from 1.
    pub step: usize,
    /// Number of steps in the whole run.
    pub steps: usize,
    /// `[2]`: the device's verdict, in [`Effect::step`](super::Effect::step) on a GPU. Nothing may change if a step is
    /// recorded in it (see [`splat_op::adam`]).
    pub verdict: Option<&'a Tensor<1, Int>>,
}

/// Largest step as a share of the parameter's reach. In a run that visits each photograph a few times, apertures would
/// otherwise grow a hundredfold in one step, beyond what f32 arithmetic on a GPU tolerates.
const LARGEST_STEP: f64 = 0.125;

/// A parameter that is learned along with the scene, with its own Adam moments and step count.
pub struct Learned<const D: usize> {
    /// In multiples of `unit`, if there is a unit.
    value: Tensor<D>,
    /// The tracked value that renders since the last step use. Views of one batch share it.
    leaf: Tensor<D>,
    /// Whether `value` has changed since `leaf` was made.
    moved: bool,
    unit: Option<Tensor<D>>,
    moments: Moments<D>,
    steps: usize,
}

impl<const D: usize> Learned<D> {
    /// A parameter without optimiser history. `start` is not tracked.
    pub fn new(start: Tensor<D>) -> Self {
        let leaf = Tensor::from_inner(start.clone());
        Self { moments: Moments::new(&leaf), value: start, leaf, moved: true, unit: None, steps: 0 }
    }

    /// A parameter that can move by about `reach` in a run that uses [`Self::step_within`]. The size of Adam's steps does not depend on the
    /// size of gradients, so the parameter itself is scaled: it is learned in units of `reach`, whose components must not be zero.
    pub fn reaching(start: Tensor<D>, reach: Tensor<D>) -> Self {
        Self { unit: Some(reach.clone()), ..Self::new(start / reach) }
    }

    /// The tracked value, for renders and losses.
    pub fn tracked(&mut self) -> Tensor<D> {
        if self.moved {
            self.leaf = Tensor::from_inner(self.value.clone()).require_grad();
            self.moved = false;
        }
        match &self.unit {
            None => self.leaf.clone(),
            Some(unit) => self.leaf.clone() * Tensor::from_inner(unit.clone()),
        }
    }

    /// The parameter for [`Effect::leaves`](super::Effect::leaves).
    pub fn leaf(&mut self) -> Leaf {
        self.tracked();
        Leaf::new(self.leaf.clone())
    }

    /// The value without autodiff.
    pub fn value(&self) -> Tensor<D> {
        let value = self.value.clone();
        self.unit.clone().map_or_else(|| value.clone(), |unit| value.clone() * unit)
    }

    /// Replaces the value and keeps the optimiser history. `value` is not tracked.
    pub fn set(&mut self, value: Tensor<D>) {
        self.value = self.unit.clone().map_or_else(|| value.clone(), |unit| value.clone() / unit);
        self.moved = true;
    }

    /// Removes the gradient of the last [`Self::tracked`] from `gradients`. `None` if the loss does not depend on it.
    pub(super) fn gradient(&self, gradients: &mut Gradients) -> Option<Tensor<D>> {
        self.leaf.grad_remove(gradients)
    }

    /// Takes one Adam step by the gradient of the last [`Self::tracked`], which is removed from `gradients`. Returns false
    /// and does nothing if the loss does not depend on the parameter. Components whose gradient is NaN do not move.
    pub fn step(&mut self, gradients: &mut Gradients, rate: f64, verdict: Option<&Tensor<1, Int>>) -> bool {
        let Some(gradient) = self.gradient(gradients) else { return false };
        self.steps += 1;
        let unknown = gradient.clone().is_nan();
        let gradient = gradient.mask_fill(unknown, 0.0);
        let (value, moments) = (self.value.clone(), &mut self.moments);
        self.value = Adam::default().step_unless(value, gradient, rate, moments, self.steps, verdict);
        self.moved = true;
        true
    }

    /// Takes one Adam step on one of `views` parameters, each of which belongs to a photograph. The rate is chosen such that the parameter
    /// can cover its reach in a whole run, and falls to the share `fall`. Adam moves a parameter by about its rate per step, so short runs
    /// and large captures, in which a photograph is visited rarely, need other rates than long runs.
    pub fn step_within(&mut self, gradients: &mut Gradients, fall: f64, views: usize, at: EffectContext) {
        let visits = at.steps as f64 / views.max(1) as f64;
        // Rates that fall from `r` to `fall r` over the run are `r (1 − fall) / −ln fall` on average.
        let first = (-fall.ln() / ((1.0 - fall) * visits.max(1.0))).min(LARGEST_STEP);
        let rate = Falling { from: first, to: first * fall }.at(at.step, at.steps);
        self.step(gradients, rate, at.verdict);
    }

    /// Saves value, moments and step count.
    ///
    /// # Errors
    /// None expected.
    pub fn save(&self, to: &mut State) -> Result<(), StateError> {
        to.put("value", self.value.clone());
        self.moments.save(to);
        to.tell("steps", &self.steps)
    }

    /// Restores the state of a parameter of the same shape.
    ///
    /// # Errors
    /// If a value is missing or has another shape.
    pub fn load(&mut self, from: &mut State) -> Result<(), StateError> {
        let (shape, device) = (self.value.dims(), self.value.device());
        self.value = from.take_shaped("value", shape, &device)?;
        self.moved = true;
        self.moments = Moments::load(from, shape, MomentBits::ThirtyTwo, &device)?;
        self.steps = from.told("steps")?;
        Ok(())
    }

    /// Saves the parameters of all photographs.
    ///
    /// # Errors
    /// As [`Self::save`].
    pub fn save_all(all: &[Self], to: &mut State) -> Result<(), StateError> {
        let mut each = all.iter().enumerate();
        each.try_for_each(|(view, one)| to.in_part(&view.to_string(), |part| one.save(part)))
    }

    /// Restores the parameters of all photographs.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_all(all: &mut [Self], from: &mut State) -> Result<(), StateError> {
        let mut each = all.iter_mut().enumerate();
        each.try_for_each(|(view, one)| from.load_part(&view.to_string(), |part| one.load(part)))
    }
}

#[cfg(test)]
mod tests;
