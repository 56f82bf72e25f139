//! What the effects of a run cost: the time of a step with each and without, at the end of the run.

use std::time::Instant;

use burn::tensor::Tensor;

use super::{TrainError, Trainer};
use crate::effects::Effect;
use crate::effects::plan::Cost;
use crate::loss::photometric;

/// Pairs of steps that are timed, of each the fastest counts: what else the machine does only ever adds.
const PAIRS: usize = 9;

/// The photograph that is timed.
const VIEW: usize = 0;

impl Trainer {
    /// What `effect` adds to a step on the first photograph as the run is now, ms, and its memory, MiB. Effects between
    /// render and loss are timed without the render, which would drown them. Changes no parameter. None for effects that are
    /// not part of a step, and for such that are off.
    ///
    /// # Errors
    /// If the operation refuses the scene.
    pub fn cost_of(&mut self, effect: Effect) -> Result<Option<Cost>, TrainError> {
        let bytes = match effect {
            Effect::Exposure => self.effects.exposure.as_ref().map(|exposure| exposure.bytes()),
            Effect::Masks => self.views.masked_bytes(),
            Effect::Antialias => self.options.antialias.then_some(0),
            // Photographs are put over the background once.
            Effect::Alpha => None,
        };
        let Some(bytes) = bytes else { return Ok(None) };
        let time = |run: &mut Self| match effect {
            Effect::Antialias => run.time_step(),
            _ => Ok(run.time_loss()),
        };
        // Kernels are compiled and photographs prepared before the clock counts.
        time(self)?;
        let mut fastest_ms = [f64::INFINITY; 2];
        for _ in 0..PAIRS {
            fastest_ms[0] = time(self)?.min(fastest_ms[0]);
            let options = self.options;
            let exposure = self.effects.exposure.take_if(|_| effect == Effect::Exposure);
            self.options.antialias &= effect != Effect::Antialias;
            self.views.ignore_masks(effect == Effect::Masks);
            let without_ms = time(self);
            self.options = options;
            self.effects.exposure = exposure.or(self.effects.exposure.take());
            self.views.ignore_masks(false);
            fastest_ms[1] = without_ms?.min(fastest_ms[1]);
        }
        let mib = bytes as f64 / (1 << 20) as f64;
        Ok(Some(Cost { ms_per_step: fastest_ms[0] - fastest_ms[1], mib }))
    }

    /// Time until the loss and the gradients are there, ms.
    fn time_step(&mut self) -> Result<f64, TrainError> {
        let start = Instant::now();
        let (loss, gradients, _) = self.differentiate(VIEW)?;
        // Both are read, because a device may not have begun.
        let _ = loss.into_data();
        let _ = gradients.means.map(|means| means.sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }

    /// The same from a picture on, which is the photograph a little darker.
    fn time_loss(&mut self) -> f64 {
        let (_, truth) = self.views.prepare(VIEW);
        let image = Tensor::from_inner(truth.image() * 0.9).require_grad();
        let start = Instant::now();
        let excluded = self.views.excluded(VIEW);
        let seen = self.effects.apply(image.clone(), VIEW, excluded.as_ref());
        let mut loss = photometric(seen, &truth, self.config.lambda);
        if let Some(penalty) = self.effects.penalty(VIEW) {
            loss = loss + penalty;
        }
        let gradient = image.grad(&loss.backward());
        let _ = loss.into_data();
        let _ = gradient.map(|gradient| gradient.sum().into_data());
        start.elapsed().as_secs_f64() * 1e3
    }
}
