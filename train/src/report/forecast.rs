//! Prediction of the time that a run has left: the steps left, each with the time that recent steps took for their work. The work of a step is
//! the pixels of its pictures plus [`SPLAT_IN_PIXELS`] times the Gaussians. Refinements to come add as many Gaussians as recent ones.

use splat_model::trainer::TrainConfig;

/// Weight of the newest step in the running mean. The machine may become slower or faster.
const NEWEST: f64 = 0.02;

/// Time of a Gaussian relative to that of a pixel: about 2 on the demo capture and 3 to 4 on `fox_small`.
const SPLAT_IN_PIXELS: f64 = 2.7;

/// A time per step above this multiple of the expected one is cut to it: a checkpoint, or the first step after a run was resumed.
const SPIKE: f64 = 4.0;

/// Gaussians that a whole run is expected to add before its first refinement, relative to the first ones.
const GROWTH: f64 = 2.0;

/// Weight of the earlier refinements at each further one.
const MEMORY: f64 = 0.7;

/// A state of a run.
#[derive(Clone, Copy, Debug)]
pub struct RunProgress {
    /// Number of steps done.
    pub step: usize,
    pub splats: usize,
    /// Training time so far, s.
    pub seconds: f64,
}

pub struct Forecast {
    pub config: TrainConfig,
    /// Steps at which the number of Gaussians may change, ascending.
    pub refinements: Vec<usize>,
    /// Mean number of pixels of the photographs at full size.
    pixels: f64,
    last: RunProgress,
    /// Number of steps in the mean, which is of the time relative to the work, s.
    counted: f64,
    unit_s: f64,
    /// Gaussians that a refinement adds.
    growth: f64,
}

impl Forecast {
    /// A forecast for a run that begins with `splats` Gaussians.
    pub fn new(config: TrainConfig, refinements: Vec<usize>, splats: usize, pixels: f64) -> Self {
        let growth = GROWTH * splats as f64 / refinements.len().max(1) as f64;
        let last = RunProgress { step: 0, splats, seconds: 0.0 };
        Self { config, refinements, pixels, last, counted: 0.0, unit_s: 0.0, growth }
    }

    pub fn observe(&mut self, now: RunProgress) {
        let last = std::mem::replace(&mut self.last, now);
        let steps = now.step.saturating_sub(last.step) as f64;
        // The first step compiles kernels and fills caches.
        if steps == 0.0 || last.step == 0 {
            return;
        }
        let unit_s = (now.seconds - last.seconds).max(0.0) / steps / self.work(now.step, last.splats as f64);
        let most = if self.counted > 0.0 { SPIKE * self.unit_s } else { f64::INFINITY };
        self.counted += steps;
        // The plain mean at first, so that a slow first step does not dominate the start.
        let weight = (NEWEST * steps).max(steps / self.counted).min(1.0);
        self.unit_s += weight * (unit_s.min(most) - self.unit_s);
        let refined = self.refinements.iter().filter(|at| (last.step + 1..=now.step).contains(at)).count();
        if refined > 0 {
            let kept = MEMORY.powi(refined as i32);
            let added = (now.splats as f64 - last.splats as f64) / refined as f64;
            self.growth = kept * self.growth + (1.0 - kept) * added;
        }
    }

    /// Time of a step like the last one, s.
    pub fn step_s(&self) -> f64 {
        self.unit_s * self.work(self.last.step, self.last.splats as f64)
    }

    /// Time that the run has left, s.
    pub fn left_s(&self) -> f64 {
        let most = self.config.density.max_splats().max(self.last.splats) as f64;
        let (mut splats, mut left) = (self.last.splats as f64, 0.0);
        for step in self.last.step + 1..=self.config.steps {
            left += self.unit_s * self.work(step, splats);
            if self.refinements.binary_search(&step).is_ok() {
                splats = (splats + self.growth).clamp(0.0, most);
            }
        }
        left
    }

    /// The work of a step with a number of Gaussians, in pixels.
    fn work(&self, step: usize, splats: f64) -> f64 {
        let divisor = self.config.resolution.divisor_at(step.max(1), self.config.steps) as f64;
        self.pixels / (divisor * divisor) + SPLAT_IN_PIXELS * splats
    }
}

#[cfg(test)]
mod tests;
