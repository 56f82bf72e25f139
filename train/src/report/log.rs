//! Log of a run in progress: to its history, for people, and for programs.

use std::time::Instant;

use anyhow::Result;
use burn::tensor::{Device, Tensor};
use indicatif::ProgressBar;
use serde::Serialize;
use splat_model::capture::Photograph;
use splat_model::evaluate::evaluate_each;
use splat_model::gaussians::Gaussians;
use splat_model::metrics::lpips::Lpips;
use splat_model::trainer::{StepReport, Trainer};

use super::forecast::{Forecast, RunProgress};
use super::history::{History, HistoryPoint, HistoryScore, Recorder};
use super::metrics::Metrics;
use crate::progress::{self, BETWEEN_FRAMES, BETWEEN_LINES, clock};

/// Largest number of views scored during a run, spread evenly over the held-out views.
const FEW: usize = 4;

/// A line of `--json`. Fields are added over time, and never renamed.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum LogLine<'a> {
    /// Written before the first step.
    Start { steps: usize, train_views: usize, test_views: usize, splats: usize, device: &'a str, version: &'a str },
    /// Written evenly over the steps, at most 251 times.
    Progress(HistoryPoint),
    /// Written after every `--eval-during` steps, before density control of the same step.
    Evaluation(HistoryScore),
    /// Written at the end.
    Done { out: String, metrics: &'a Metrics },
}

pub struct RunLog {
    pub recorder: Recorder,
    bar: Option<ProgressBar>,
    forecast: Forecast,
    /// When progress was last shown, and the sum and the number of the losses since.
    shown: Instant,
    shown_losses: (f64, usize),
    /// `[1]`: sum of the losses that were not read yet, and their number. Kept on the device, because each read would wait.
    losses: Option<(Tensor<1>, usize)>,
    /// Number of scores since the run began or was resumed, and the time that they have taken, s.
    scored: usize,
    scoring_s: f64,
}

impl RunLog {
    /// Begins the log before the next step of a run. `history` holds the earlier ones, which took `seconds`.
    pub fn new(trainer: &Trainer, history: History, seconds: f64) -> Self {
        let config = trainer.config();
        let splats = history.points.first().map_or(trainer.gaussians().len(), |point| point.splats);
        let mut forecast = Forecast::new(config.clone(), refinements(trainer), splats, trainer.mean_pixels());
        for point in &history.points {
            forecast.observe(RunProgress { step: point.step, splats: point.splats, seconds: point.seconds });
        }
        Self {
            bar: progress::bar(Some(config.steps), "[{bar:32}] {msg}"),
            recorder: Recorder::new(config.steps, history, seconds),
            forecast,
            shown: Instant::now(),
            shown_losses: (0.0, 0),
            losses: None,
            scored: 0,
            scoring_s: 0.0,
        }
    }

    /// Logs a step that the trainer has just done.
    pub fn step(&mut self, report: &StepReport, trainer: &Trainer) {
        self.losses = Some(match self.losses.take() {
            Some((sum, count)) => (sum + report.loss.clone(), count + 1),
            None => (report.loss.clone(), 1),
        });
        let &StepReport { step, splats, .. } = report;
        self.forecast.observe(RunProgress { step, splats, seconds: self.recorder.elapsed_s() });
        let pause = if self.bar.is_some() { BETWEEN_FRAMES } else { BETWEEN_LINES };
        let is_time = self.shown.elapsed() >= pause || step >= trainer.config().steps;
        let (shows, keeps) = (is_time && !progress::is_quiet(), self.recorder.is_due(step));
        if !(shows || keeps) {
            return;
        }
        if let Some((sum, count)) = self.losses.take() {
            let sum = sum.into_scalar::<f64>();
            self.shown_losses = (self.shown_losses.0 + sum, self.shown_losses.1 + count);
            self.recorder.add(sum, count);
        }
        if shows {
            self.show(step, trainer);
        }
        if keeps {
            let point = self.recorder.keep(step, splats);
            progress::line(&LogLine::Progress(point));
        }
    }

