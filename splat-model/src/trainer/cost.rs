//! Measured cost of a run's effects: the time of a step with and without each effect, at the end of the run.

use std::time::Instant;

use burn::tensor::Tensor;
use splat_op::Rendered;

use super::differentiate::Batch;
use super::{TrainError, Trainer};
use crate::effects::plan::Cost;
use crate::effects::{Effect, EffectKind};

/// Number of timed pairs of steps. The fastest of each counts, because other load on the machine only adds time.
const PAIRS: usize = 9;

/// The photograph of the timed steps.
const VIEW: usize = 0;

impl Trainer {
    /// Cost of `effect` in a step on the first photograph, at the current state of the run: time, ms, and memory, MiB.
    /// Effects between render and loss are timed without the render, whose time would hide theirs. No parameter changes.
    /// `None` for effects that are not part of a step, and for effects that are off. Motion blur, rolling shutters and
    /// defocus are timed together.
    ///
    /// # Errors
    /// If the render operation rejects the scene.
    pub fn cost_of(&mut self, effect: EffectKind) -> Result<Option<Cost>, TrainError> {
        let Some(bytes) = self.bytes_of(effect) else { return Ok(None) };
        let in_the_camera = matches!(effect, EffectKind::Exposure | EffectKind::BilateralGrid | EffectKind::Masks);
        let time = |run: &mut Self| match in_the_camera {
            true => run.time_loss(),
            false => run.time_step(),
        };
        // The first run compiles kernels and prepares photographs.
        time(self)?;
        let mut fastest_ms = [f64::INFINITY; 2];
        for _ in 0..PAIRS {
            fastest_ms[0] = time(self)?.min(fastest_ms[0]);
            let (options, off) = (self.options, self.effects.take(effect.in_stack()));
            self.options.antialias &= effect != EffectKind::Antialias;
            self.views.ignore_masks(effect == EffectKind::Masks);
            let without_ms = time(self);
            self.options = options;
            off.into_iter().for_each(|off| self.effects.put_back(off));
            self.views.ignore_masks(false);
            fastest_ms[1] = without_ms?.min(fastest_ms[1]);
        }
        let mib = bytes as f64 / (1 << 20) as f64;
        Ok(Some(Cost { ms_per_step: fastest_ms[0] - fastest_ms[1], mib }))
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
        let Batch { loss, gradients, .. } = self.differentiate(VIEW)?;
        // Both are read, because the device computes asynchronously.
        let _ = loss.into_data();
        let _ = gradients.means.map(|means| means.sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }

    /// Time from the picture to the gradients, ms. The picture is the photograph, slightly darkened.
    fn time_loss(&mut self) -> Result<f64, TrainError> {
        let prepared = self.prepare(VIEW)?;
        let truth = prepared.truth.image();
        let [height, width, _] = truth.dims();
        let alpha = Tensor::from_inner(Tensor::ones([height, width, 1], &truth.device()));
        let image = Tensor::from_inner(truth * 0.9).require_grad();
        let start = Instant::now();
        let (loss, _) = self.compare(&prepared, Rendered { colour: image.clone(), alpha, depth: None })?;
        let gradient = image.grad(&loss.backward());
        let _ = loss.into_data();
        let _ = gradient.map(|gradient| gradient.sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }
}
