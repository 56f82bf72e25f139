//! What the effects of a run cost: the time of a step with each and without, at the end of the run.

use std::time::Instant;

use burn::tensor::Tensor;

use super::{TrainError, Trainer};
use crate::effects::plan::Cost;
use crate::effects::{Applied, Effect};
use crate::loss::photometric;

/// Pairs of steps that are timed, of each the fastest counts: what else the machine does only ever adds.
const PAIRS: usize = 9;

/// The photograph that is timed.
const VIEW: usize = 0;

impl Trainer {
    /// What `effect` adds to a step on the first photograph as the run is now, ms, and its memory, MiB. Effects between
    /// render and loss are timed without the render, which would drown them. Changes no parameter. None for effects that are
    /// not part of a step, and for such that are off. Motion blur, rolling shutters and defocus are timed together.
    ///
    /// # Errors
    /// If the operation refuses the scene.
    pub fn cost_of(&mut self, effect: Effect) -> Result<Option<Cost>, TrainError> {
        let Some(bytes) = self.bytes_of(effect) else { return Ok(None) };
        let in_the_camera = matches!(effect, Effect::Exposure | Effect::BilateralGrid | Effect::Masks);
        let time = |run: &mut Self| match in_the_camera {
            true => run.time_loss(),
            false => run.time_step(),
        };
        // Kernels are compiled and photographs prepared before the clock counts.
        time(self)?;
        let mut fastest_ms = [f64::INFINITY; 2];
        for _ in 0..PAIRS {
            fastest_ms[0] = time(self)?.min(fastest_ms[0]);
            let (options, mut off) = (self.options, Applied::default());
            self.effects.exchange(effect, &mut off);
            self.options.antialias &= effect != Effect::Antialias;
            self.views.ignore_masks(effect == Effect::Masks);
            let without_ms = time(self);
            self.options = options;
            self.effects.exchange(effect, &mut off);
            self.views.ignore_masks(false);
            fastest_ms[1] = without_ms?.min(fastest_ms[1]);
        }
        let mib = bytes as f64 / (1 << 20) as f64;
        Ok(Some(Cost { ms_per_step: fastest_ms[0] - fastest_ms[1], mib }))
    }

    /// Bytes that an effect keeps from step to step; none where it is off or no part of a step.
    fn bytes_of(&self, effect: Effect) -> Option<usize> {
        let effects = &self.effects;
        match effect {
            Effect::Antialias => {
                let smoothing = effects.smoothing.as_ref().map(|smoothing| smoothing.bytes());
                smoothing.or(self.options.antialias.then_some(0))
            }
            Effect::Alpha => effects.behind.as_ref().filter(|behind| !behind.is_learnt()).map(|behind| behind.bytes()),
            Effect::Exposure => effects.exposure.as_ref().map(|exposure| exposure.bytes()),
            Effect::BilateralGrid => effects.grids.as_ref().map(|grids| grids.bytes()),
            Effect::Masks => self.views.masked_bytes(),
            Effect::PoseRefinement => effects.poses.as_ref().map(|poses| poses.bytes()),
            Effect::Environment => {
                effects.behind.as_ref().filter(|behind| behind.is_learnt()).map(|behind| behind.bytes())
            }
            Effect::MotionBlur | Effect::RollingShutter | Effect::Defocus => {
                effects.optics.as_ref().map(|optics| optics.bytes())
            }
            Effect::DepthSupervision => effects.depths.as_ref().map(|depths| depths.bytes()),
        }
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
    fn time_loss(&mut self) -> Result<f64, TrainError> {
        let (_, truth) = self.views.prepare(VIEW, None)?;
        let image = Tensor::from_inner(truth.image() * 0.9).require_grad();
        let start = Instant::now();
        let excluded = self.views.excluded(VIEW)?;
        let seen = self.effects.developed(image.clone(), VIEW, excluded.as_ref());
        let mut loss = photometric(seen, &truth, self.config.lambda);
        if let Some(penalty) = self.effects.penalty(VIEW) {
            loss = loss + penalty;
        }
        let gradient = image.grad(&loss.backward());
        let _ = loss.into_data();
        let _ = gradient.map(|gradient| gradient.sum().into_data());
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }
}
