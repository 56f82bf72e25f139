//! Times of all settings, measured in turns.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use burn::tensor::Tensor;
use splat_op::RenderOptions;

use super::measure::{Bench, SettingMeasurements};
use super::quartiles::Quartiles;

/// Minimum number of rounds: fewer have no spread.
pub const ROUNDS_MIN: usize = 3;

/// Times of a frame, ms.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameTimes {
    pub forward: Quartiles,
    pub backward: Quartiles,
    pub step: Quartiles,
}

impl Bench<'_> {
    /// Times all settings on all views in turns, so that other load on the machine affects all alike. Every setting has
    /// run before, in its check, so kernels are compiled. After `budget` no round begins, unless there were fewer than
    /// [`ROUNDS_MIN`]. Returns the number of rounds.
    pub(super) fn time(
        &self,
        settings: &mut [SettingMeasurements],
        cotangents: &[Tensor<3>],
        budget: Duration,
    ) -> Result<usize> {
        let begin = Instant::now();
        let mut samples = vec![[const { Vec::new() }; 3]; settings.len()];
        let mut rounds = 0;
        while rounds < ROUNDS_MIN || begin.elapsed() < budget {
            for (setting, samples) in settings.iter().zip(&mut samples) {
                let options = &setting.candidate.options;
                let forward = self.time_forward(options)?;
                let backward = self.time_backward(options, cotangents)?;
                for (samples, ms) in samples.iter_mut().zip([forward, backward, forward + backward]) {
                    samples.push(ms);
                }
            }
            rounds += 1;
        }
        let spread = |samples: &Vec<f64>| Quartiles::of(samples).context("a time is not finite");
        for (setting, [forward, backward, step]) in settings.iter_mut().zip(&samples) {
            setting.times = FrameTimes { forward: spread(forward)?, backward: spread(backward)?, step: spread(step)? };
        }
        Ok(rounds)
    }

    /// Time of a frame, ms.
    fn time_forward(&self, options: &RenderOptions) -> Result<f64> {
        let views = 0..self.photos.len();
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
    fn time_backward(&self, options: &RenderOptions, cotangents: &[Tensor<3>]) -> Result<f64> {
        let mut elapsed = Duration::ZERO;
        for (view, cotangent) in cotangents.iter().enumerate() {
            let picture = self.place.tracked(view, options)?;
            self.place.device.sync()?;
            let start = Instant::now();
            let gradients = self.place.backward(picture, cotangent.clone());
            self.place.device.sync()?;
            elapsed += start.elapsed();
            drop(gradients);
        }
        Ok(1e3 * elapsed.as_secs_f64() / cotangents.len() as f64)
    }
}
