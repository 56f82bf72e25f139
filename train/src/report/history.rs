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
    pub fn add(&mut self, (sum, count): (f64, usize)) {
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
mod tests {
    use super::*;

    /// Scores of one view, as an earlier version wrote them.
    const SCORES: &str = r#"{"psnr": 20.0, "ssim": 0.5, "psnr_corrected": 21.0, "ssim_corrected": 0.6, "views": [
        {"name": "a.png", "psnr": 20.0, "ssim": 0.5, "psnr_corrected": 21.0, "ssim_corrected": 0.6}]}"#;

    fn run(steps: usize, history: History, until: usize) -> History {
        let mut recorder = Recorder::new(steps, history, 0.0);
        let done = recorder.history.points.last().map_or(0, |point| point.step);
        for step in done + 1..=until {
            recorder.add((step as f64, 1));
            if recorder.is_due(step) {
                recorder.keep(step, 10 * step);
            }
        }
        recorder.history
    }

    #[test]
    fn short_runs_have_every_step_and_long_ones_even_means() {
        let short = run(7, History::default(), 7);
        assert_eq!(short.points.iter().map(|point| point.step).collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6, 7]);
        let long = run(1001, History::default(), 1001);
        assert_eq!(long.points.len(), 201, "every fifth and the last");
        let (first, last) = (long.points[0], long.points[200]);
        assert_eq!((first.step, first.loss, first.splats), (5, 3.0, 50));
        assert_eq!((last.step, last.loss), (1001, 1001.0));
        assert!(run(30_000, History::default(), 30_000).points.len() <= POINTS + 1);
    }

    #[test]
    fn a_run_in_two_parts_has_the_history_of_one() {
        let without_times =
            |history: History| history.points.iter().map(|p| (p.step, p.loss, p.splats)).collect::<Vec<_>>();
        let first = run(1000, History::default(), 500);
        assert_eq!(without_times(run(1000, first, 1000)), without_times(run(1000, History::default(), 1000)));
    }

    #[test]
    fn time_goes_on_where_it_was_and_stands_still_while_scores_are_taken() {
        let mut recorder = Recorder::new(9, History::default(), 100.0);
        assert!((100.0..101.0).contains(&recorder.seconds()));
        std::thread::sleep(Duration::from_millis(30));
        let scores: Scores = serde_json::from_str(SCORES).unwrap();
        let score = recorder.keep_score(2, &scores, Duration::from_millis(30));
        assert_eq!((score.psnr, score.ssim, score.lpips, score.views), (20.0, 0.5, None, 1));
        assert!((100.0..100.025).contains(&score.seconds), "{score:?}");
        // Nor does the clock go back.
        let score = recorder.keep_score(2, &scores, Duration::from_secs(3600));
        assert!(score.seconds >= 100.0, "{score:?}");
        for seconds in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(Recorder::new(9, History::default(), seconds).seconds() < 1.0);
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let mut history = run(3, History::default(), 3);
        history.scores.push(HistoryScore { step: 2, seconds: 0.5, psnr: 20.0, ssim: 0.9, lpips: Some(0.25), views: 4 });
        let text = serde_json::to_string(&history).unwrap();
        assert_eq!(serde_json::from_str::<History>(&text).unwrap(), history);
        history.points[0].loss = f64::NAN;
        let text = serde_json::to_string(&history).unwrap();
        assert!(serde_json::from_str::<History>(&text).unwrap().points[0].loss.is_nan());
    }
}
