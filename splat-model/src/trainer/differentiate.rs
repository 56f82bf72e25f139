//! The losses of a step's views and their gradients, which are averaged.
//!
//! Learning rates and Adam's constants change with the number of views (see [`crate::optim::Adam::for_batch`]). The number
//! of steps and all schedules in steps are the user's choice. Parameters of effects, most of which belong to one
//! photograph, take a separate step for each view.

use std::iter;

use burn::tensor::{Bool, Gradients as Remaining, Int, Tensor};
use splat_op::{Extras, Rendered};

use super::checked::first_wrong;
use super::{LossInputs, TrainError, Trainer};
use crate::density::rows::Gradients;
use crate::density::{Observed, Signals};
use crate::effects::{Effect, EffectContext, RenderInput, masks, mean_of};
use crate::loss::{Truth, regularise};

/// The inputs of a view's render, and the photograph to compare it with.
pub(super) struct PreparedStep {
    at: EffectContext<'static>,
    pub input: RenderInput,
    pub truth: Truth,
    /// `[1, H, W]`: the pixels that a mask excludes.
    excluded: Option<Tensor<3, Bool>>,
    signals: Signals,
}

/// The results of the backward pass of a view.
pub(super) struct OneView {
    pub view: usize,
    /// `[1]`
    pub loss: Tensor<1>,
    /// The gradients of the scene.
    pub gradients: Gradients,
    /// The gradients of effects' parameters.
    pub left: Remaining,
    /// The requested signals, if there are any.
    pub seen: Option<Observed>,
    /// See [`super::Guard::look`].
    pub held: Option<Tensor<1, Int>>,
}

/// The results of the backward passes of a batch.
pub(super) struct Batch {
    /// `[1]`: the mean loss.
    pub loss: Tensor<1>,
    /// The mean gradients of the scene.
    pub gradients: Gradients,
    /// Views, each with the gradients of its effects' parameters.
    pub views: Vec<(usize, Remaining)>,
    /// See [`super::Guard::look`].
    pub held: Option<Tensor<1, Int>>,
}

impl Batch {
    /// The mean of `views` views, from the sum.
    fn averaged(self, views: usize) -> Self {
        if views == 1 {
            return self;
        }
        let share = 1.0 / views as f64;
        Self { loss: self.loss * share, gradients: self.gradients.times(share), ..self }
    }
}

impl Trainer {
    /// Differentiates the views of a step, one by one.
    pub(super) fn differentiate_batch(&mut self) -> Result<Batch, TrainError> {
        let count = self.config.batch;
        if self.ranks.count() > 1 {
            return Ok(self.differentiate_shared()?.averaged(count));
        }
        let (mut losses, mut gradients) = (Vec::new(), Gradients::default());
        let (mut views, mut held) = (Vec::new(), None);
        for _ in 0..count {
            let view = self.draw_view();
            self.views.expect(iter::once(view).chain(self.queue.iter().rev().copied()));
            let drawn = self.effects.draw(&mut self.rng);
            let one = self.differentiate(view, drawn)?;
            if let Some(seen) = one.seen {
                self.density.observe(seen);
            }
            losses.push(one.loss);
            gradients = gradients.plus(one.gradients);
            views.push((view, one.left));
            held = one.held;
        }
        let loss = losses.into_iter().reduce(|a, b| a + b).expect("a batch has a view");
        Ok(Batch { loss, gradients, views, held }.averaged(count))
    }

    /// Renders a view over a `drawn` background if there is one, compares it with its photograph, and computes the gradients, which the
    /// guard checks. Density control is not told.
    pub(super) fn differentiate(&mut self, view: usize, drawn: Option<[f32; 3]>) -> Result<OneView, TrainError> {
        let prepared = self.prepare(view, drawn)?;
        // If effects make several renders, their mean counts.
        let inputs = self.effects.samples(prepared.input.clone(), prepared.at).into_iter();
        let picture = inputs.map(|input| input.render()).collect::<Result<_, _>>().map(mean_of)?;
        let loss = self.compare(&prepared, picture);
        let one = self.go_back(prepared, loss);
        let held = self.guard.look(self.step, view, &one.loss, &one.gradients);
        Ok(OneView { held: held.map_err(|fault| self.non_finite(fault))?, ..one })
    }

