//! What a run says of itself while it goes on: to its history, to a person, to a program.

use std::time::Instant;

use anyhow::Result;
use burn::tensor::{Device, Tensor};
use serde::Serialize;
use splat_model::capture::Photograph;
use splat_model::evaluate::evaluate_each;
use splat_model::gaussians::Gaussians;
use splat_model::metrics::lpips::Lpips;
use splat_model::trainer::{StepReport, Trainer};

use super::history::{History, Point, Recorder, Score};
use super::metrics::Metrics;
use crate::progress::{self, StepProgress};
use crate::snapshots::Snapshots;

/// Views that are looked at during a run, at most: evenly among those to test on.
const FEW: usize = 4;

/// A line of `--json`. Fields are added over time, and never renamed.
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "lowercase")]
pub enum Line<'a> {
    /// Before the first step.
    Start { steps: usize, train_views: usize, test_views: usize, splats: usize, device: &'a str, version: &'a str },
    /// Evenly over the steps, at most 251 times.
    Progress(Point),
    /// After every `--eval-during` steps.
    Evaluation(Score),
    /// At the end.
    Done { out: String, metrics: &'a Metrics },
}

/// What a scene is scored on during a run, and what is kept of it.
#[derive(Clone, Copy)]
pub struct Evaluation<'a> {
    pub test: &'a [Photograph],
    pub device: &'a Device,
    /// To score with too, if there is one.
    pub lpips: Option<&'a Lpips>,
    /// Where renders and scene are kept, if they are.
    pub snapshots: Option<&'a Snapshots<'a>>,
}

/// The log of a run.
pub struct RunLog {
    recorder: Recorder,
    bar: StepProgress,
    /// `[1]`: sum of the losses that were not read yet, and how many. Kept on the device: reading each would wait.
    losses: Option<(Tensor<1>, usize)>,
}

impl RunLog {
    /// Before the next of `steps` steps, of which `history` tells the first ones, which took so many seconds.
    pub fn new(steps: usize, history: History, seconds: f64) -> Self {
        Self { recorder: Recorder::new(steps, history, seconds), bar: StepProgress::new(steps), losses: None }
    }

    /// After a step.
    pub fn step(&mut self, report: &StepReport) {
        self.losses = Some(match self.losses.take() {
            Some((sum, count)) => (sum + report.loss.clone(), count + 1),
            None => (report.loss.clone(), 1),
        });
        let (shows, keeps) = (self.bar.tick(report.step), self.recorder.is_due(report.step));
        if !(shows || keeps) {
            return;
        }
        let losses = self.losses.take().map_or((0.0, 0), |(sum, count)| (sum.into_scalar::<f64>(), count));
        self.bar.add(losses);
        self.recorder.add(losses);
        if shows {
            self.bar.show(report.step, report.splats);
        }
        if keeps {
            let point = self.recorder.keep(report.step, report.splats);
            progress::line(&Line::Progress(point));
        }
    }

    /// Scores the scene as it is on a few of the photographs to test on. The clock of the run stands still.
    ///
    /// # Errors
    /// If a view cannot be rendered.
    pub fn evaluate(&mut self, trainer: &Trainer, evaluation: Evaluation) -> Result<()> {
        let Evaluation { test, device, lpips, snapshots } = evaluation;
        let start = Instant::now();
        // What smoothing does is in the rows, not in the parameters.
        let rows = trainer.rows();
        let splats = Gaussians::from_rows(&rows, device)?.splats();
        let (background, options) = (trainer.background(), trainer.render_options());
        let every = test.len().div_ceil(FEW).max(1);
        let photos = test.iter().step_by(every).map(|photo| Ok::<_, anyhow::Error>(photo.pixels()?));
        let taken = snapshots.map(|snapshots| snapshots.after(trainer.steps_done()));
        let scores = evaluate_each(&splats, photos, &background, &options, lpips, |comparison, _| {
            if let Some(taken) = &taken {
                taken.look(comparison);
            }
        })?;
        let kept = taken.map(|taken| taken.keep(&rows, &scores));
        let score = self.recorder.keep_score(trainer.steps_done(), &scores, start.elapsed());
        self.bar.resume();
        let perceived = score.lpips.map(|lpips| format!(", {lpips:.4} LPIPS")).unwrap_or_default();
        progress::note(&format!(
            "step {}: {:.2} dB PSNR, {:.4} SSIM{perceived} on {} test views",
            score.step, score.psnr, score.ssim, score.views
        ));
        progress::line(&Line::Evaluation(score));
        // Not worth a run: a disk that is full now may not be later.
        let kept = kept.unwrap_or(Ok(())).and_then(|()| match snapshots {
            Some(snapshots) => snapshots.keep_history(self.recorder.history()),
            None => Ok(()),
        });
        if let Err(error) = kept {
            progress::note(&format!("the snapshot after step {} is not kept: {error:#}", score.step));
        }
        Ok(())
    }

    /// Time that training has taken so far, s; evaluations do not count.
    pub fn seconds(&self) -> f64 {
        self.recorder.seconds()
    }

    /// How the run went so far.
    pub fn history(&self) -> &History {
        self.recorder.history()
    }

    /// After the last step.
    pub fn finish(self) -> History {
        self.bar.finish();
        self.recorder.into_history()
    }
}
