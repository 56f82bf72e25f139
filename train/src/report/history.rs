//! History of a run, from its first step to the present one: loss and size by step, and scores where they were taken.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use splat_model::evaluate::Scores;

/// Largest number of points on a run's curve, not counting the last: enough for a plot, and few enough that reading the
/// loss from a device costs nothing.
const POINTS: usize = 250;

/// History of a run. A resumed run continues it, so that a run in two parts has one history.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct History {
    /// Points, spread evenly over the steps, in step order.
    pub points: Vec<HistoryPoint>,
    /// Scores, in step order; empty unless `--eval-during` asks for them.
    pub scores: Vec<HistoryScore>,
}

/// State of a run after some steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HistoryPoint {
    /// Number of steps done.
    pub step: usize,
    /// Training time so far, s; evaluations do not count.
    pub seconds: f64,
    /// Mean loss of the steps since the last point; null if it was not finite.
    #[serde(deserialize_with = "finite_or_nan")]
    pub loss: f64,
    /// Number of Gaussians.
    pub splats: usize,
}

/// Scores on a few held-out views during a run, taken before density control of the same step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HistoryScore {
    /// Number of steps done.
    pub step: usize,
    /// Training time so far, s.
    pub seconds: f64,
    /// Mean PSNR, dB.
    pub psnr: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// Mean LPIPS; null where it was not measured.
    #[serde(default)]
    pub lpips: Option<f64>,
    /// Number of views that the scores are the means of.
    pub views: usize,
}

/// Reads null as NaN, which JSON does not have.
fn finite_or_nan<'a, D: serde::Deserializer<'a>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::<f64>::deserialize(input)?.unwrap_or(f64::NAN))
}

/// Records the [`History`] of a run in progress.
#[derive(Debug)]
pub struct Recorder {
    /// The history so far, without the losses since the last point.
    pub history: History,
    /// Steps between points.
    every: usize,
    steps: usize,
    /// Sum and number of the losses since the last point.
    losses: (f64, usize),
    started: Instant,
    /// Training time before `started`.
    earlier: Duration,
}

impl Recorder {
    /// Starts to record a run of `steps` steps. `history` holds its first steps, which took `seconds`.
    pub fn new(steps: usize, history: History, seconds: f64) -> Self {
        Self {
            every: steps.div_ceil(POINTS).max(1),
            steps,
            losses: (0.0, 0),
            started: Instant::now(),
            // A value read from a file may not be a valid duration.
            earlier: Duration::try_from_secs_f64(seconds).unwrap_or_default(),
            history,
        }
    }

    /// Changes the number of steps of the run.
    pub fn set_steps(&mut self, steps: usize) {
        (self.every, self.steps) = (steps.div_ceil(POINTS).max(1), steps);
    }

    /// Training time so far, s.
    pub fn elapsed_s(&self) -> f64 {
        (self.earlier + self.started.elapsed()).as_secs_f64()
    }

    /// Training time so far, s to the millisecond.
    pub fn seconds(&self) -> f64 {
        (self.elapsed_s() * 1e3).round() / 1e3
    }

    /// Whether a point is due after this step.
    pub fn is_due(&self, step: usize) -> bool {
        step.is_multiple_of(self.every) || step == self.steps
    }

    /// Adds the sum and the number of the losses since the last call.
    pub fn add(&mut self, sum: f64, count: usize) {
        self.losses.0 += sum;
        self.losses.1 += count;
    }

    /// Records a point after a step.
    pub fn keep(&mut self, step: usize, splats: usize) -> HistoryPoint {
        let (sum, count) = std::mem::take(&mut self.losses);
        let point = HistoryPoint { step, seconds: self.seconds(), loss: sum / count as f64, splats };
        self.history.points.push(point);
        point
    }

    /// Records scores taken after a step. Taking them took `pause`, which is no training time.
    pub fn keep_score(&mut self, step: usize, scores: &Scores, pause: Duration) -> HistoryScore {
        // The clock stands still meanwhile. It is never set beyond now, whatever the pause.
        self.started = (self.started + pause).min(Instant::now());
        let &Scores { psnr, ssim, lpips, ref views, .. } = scores;
        let score = HistoryScore { step, seconds: self.seconds(), psnr, ssim, lpips, views: views.len() };
        self.history.scores.push(score);
        score
    }
}

#[cfg(test)]
mod tests;
