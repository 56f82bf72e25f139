//! Times of all settings, measured in turns.

use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use burn::tensor::Tensor;
use splat_model::accuracy::Spread;
use splat_op::RenderOptions;

use super::measure::Bench;

/// Minimum number of rounds: fewer have no spread.
pub const ROUNDS_MIN: usize = 3;

/// Duration of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// The time after which no round begins, unless there are fewer than [`ROUNDS_MIN`].
    pub time: Duration,
    /// Number of rounds, at most.
    pub rounds: usize,
}

/// Times of a frame, ms.
#[derive(Clone, Copy, Debug)]
pub struct FrameTimes {
    pub forward: Spread,
    pub backward: Spread,
    pub step: Spread,
}

impl Bench<'_> {
    /// Times all settings on some views in turns, so that other load on the machine affects all alike. Every setting has
    /// run before, in its check, so kernels are compiled. Without cotangents, which are those of the views, no backward pass
    /// runs. Returns the times and the number of rounds.
    pub(super) fn time(
        &self,
        all: &[RenderOptions],
        views: &Range<usize>,
        cotangents: &[Tensor<3>],
        budget: Budget,
    ) -> Result<(Vec<FrameTimes>, usize)> {
        let begin = Instant::now();
        let mut samples = vec![[const { Vec::new() }; 3]; all.len()];
        let mut rounds = 0;
        while rounds < ROUNDS_MIN || (begin.elapsed() < budget.time && rounds < budget.rounds) {
            for (options, samples) in all.iter().zip(&mut samples) {
                let forward = self.time_forward(options, views)?;
                let backward = self.time_backward(options, views, cotangents)?;
                for (samples, ms) in samples.iter_mut().zip([forward, backward, forward + backward]) {
                    samples.push(ms);
                }
            }
            rounds += 1;
        }
        let spread = |samples: &Vec<f64>| Spread::of(samples).context("a time is not finite");
        let times = samples.iter().map(|[forward, backward, step]| {
            Ok(FrameTimes { forward: spread(forward)?, backward: spread(backward)?, step: spread(step)? })
        });
        Ok((times.collect::<Result<_>>()?, rounds))
    }

    /// Time of a frame, ms.
    fn time_forward(&self, options: &RenderOptions, views: &Range<usize>) -> Result<f64> {
        self.place.device.sync()?;
        let start = Instant::now();
        // Kept until they are computed: a result that nobody waits for may never be computed.
        let pictures: Vec<_> = views.clone().map(|view| self.place.render(view, options)).collect::<Result<_>>()?;
        self.place.device.sync()?;
        let elapsed = start.elapsed();
        drop(pictures);
        Ok(1e3 * elapsed.as_secs_f64() / views.len() as f64)
    }

    /// Time of a frame's backward pass, ms.
    fn time_backward(&self, options: &RenderOptions, views: &Range<usize>, cotangents: &[Tensor<3>]) -> Result<f64> {
        let mut elapsed = Duration::ZERO;
        for (view, cotangent) in views.clone().zip(cotangents) {
            let picture = self.place.tracked(view, options)?;
            self.place.device.sync()?;
            let start = Instant::now();
            let gradients = self.place.backward(picture, cotangent.clone());
            self.place.device.sync()?;
            elapsed += start.elapsed();
            drop(gradients);
        }
        Ok(1e3 * elapsed.as_secs_f64() / views.len() as f64)
    }
}
