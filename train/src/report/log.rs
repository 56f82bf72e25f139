//! Log of a run in progress: to its history, for people, and for programs.

use std::time::Instant;

use anyhow::Result;
use burn::tensor::{Device, Tensor};
use serde::Serialize;
use splat_model::capture::Photograph;
use splat_model::evaluate::evaluate_each;
use splat_model::gaussians::Gaussians;
use splat_model::metrics::lpips::Lpips;
use splat_model::trainer::{StepReport, Trainer};

use super::history::{History, HistoryPoint, HistoryScore, Recorder};
use super::metrics::Metrics;
use crate::progress::{self, StepProgress};

/// Largest number of views scored during a run, spread evenly over the held-out views.
pub const FEW: usize = 4;

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

/// The log of a run.
pub struct RunLog {
    pub recorder: Recorder,
    bar: StepProgress,
    /// `[1]`: sum of the losses that were not read yet, and their number. Kept on the device, because each read would
    /// wait.
    losses: Option<(Tensor<1>, usize)>,
    /// Time that scores have taken since the run began or was resumed, s.
    scoring_s: f64,
}

impl RunLog {
    /// Begins the log before the next step of a run. `history` holds the earlier ones, which took `seconds`.
    pub fn new(trainer: &Trainer, history: History, seconds: f64) -> Self {
        let bar = StepProgress::new(trainer, &history);
        Self { recorder: Recorder::new(trainer.config().steps, history, seconds), bar, losses: None, scoring_s: 0.0 }
    }

    /// Logs a step that the trainer has just done.
    pub fn step(&mut self, report: &StepReport, trainer: &Trainer) {
        self.losses = Some(match self.losses.take() {
            Some((sum, count)) => (sum + report.loss.clone(), count + 1),
            None => (report.loss.clone(), 1),
        });
        let shows = self.bar.tick(report.step, report.splats, self.recorder.elapsed_s());
        let keeps = self.recorder.is_due(report.step);
        if !(shows || keeps) {
            return;
        }
        if let Some((sum, count)) = self.losses.take() {
            let sum = sum.into_scalar::<f64>();
            self.bar.add(sum, count);
            self.recorder.add(sum, count);
        }
        if shows {
            self.bar.show(report.step, trainer);
        }
        if keeps {
            let point = self.recorder.keep(report.step, report.splats);
            progress::line(&LogLine::Progress(point));
        }
    }

    /// Scores the present scene on a few of the held-out photographs. The clock of the run stands still.
    ///
    /// # Errors
    /// If a view cannot be rendered.
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

    /// Returns the time that scores have taken, relative to the time of training.
    pub fn scoring_share(&self) -> f64 {
        self.scoring_s / self.recorder.elapsed_s()
    }

    /// Predicts the time that the run has left, s.
    pub fn left_s(&self) -> f64 {
        self.bar.left_s()
    }

    /// Adapts the log to a number of steps that has changed.
    pub fn reschedule(&mut self, trainer: &Trainer) {
        self.recorder.set_steps(trainer.config().steps);
        self.bar.reschedule(trainer);
    }

    /// Ends the log after the last step.
    pub fn finish(self) -> History {
        self.bar.finish();
        self.recorder.history
    }
}