    /// Shows the state of the run after a step.
    fn show(&mut self, step: usize, trainer: &Trainer) {
        self.shown = Instant::now();
        let (sum, count) = std::mem::take(&mut self.shown_losses);
        let (steps, splats) = (trainer.config().steps, trainer.gaussians().len());
        let rate = 1.0 / self.forecast.step_s();
        let line = said([step, steps], sum / count as f64, splats, rate, self.left_s());
        match &self.bar {
            None => progress::note(&line),
            Some(bar) => {
                bar.set_position(step as u64);
                bar.set_message(line);
            }
        }
    }

    /// Scores the present scene on a few of the held-out photographs. The clock of the run stands still. An error if a
    /// view cannot be rendered.
    pub fn evaluate(
        &mut self,
        trainer: &Trainer,
        test: &[Photograph],
        device: &Device,
        lpips: Option<&Lpips>,
    ) -> Result<()> {
        let start = Instant::now();
        // The rows include the effect of smoothing, the parameters do not.
        let rows = trainer.rows();
        let splats = Gaussians::from_rows(&rows, device)?.splats();
        let (background, options) = (trainer.background(), trainer.render_options());
        let every = test.len().div_ceil(FEW).max(1);
        let photos = test.iter().step_by(every).map(|photo| Ok::<_, anyhow::Error>(photo.pixels()?));
        let scores = evaluate_each(&splats, photos, &background, &options, lpips, |_, _| {})?;
        self.scored += 1;
        self.scoring_s += start.elapsed().as_secs_f64();
        let score = self.recorder.keep_score(trainer.steps_done(), &scores, start.elapsed());
        let perceived = score.lpips.map(|lpips| format!(", {lpips:.4} LPIPS")).unwrap_or_default();
        progress::note(&format!(
            "step {}: {:.2} dB PSNR, {:.4} SSIM{perceived} on {} test views",
            score.step, score.psnr, score.ssim, score.views
        ));
        progress::line(&LogLine::Evaluation(score));
        Ok(())
    }

    /// Returns the time that scores have taken since the run began or was resumed, s to the millisecond.
    pub fn scoring_s(&self) -> f64 {
        (1e3 * self.scoring_s).round() / 1e3
    }

    /// Returns the time that scores will have taken after the next one, s: it takes as long as those before, and the first one as long as a step
    /// for each view.
    pub fn scoring_s_with_next(&self, test: &[Photograph]) -> f64 {
        match self.scored {
            0 => test.len().min(FEW) as f64 * self.forecast.step_s(),
            scored => self.scoring_s * (scored + 1) as f64 / scored as f64,
        }
    }

    /// Predicts the time that the run has left, s.
    pub fn left_s(&self) -> f64 {
        self.forecast.left_s()
    }

    /// Adapts the log to a number of steps that has changed.
    pub fn reschedule(&mut self, trainer: &Trainer) {
        let steps = trainer.config().steps;
        self.recorder.set_steps(steps);
        if let Some(bar) = &self.bar {
            bar.set_length(steps as u64);
        }
        (self.forecast.config, self.forecast.refinements) = (trainer.config().clone(), refinements(trainer));
    }

    /// Ends the log after the last step.
    pub fn finish(self) -> History {
        if let Some(bar) = self.bar {
            bar.abandon();
        }
        self.recorder.history
    }
}

/// The steps at which the number of Gaussians may change.
fn refinements(trainer: &Trainer) -> Vec<usize> {
    (1..=trainer.config().steps).filter(|&step| trainer.refines_at(step)).collect()
}

/// The state of a run after a step of so many, for people. The rate is in steps a second.
fn said([step, steps]: [usize; 2], loss: f64, splats: usize, rate: f64, left_s: f64) -> String {
    let rate = if rate.is_finite() { format!("{rate:.1}") } else { "-".into() };
    let left = clock(left_s);
    format!("step {step}/{steps}  loss {loss:.4}  {splats} splats  {rate} steps/s  {left} left")
}

#[cfg(test)]
mod tests;