    /// Prepares a view: Gaussians, camera and background after the effects, and the photograph.
    pub(super) fn prepare(&mut self, view: usize, drawn: Option<[f32; 3]>) -> Result<PreparedStep, TrainError> {
        let at = EffectContext { view, step: self.step, steps: self.config.steps, verdict: None };
        let splats = self.scene.splats();
        let signals = self.density.listens_at(self.step);
        let (rows, last) = (splats.means.dims()[0], self.probe.take());
        let values = last.filter(|values| values.dims()[0] == rows);
        // Not as a matrix: CUDA pads the rows of one, and kernels would copy it in every step.
        let values = values.unwrap_or_else(|| Tensor::<1>::empty([2 * rows], &self.device).reshape([rows, 2]));
        let probe = |wanted: bool| wanted.then(|| Tensor::from_inner(values.clone()).require_grad());
        let extras = Extras::default()
            .with_background(
                drawn.map_or_else(|| self.background.clone(), |rgb| Tensor::from_floats(rgb, &self.device)),
            )
            .with_mean2d_probe(probe(signals.gradient))
            .with_mean2d_abs_probe(probe(signals.abs_gradient));
        self.probe = Some(values);
        let (camera, truth) = self.views.prepare(view, drawn)?;
        let excluded = self.views.excluded(view)?;
        let mut input = RenderInput { splats, camera, extras, options: self.options, edits: Vec::new() };
        self.effects.before(&mut input, &self.scene.gaussians, at);
        Ok(PreparedStep { at, input, truth, excluded, signals })
    }

    /// Renders a view once more, stage by stage. Says which output is not finite first, if one is.
    pub(super) fn first_wrong(&mut self, view: usize) -> Option<String> {
        let prepared = self.prepare(view, None).ok()?;
        self.effects.samples(prepared.input, prepared.at).iter().find_map(first_wrong)
    }

    /// Computes the loss of a picture with all penalties, `[1]`, tracked.
    fn compare(&mut self, prepared: &PreparedStep, picture: Rendered<3>) -> Tensor<1> {
        let PreparedStep { at, input, truth, excluded, .. } = prepared;
        let cleared = |picture: Tensor<3>| match excluded {
            Some(excluded) => masks::cleared(picture, excluded),
            None => picture,
        };
        // Excluded pixels are cleared last, so that they do not train the effects either.
        let image = cleared(self.effects.image(picture.colour.clone(), input, &picture, *at));
        let (alpha, depth) = (cleared(picture.alpha.clone()), picture.depth.clone().map(cleared));
        let (gaussians, excluded) = (&self.scene.gaussians, excluded.as_ref());
        let (step, view) = (at.step, self.views.name(at.view));
        let seen = LossInputs { image, alpha, depth, excluded, truth, input, gaussians, step, view };
        let mut loss = self.loss.loss(&seen);
        if let Some(penalty) = self.effects.penalty(input, &picture, *at) {
            loss = loss + penalty;
        }
        let opacity_weight = self.config.opacity_weight_at(at.step);
        if opacity_weight > 0.0 {
            loss = loss + regularise::opacity(input.splats.opacities.clone()) * opacity_weight;
        }
        if let Some(penalty) = self.density.penalty(&input.splats, at.step) {
            loss = loss + penalty;
        }
        loss
    }

    /// Computes the gradients of the scene, of the probes and of the effects.
    fn go_back(&self, prepared: PreparedStep, loss: Tensor<1>) -> OneView {
        let PreparedStep { at, input: RenderInput { splats, camera, extras, .. }, signals, .. } = prepared;
        drop(splats);
        let mut left = loss.backward();
        let mut seen = None;
        if signals != Signals::default() {
            let mut taken = |probe: Option<Tensor<2>>| probe.and_then(|probe| probe.grad_remove(&mut left));
            let (gradient, abs_gradient) = (taken(extras.mean2d_probe), taken(extras.mean2d_abs_probe));
            let size = (camera.intrinsics.width, camera.intrinsics.height);
            seen = Some(Observed { gradient, abs_gradient, size });
        }
        let gradients = Gradients::take(&self.scene.gaussians, &mut left);
        OneView { view: at.view, loss: loss.inner(), gradients, left, seen, held: None }
    }
}
