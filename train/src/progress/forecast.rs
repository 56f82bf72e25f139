//! Prediction of the time that a run has left.
//!
//! The time of a step is taken as `(1 − φ) p + φ n` times a factor, with `p` the pixels of its pictures relative to full size
//! and `n` the Gaussians relative to the first step, weighted by their coefficients. The factor is a mean over the latest
//! steps. The share `φ` follows from [`SPLAT_IN_PIXELS`] at first and is fitted to the steps. For the steps to come, the
//! schedule gives `p`, and the strategy's outlook, corrected by the growth so far, gives `n`.

use splat_model::optim::sh_degree_at;
use splat_model::trainer::TrainConfig;

/// Weight of the newest step in the running means. The machine may become slower or faster.
const NEWEST: f64 = 0.01;

/// Time of a Gaussian relative to that of a pixel, before it is known: about 2 on the demo capture and 3 to 4 on `fox_small`,
/// in processor time of one core.
const SPLAT_IN_PIXELS: f64 = 2.7;

/// Weight of that value in the fit, in steps.
const ASSUMED_STEPS: f64 = 50.0;

/// Range of the share. Beyond it the fit follows the machine's load.
const SHARES: (f64, f64) = (0.03, 0.95);

/// Increase of the cost of a Gaussian from spherical harmonics of degree 0 to degree 3, measured on `fox_small`.
const HARMONICS: f64 = 0.3;

/// A time per step above this multiple of the expected one is cut to it: a checkpoint on a slow disk, or the first step after
/// a run was resumed.
const SPIKE: f64 = 4.0;

/// Growth by a refinement relative to the one before, where the strategy has no outlook.
const FADING: f64 = 0.98;

/// Weight of what the strategy expected in the correction by what came, in refinements.
const TRUST: f64 = 0.25;

/// Weight of the refinements so far at each further one.
const MEMORY: f64 = 0.7;

/// Range of the correction.
const CORRECTIONS: (f64, f64) = (0.2, 3.0);

/// A state of a run.
#[derive(Clone, Copy, Debug)]
pub struct Observed {
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
    /// Number of Gaussians at the start.
    first: f64,
    /// The share `φ` before it is known.
    assumed: f64,
    last: Observed,
    /// Number of steps in the means.
    counted: f64,
    /// Running means over the steps: time, `p`, and `n`.
    means: [f64; 3],
    /// Sums over the steps for the fit of the share: `p²`, `p n`, `n²`, `p t`, and `n t`, with times relative to the mean.
    sums: [f64; 5],
    /// Number of Gaussians when the strategy had its outlook, and the outlook.
    outlook: Option<(f64, Vec<(usize, usize)>)>,
    /// Growth by the refinements so far, with decreasing weights: what came, what was expected, and the sum of the weights.
    growth: [f64; 3],
}

impl Forecast {
    /// A forecast for a run that begins with `splats` Gaussians in photographs of `pixels` pixels, and whose number of
    /// Gaussians may change at the steps `refinements`.
    pub fn new(config: TrainConfig, refinements: Vec<usize>, (splats, pixels): (usize, f64)) -> Self {
        let first = splats.max(1) as f64;
        Self {
            config,
            refinements,
            first,
            assumed: SPLAT_IN_PIXELS * first / (SPLAT_IN_PIXELS * first + pixels),
            last: Observed { step: 0, splats, seconds: 0.0 },
            counted: 0.0,
            means: [0.0; 3],
            sums: [0.0; 5],
            outlook: None,
            growth: [0.0; 3],
        }
    }

    /// Changes the configuration and the refinements of the run. What was observed of it stays.
    pub fn reschedule(&mut self, config: TrainConfig, refinements: Vec<usize>) {
        (self.config, self.refinements) = (config, refinements);
    }

    /// Observes the run after one step or several.
    pub fn observe(&mut self, now: Observed) {
        let last = std::mem::replace(&mut self.last, now);
        let steps = now.step.saturating_sub(last.step) as f64;
        // The first step compiles kernels and fills caches.
        if steps == 0.0 || last.step == 0 {
            return;
        }
        let [p, n] = self.work(now.step, last.splats as f64);
        let mut time = (now.seconds - last.seconds).max(0.0) / steps;
        if self.counted > 0.0 {
            time = time.min(SPIKE * self.step_s([p, n]));
        }
        self.counted += steps;
        // The plain mean at first, so that a slow first step does not dominate the start.
        let weight = (1.0 - (1.0 - NEWEST).powf(steps)).max(steps / self.counted).min(1.0);
        for (mean, value) in self.means.iter_mut().zip([time, p, n]) {
            *mean += weight * (value - *mean);
        }
        let scale = self.means[0].max(f64::MIN_POSITIVE);
        for (sum, product) in self.sums.iter_mut().zip([p * p, p * n, n * n, p * time, n * time]) {
            *sum += steps * product / (scale * scale);
        }
        self.compare(last, now);
    }

