//! Measured cost of a run's effects: the time of a step with and without each effect, at the end of the run.

use std::time::{Duration, Instant};

use burn::tensor::Tensor;
use serde::Serialize;
use splat_op::Rendered;

use super::differentiate::OneView;
use super::{TrainError, Trainer};
use crate::effects::{Effect, EffectKind};

/// Number of timed pairs of steps: the median of 31 differences, or of fewer, but nine, after [`ENOUGH`].
const PAIRS: std::ops::RangeInclusive<usize> = 9..=31;

/// Time of the pairs after which nine suffice.
const ENOUGH: Duration = Duration::from_secs(10);

/// The photograph of the timed steps.
const VIEW: usize = 0;

/// Measured cost of an effect.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeasuredCost {
    /// Time that the effect adds to a step, ms, as a mean over all steps (see [`Effect::every`]).
    pub ms_per_step: f64,
    /// Time of a step without it, from the render to the gradients, ms.
    pub without_ms: f64,
    /// Memory, MiB.
    pub mib: f64,
}

impl Trainer {
    /// Cost of `effect` in a step on the first photograph, at the current state of the run. Steps with and without it are timed
    /// in turn; the result is the median of the differences. Maps of colours are timed without the render, whose time would hide
    /// theirs. An effect that works in one of `n` steps costs an `n`th of that (see [`Effect::every`]). The update of an effect's own
    /// parameters is not included. No parameter changes. `None` for
    /// effects that are not part of a step, and for effects that are off. Motion blur and rolling shutters are timed
    /// together.
    ///
    /// # Errors
    /// If the render operation rejects the scene.
    pub fn cost_of(&mut self, effect: EffectKind) -> Result<Option<MeasuredCost>, TrainError> {
        let Some(bytes) = self.bytes_of(effect) else { return Ok(None) };
        let step = self.step;
        let every = self.effects.named(effect.in_stack()).map_or(1, Effect::every);
        self.step = step.max(1).next_multiple_of(every);
        let times = self.step_times(effect);
        self.step = step;
        let (difference_ms, without_ms) = times?;
        let mib = bytes as f64 / (1 << 20) as f64;
        Ok(Some(MeasuredCost { ms_per_step: difference_ms / every as f64, without_ms, mib }))
    }

    /// The medians of the difference that `effect` makes to a step, and of a step without it, ms.
    fn step_times(&mut self, effect: EffectKind) -> Result<(f64, f64), TrainError> {
        let time = match effect {
            EffectKind::Exposure | EffectKind::BilateralGrid => Self::time_loss,
            _ => Self::time_step,
        };
        // The first runs compile kernels and prepare photographs.
        time(self)?;
        self.without(effect, time)?;
        let start = Instant::now();
        let (mut differences_ms, mut steps_ms) = (Vec::new(), Vec::new());
        while differences_ms.len() < *PAIRS.start() || (differences_ms.len() < *PAIRS.end() && start.elapsed() < ENOUGH)
        {
            let with_ms = time(self)?;
            differences_ms.push(with_ms - self.without(effect, time)?);
            if steps_ms.len() < *PAIRS.start() {
                steps_ms.push(self.without(effect, Self::time_step)?);
            }
        }
        Ok((median(&mut differences_ms), median(&mut steps_ms)))
    }

    /// Runs a measurement while an effect is off.
    fn without(
        &mut self,
        effect: EffectKind,
        time: impl Fn(&mut Self) -> Result<f64, TrainError>,
    ) -> Result<f64, TrainError> {
        let (options, off) = (self.options, self.effects.take(effect.in_stack()));
        self.options.antialias &= effect != EffectKind::Antialias;
        self.views.ignore_masks(effect == EffectKind::Masks);
        let without_ms = time(self);
        self.options = options;
        off.into_iter().for_each(|off| self.effects.put_back(off));
        self.views.ignore_masks(false);
        without_ms
    }

    /// Memory that an effect keeps between steps, bytes. `None` if it is off or not part of a step.
    fn bytes_of(&self, effect: EffectKind) -> Option<usize> {
        if effect == EffectKind::Masks {
            return self.views.masked_bytes();
        }
        let bytes = self.effects.named(effect.in_stack()).map(Effect::bytes);
        bytes.or((effect == EffectKind::Antialias && self.options.antialias).then_some(0))
    }

    /// Time until the loss and the gradients are computed, ms.
    fn time_step(&mut self) -> Result<f64, TrainError> {
        let start = Instant::now();
        let OneView { loss, gradients, .. } = self.differentiate(VIEW)?;
        // Both are read, because the device computes asynchronously.
        let _ = loss.into_data();
        let _ = gradients.means.map(|means| means.sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }

    /// Time from the picture to the gradients, ms. The picture is the photograph, slightly darkened.
    fn time_loss(&mut self) -> Result<f64, TrainError> {
        let drawn = self.effects.draw(&mut self.rng);
        let prepared = self.prepare(VIEW, drawn)?;
        // In the order of a render, planes: each operation would rearrange another.
        let planes = prepared.truth.image().permute([2, 0, 1]) * 0.9;
        let [_, height, width] = planes.dims();
        let alpha = Tensor::from_inner(Tensor::ones([height, width, 1], &planes.device()));
        let image = Tensor::from_inner(planes.permute([1, 2, 0])).require_grad();
        let start = Instant::now();
        let (loss, _) = self.compare(&prepared, Rendered { colour: image.clone(), alpha, depth: None })?;
        let gradient = image.grad(&loss.backward());
        let _ = loss.into_data();
        let _ = gradient.map(|gradient| gradient.permute([2, 0, 1]).sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }
}

/// The median of values, of which there is one at least; 0 otherwise.
fn median(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}
