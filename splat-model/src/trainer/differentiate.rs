//! The losses of a step's views and their gradients, which are averaged.
//!
//! Learning rates and Adam's constants change with the number of views (see [`crate::optim::Adam::for_batch`]). The number
//! of steps and all schedules in steps are the user's choice. Parameters of effects, most of which belong to one
//! photograph, and of the loss take a separate step for each view.

use burn::tensor::{Bool, Gradients as Remaining, Int, Tensor};
use splat_op::{Extras, Rendered};

use super::checked::first_wrong;
use super::{LossInputs, Result, Trainer};
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

/// The results of a backward pass: of a view, or of all views of a batch that the loss joins.
pub(super) struct Passed {
    pub views: Vec<usize>,
    /// `[1]`: the sum over the views.
    pub loss: Tensor<1>,
    /// The gradients of the scene.
    pub gradients: Gradients,
    /// The gradients of the parameters of effects and of the loss.
    pub left: Remaining,
    /// The requested signals of each view, if there are any.
    pub seen: Vec<Observed>,
    /// See [`super::Guard::look`].
    pub held: Option<Tensor<1, Int>>,
}

/// The results of the backward passes of a batch.
pub(super) struct Batch {
    /// `[1]`: the mean loss.
    pub loss: Tensor<1>,
    /// The mean gradients of the scene.
    pub gradients: Gradients,
    /// The views of each backward pass, with the gradients of the parameters of effects and of the loss.
    pub passes: Vec<(Vec<usize>, Remaining)>,
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
    /// Differentiates the views of a step: one by one, unless the loss joins them.
    pub(super) fn differentiate_batch(&mut self) -> Result<Batch> {
        let count = self.config.batch;
        if self.ranks.count() > 1 {
            return Ok(self.differentiate_shared()?.averaged(count));
        }
        let (mut losses, mut gradients) = (Vec::new(), Gradients::default());
        let (mut passes, mut held) = (Vec::new(), None);
        let at_once = if self.loss.joins_views() { count } else { 1 };
        for _ in 0..count / at_once {
            let views: Vec<_> = (0..at_once).map(|_| (self.draw_view(), self.effects.draw(&mut self.rng))).collect();
            self.views.expect(views.iter().map(|(view, _)| *view).chain(self.queue.iter().rev().copied()));
            let passed = self.differentiate(&views)?;
            passed.seen.into_iter().for_each(|seen| self.density.observe(seen));
            losses.push(passed.loss);
            gradients = gradients.plus(passed.gradients);
            passes.push((passed.views, passed.left));
            held = passed.held;
        }
        let loss = losses.into_iter().reduce(|a, b| a + b).expect("a batch has a view");
        Ok(Batch { loss, gradients, passes, held }.averaged(count))
    }

    /// Renders views, each over a drawn background if there is one, compares them with their photographs, and computes the gradients, which
    /// the guard checks. Density control is not told.
    pub(super) fn differentiate(&mut self, views: &[(usize, Option<[f32; 3]>)]) -> Result<Passed> {
        let (mut prepared, mut pictures) = (Vec::new(), Vec::new());
        for &(view, drawn) in views {
            let one = self.prepare(view, drawn)?;
            // If effects make several renders, their mean counts.
            let inputs = self.effects.samples(one.input.clone(), one.at).into_iter();
            pictures.push(inputs.map(|input| input.render()).collect::<Result<_, _>>().map(mean_of)?);
            prepared.push(one);
        }
        let loss = self.compare(&prepared, pictures);
        let passed = self.go_back(prepared, loss);
        let held = self.guard.look(self.step, views[0].0, &passed.loss, &passed.gradients);
        Ok(Passed { held: held.map_err(|fault| self.non_finite(fault))?, ..passed })
    }

    /// Prepares a view: Gaussians, camera and background after the effects, and the photograph.
    pub(super) fn prepare(&mut self, view: usize, drawn: Option<[f32; 3]>) -> Result<PreparedStep> {
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
        input.options = self.loss.outputs(input.options, self.step);
        Ok(PreparedStep { at, input, truth, excluded, signals })
    }

    /// Renders a view once more, stage by stage. Says which output is not finite first, if one is.
    pub(super) fn first_wrong(&mut self, view: usize) -> Option<String> {
        let prepared = self.prepare(view, None).ok()?;
        self.effects.samples(prepared.input, prepared.at).iter().find_map(first_wrong)
    }

    /// Computes the sum of the views' losses with all penalties, `[1]`, tracked.
    fn compare(&mut self, prepared: &[PreparedStep], pictures: Vec<Rendered<3>>) -> Tensor<1> {
        let cleared = |of: &PreparedStep, picture: Tensor<3>| masks::cleared(picture, of.excluded.as_ref());
        // Excluded pixels are cleared last, so that they do not train the effects either.
        let image = |(of, picture): (&PreparedStep, &Rendered<3>)| {
            cleared(of, self.effects.image(picture.colour.clone(), &of.input, picture, of.at))
        };
        let images: Vec<_> = prepared.iter().zip(&pictures).map(image).collect();
        let (gaussians, views) = (&self.scene.gaussians, &self.views);
        let mut seen = Vec::new();
        for ((of, picture), image) in prepared.iter().zip(&pictures).zip(images) {
            let plane = |plane: &Option<Tensor<3>>| plane.clone().map(|plane| cleared(of, plane));
            let (alpha, excluded) = (cleared(of, picture.alpha.clone()), of.excluded.as_ref());
            let (depth, normals) = (plane(&picture.depth), plane(&picture.normals));
            let PreparedStep { at, input, truth, .. } = of;
            let (step, view) = (at.step, views.name(at.view));
            seen.push(LossInputs { image, alpha, depth, normals, excluded, truth, input, gaussians, step, view });
        }
        let mut loss = match self.loss.joins_views() {
            true => self.loss.of_batch(&seen) * seen.len() as f64,
            false => self.loss.loss(&seen[0]),
        };
        drop(seen);
        for (PreparedStep { at, input, .. }, picture) in prepared.iter().zip(&pictures) {
            if let Some(penalty) = self.effects.penalty(input, picture, *at) {
                loss = loss + penalty;
            }
            let opacity_weight = self.config.opacity_weight_at(at.step);
            if opacity_weight > 0.0 {
                loss = loss + regularise::opacity(input.splats.opacities.clone()) * opacity_weight;
            }
            if let Some(penalty) = self.density.penalty(&input.splats, at.step) {
                loss = loss + penalty;
            }
        }
        loss
    }

    /// Computes the gradients of the scene, of the probes, and of the parameters of effects and of the loss.
    fn go_back(&self, prepared: Vec<PreparedStep>, loss: Tensor<1>) -> Passed {
        let left_of = |of: PreparedStep| {
            let size = (of.input.camera.intrinsics.width, of.input.camera.intrinsics.height);
            (of.at.view, of.signals, of.input.extras, size)
        };
        let kept: Vec<_> = prepared.into_iter().map(left_of).collect();
        let mut left = loss.backward();
        let (mut views, mut seen) = (Vec::new(), Vec::new());
        for (view, signals, extras, size) in kept {
            views.push(view);
            if signals != Signals::default() {
                let mut taken = |probe: Option<Tensor<2>>| probe.and_then(|probe| probe.grad_remove(&mut left));
                let (gradient, abs_gradient) = (taken(extras.mean2d_probe), taken(extras.mean2d_abs_probe));
                seen.push(Observed { gradient, abs_gradient, size });
            }
        }
        let gradients = Gradients::take(&self.scene.gaussians, &mut left);
        Passed { views, loss: loss.inner(), gradients, left, seen, held: None }
    }
}