    /// Takes in the strategy's outlook after the last observed step, if it has one.
    pub fn expect(&mut self, outlook: Option<Vec<(usize, usize)>>) {
        if let Some(outlook) = outlook {
            self.outlook = Some((self.last.splats as f64, outlook));
        }
    }

    /// Mean time of the latest steps, s.
    pub fn mean_s(&self) -> f64 {
        self.means[0]
    }

    /// Time that the run has left, s.
    pub fn left_s(&self) -> f64 {
        let mut numbers = self.numbers().into_iter().peekable();
        let mut splats = self.last.splats as f64;
        let mut left = 0.0;
        for step in self.last.step + 1..=self.config.steps {
            left += self.step_s(self.work(step, splats));
            while let Some((_, number)) = numbers.next_if(|(at, _)| *at <= step) {
                splats = number;
            }
        }
        left
    }

    /// Compares the growth between two observations with the expected one.
    fn compare(&mut self, last: Observed, now: Observed) {
        let refined = self.refinements.iter().filter(|at| (last.step + 1..=now.step).contains(at)).count();
        if refined == 0 {
            return;
        }
        let kept = MEMORY.powi(refined as i32);
        let expected = self.expected_at(now.step) - self.expected_at(last.step);
        let added = [now.splats as f64 - last.splats as f64, expected, refined as f64];
        for (sum, value) in self.growth.iter_mut().zip(added) {
            *sum = kept * *sum + value;
        }
    }

    /// The number of Gaussians that the strategy expected after a step.
    fn expected_at(&self, step: usize) -> f64 {
        let Some((splats, outlook)) = &self.outlook else { return 0.0 };
        outlook.iter().take_while(|(at, _)| *at <= step).last().map_or(*splats, |(_, number)| *number as f64)
    }

    /// The numbers of Gaussians after the refinements to come, each with its step.
    fn numbers(&self) -> Vec<(usize, f64)> {
        let Observed { step, splats, .. } = self.last;
        let later = self.refinements.iter().copied().filter(|at| *at > step);
        let most = self.config.density.max_splats() as f64;
        let [came, expected, weight] = self.growth;
        let in_range = |number: f64| number.min(most.max(splats as f64)).max(0.0);
        if self.outlook.is_some() {
            let right = if expected > 0.0 { (came / expected - 1.0) * weight / (weight + TRUST) } else { 0.0 };
            let correction = (1.0 + right).clamp(CORRECTIONS.0, CORRECTIONS.1);
            let from = self.expected_at(step);
            let number = |at| in_range(splats as f64 + correction * (self.expected_at(at) - from));
            return later.map(|at| (at, number(at))).collect();
        }
        let (mut number, mut growth) = (splats as f64, if weight > 0.0 { (came / weight).max(0.0) } else { 0.0 });
        let grown = |at| {
            number = in_range(number + growth);
            growth *= FADING;
            (at, number)
        };
        later.map(grown).collect()
    }

    /// The `p` and `n` of a step with a number of Gaussians.
    fn work(&self, step: usize, splats: f64) -> [f64; 2] {
        let divisor = self.config.resolution.divisor_at(step.max(1), self.config.steps) as f64;
        let degree = sh_degree_at(step.max(1) - 1, self.config.sh_every, self.config.sh_degree);
        let coefficients = ((degree + 1) * (degree + 1)) as f64;
        [1.0 / (divisor * divisor), splats / self.first * (1.0 + HARMONICS * (coefficients - 1.0) / 15.0)]
    }

    /// The time of a step with this work, s.
    fn step_s(&self, [p, n]: [f64; 2]) -> f64 {
        let share = self.share();
        let in_all = |p, n| (1.0 - share) * p + share * n;
        let [time, mean_p, mean_n] = self.means;
        let seen = in_all(mean_p, mean_n);
        if seen > 0.0 { time / seen * in_all(p, n) } else { 0.0 }
    }

    /// The share `φ` that fits the steps so far: least squares for the times of `p` and of `n`, with the assumed share as
    /// [`ASSUMED_STEPS`] more steps.
    fn share(&self) -> f64 {
        let [pp, pn, nn, pt, nt] = self.sums;
        let (of_n, weight) = (self.assumed, ASSUMED_STEPS / self.scale());
        let of_p = 1.0 - of_n;
        let (pp, pn, nn) = (pp + weight * of_n * of_n, pn - weight * of_n * of_p, nn + weight * of_p * of_p);
        let (time_p, time_n) = (pt * nn - nt * pn, nt * pp - pt * pn);
        let share = time_n / (time_p + time_n);
        if share.is_finite() { share.clamp(SHARES.0, SHARES.1) } else { self.assumed }
    }

    /// Square of the mean time of a step, s², in whose unit the sums of the fit are.
    fn scale(&self) -> f64 {
        (self.means[0] * self.means[0]).max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests;
