//! Batches: the losses and gradients of a step's views are averaged.
//!
//! Learning rates and Adam's constants change with the number of views (see [`crate::optim::Adam::for_batch`]). The number
//! of steps and all schedules in steps are the user's choice. Parameters of effects, most of which belong to one
//! photograph, take a separate step for each view.

use burn::tensor::{Gradients as Remaining, Int, Tensor};

use super::differentiate::Differentiated;
use super::{TrainError, Trainer};
use crate::density::rows::Gradients;

/// The results of a batch.
pub(super) struct Batch {
    /// `[1]`: the mean loss.
    pub loss: Tensor<1>,
    /// The mean gradients.
    pub gradients: Gradients,
    /// Views, each with the gradients of its effects' parameters.
    pub views: Vec<(usize, Remaining)>,
    /// See [`super::Guard::look`].
    pub held: Option<Tensor<1, Int>>,
}

impl Trainer {
    /// Differentiates the views of a step. The guard checks them one by one.
    pub(super) fn differentiate_batch(&mut self) -> Result<Batch, TrainError> {
        let mut batch = self.differentiate_next()?;
        for _ in 1..self.config.batch {
            let next = self.differentiate_next()?;
            batch.loss = batch.loss + next.loss;
            batch.gradients = batch.gradients.plus(next.gradients);
            batch.views.extend(next.views);
            batch.held = next.held;
        }
        if self.config.batch > 1 {
            let share = 1.0 / self.config.batch as f64;
            batch.loss = batch.loss * share;
            batch.gradients = batch.gradients.times(share);
        }
        Ok(batch)
    }

    fn differentiate_next(&mut self) -> Result<Batch, TrainError> {
        let view = self.next_view();
        let Differentiated { loss, gradients, of_effects } = self.differentiate(view)?;
        let held = self.guard.look(self.step, view, &loss, &gradients).map_err(|fault| self.non_finite(fault))?;
        Ok(Batch { loss, gradients, views: vec![(view, of_effects)], held })
    }
}
