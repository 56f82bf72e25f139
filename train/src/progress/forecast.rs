//! Prediction of the time that a run has left: the steps left, each with the time that recent steps took for their work.
//!
//! The work of a step is the pixels of its pictures plus [`SPLAT_IN_PIXELS`] times the Gaussians. The schedule gives the pixels
//! to come. Each refinement to come is expected to add as many Gaussians as recent ones did.

use splat_model::trainer::TrainConfig;

/// Weight of the newest step in the running means. The machine may become slower or faster.
const NEWEST: f64 = 0.02;

/// Time of a Gaussian relative to that of a pixel: about 2 on the demo capture and 3 to 4 on `fox_small`.
const SPLAT_IN_PIXELS: f64 = 2.7;

/// A time per step above this multiple of the expected one is cut to it: a checkpoint on a slow disk, or the first step after
/// a run was resumed.
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
    /// Number of Gaussians.
    pub splats: usize,
    /// Training time so far, s.
    pub seconds: f64,
}

/// Forecast of a run from its configuration and what was observed of it.
pub struct Forecast {
    config: TrainConfig,
    /// Steps at which the number of Gaussians may change, ascending.
    refinements: Vec<usize>,
    /// Mean number of pixels of the photographs at full size.
    pixels: f64,
    last: RunProgress,
    /// Number of steps in the means.
    counted: f64,
    /// Running means over the steps: time, s, and time relative to the work, s.
    step_s: f64,
    unit_s: f64,
    /// Gaussians that a refinement adds.
    growth: f64,
}

impl Forecast {
    /// A forecast for a run that begins with `splats` Gaussians in photographs of `pixels` pixels, and whose number of
    /// Gaussians may change at the steps `refinements`.
    pub fn new(config: TrainConfig, refinements: Vec<usize>, (splats, pixels): (usize, f64)) -> Self {
        let growth = GROWTH * splats as f64 / refinements.len().max(1) as f64;
        let last = RunProgress { step: 0, splats, seconds: 0.0 };
        Self { config, refinements, pixels, last, counted: 0.0, step_s: 0.0, unit_s: 0.0, growth }
    }

    /// Changes the configuration and the refinements of the run. What was observed of it stays.
    pub fn reschedule(&mut self, config: TrainConfig, refinements: Vec<usize>) {
        (self.config, self.refinements) = (config, refinements);
    }

    /// Observes the run after one step or several.
    pub fn observe(&mut self, now: RunProgress) {
        let last = std::mem::replace(&mut self.last, now);
        let steps = now.step.saturating_sub(last.step) as f64;
        // The first step compiles kernels and fills caches.
        if steps == 0.0 || last.step == 0 {
            return;
        }
        let work = self.work(now.step, last.splats as f64);
        let mut step_s = (now.seconds - last.seconds).max(0.0) / steps;
        if self.counted > 0.0 {
            step_s = step_s.min(SPIKE * self.unit_s * work);
        }
        self.counted += steps;
        // The plain mean at first, so that a slow first step does not dominate the start.
        let weight = (NEWEST * steps).max(steps / self.counted).min(1.0);
        self.step_s += weight * (step_s - self.step_s);
        self.unit_s += weight * (step_s / work - self.unit_s);
        let refined = self.refinements.iter().filter(|at| (last.step + 1..=now.step).contains(at)).count();
        if refined > 0 {
            let kept = MEMORY.powi(refined as i32);
            let added = (now.splats as f64 - last.splats as f64) / refined as f64;
            self.growth = kept * self.growth + (1.0 - kept) * added;
        }
    }

    /// Mean time of the latest steps, s.
    pub fn mean_s(&self) -> f64 {
        self.step_s
    }

    /// Time that the run has left, s.
    pub fn left_s(&self) -> f64 {
        let most = self.config.density.max_splats().max(self.last.splats) as f64;
        let mut splats = self.last.splats as f64;
        let mut left = 0.0;
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
mod tests {
    use splat_model::trainer::Resolution;

    use super::*;

    /// Largest accepted error of the time left.
    const ACCEPTED: f64 = 0.25;

    /// The steps of a run of 1,000 whose photographs have `pixels` pixels and which begins with 10,000 Gaussians and adds `added` of them
    /// every 50 steps, from step 100 to 450. Forecasts are compared from step `from` on.
    fn assert_foreseen(resolution: Resolution, added: usize, from: usize) {
        let config = TrainConfig { steps: 1000, resolution, ..TrainConfig::default() };
        let refinements: Vec<usize> = (100..500).step_by(50).collect();
        let mut forecast = Forecast::new(config.clone(), refinements.clone(), (10_000, 30_000.0));
        let (mut splats, mut seconds) = (10_000, vec![0.0]);
        let mut forecasts = Vec::new();
        for step in 1..=1000 {
            let divisor = config.resolution.divisor_at(step, 1000) as f64;
            // The first step and a checkpoint take long, and views differ.
            let rare = if step == 1 || step % 400 == 0 { 30.0 } else { 1.0 + 0.2 * (2.4 * step as f64).sin() };
            let took = 1e-6 * rare * (30_000.0 / (divisor * divisor) + 3.5 * splats as f64);
            seconds.push(seconds[step - 1] + took);
            splats += if refinements.contains(&step) { added } else { 0 };
            forecast.observe(RunProgress { step, splats, seconds: seconds[step] });
            forecasts.push((step, forecast.left_s()));
        }
        for (step, found) in forecasts.into_iter().filter(|(step, _)| (from..900).contains(step)) {
            let left = seconds[1000] - seconds[step];
            assert!((found / left - 1.0).abs() < ACCEPTED, "step {step}: {found} s instead of {left}");
        }
    }

    #[test]
    fn a_run_that_does_not_grow_ends_when_it_is_expected_to() {
        assert_foreseen(Resolution::FULL, 0, 350);
    }

    #[test]
    fn growth_goes_on_as_it_began() {
        assert_foreseen(Resolution::FULL, 2_500, 20);
        assert_foreseen(Resolution::FULL, 6_000, 300);
    }

    #[test]
    fn photographs_that_are_small_at_first_are_expected_to_grow() {
        assert_foreseen(Resolution { coarsest_divisor: 4, ..Resolution::FULL }, 2_500, 20);
    }

    #[test]
    fn nothing_is_left_after_the_last_step_and_nothing_is_known_before_the_second() {
        let config = TrainConfig { steps: 3, ..TrainConfig::default() };
        let mut forecast = Forecast::new(config, vec![], (10, 100.0));
        forecast.observe(RunProgress { step: 1, splats: 10, seconds: 9.0 });
        assert_eq!((forecast.left_s(), forecast.mean_s()), (0.0, 0.0));
        forecast.observe(RunProgress { step: 2, splats: 10, seconds: 9.5 });
        assert!((forecast.left_s() - 0.5).abs() < 1e-9 && (forecast.mean_s() - 0.5).abs() < 1e-9);
        forecast.observe(RunProgress { step: 3, splats: 10, seconds: 10.0 });
        assert_eq!(forecast.left_s(), 0.0);
    }
}
