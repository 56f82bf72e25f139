//! `--live`: a run in the browser while it trains.
//!
//! The trainer's thread gives what there is to show when somebody looks, and never waits for the server. The server's thread
//! encodes the scene. The time that both take is measured, and the next update waits until it is a small share of the run.

mod shared;

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Result;
use burn::tensor::Device;
use splat_model::capture::Photograph;
use splat_model::evaluate::{ViewScore, evaluate_each};
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::trainer::Trainer;

use self::shared::{FAREWELL, SCENE, Shared, Status, WorstView};
use crate::output::last_name;
use crate::progress;
use crate::report::{CURVES, CURVES_SCRIPT, History, Metrics, PAGE_STYLE, RunLog, SCENE_BYTES, escape, pictures};
use crate::view::{LOCALHOST, SceneSource, Server, ShownScene, Viewer, Viewpoint, document};

/// Shortest time between two updates of the same kind.
const BETWEEN: Duration = Duration::from_secs(1);

/// The largest share of the training time that the numbers take, and that the scene and the scores take.
const SHARE: f64 = 0.005;

/// Options of a run that is shown while it trains.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct LiveArgs {
    /// Show the run in the browser while it trains
    ///
    /// Show the run in the browser while it trains: the scene, the curves, the time left, the worst test view, and a button that stops the
    /// run and keeps its results. Without a port, one that is free. Served to this machine only, unless a host is given: `--live=0.0.0.0:7007`
    /// serves to all who have the address that is printed, which holds a secret; it is not encrypted
    #[arg(long, value_name = "[HOST:]PORT", num_args = 0..=1, require_equals = true, default_missing_value = "0", value_parser = address)]
    pub live: Option<(String, u16)>,
}

/// Parses `PORT` or `HOST:PORT`.
fn address(text: &str) -> Result<(String, u16), String> {
    let (host, port) = text.rsplit_once(':').unwrap_or((LOCALHOST, text));
    let host = host.trim_start_matches('[').trim_end_matches(']');
    match port.parse() {
        Ok(port) if !host.is_empty() => Ok((host.to_owned(), port)),
        _ => Err("expected a port such as 7007, or a host and a port such as 0.0.0.0:7007".into()),
    }
}

/// A run that is shown while it trains.
pub struct Live<'a> {
    shared: Arc<Shared>,
    server: Arc<Server>,
    serving: Option<JoinHandle<()>>,
    test: &'a [Photograph],
    device: &'a Device,
    numbers: Pace,
    scene: Pace,
    /// Number of scores taken so far, and the latest score of each view.
    taken: usize,
    scores: Vec<Option<f64>>,
    worst: Option<WorstView>,
}

impl<'a> Live<'a> {
    /// Begins to serve a run before its next step, and prints the address.
    pub fn start(
        server: Server,
        trainer: &Trainer,
        test: &'a [Photograph],
        device: &'a Device,
        out: &Path,
    ) -> Result<Self> {
        let rows = trainer.rows();
        let scene = ShownScene::new(&rows, SCENE_BYTES)?;
        let viewpoints = Viewpoint::all(test);
        let viewer = Viewer {
            scene: &scene,
            source: SceneSource::Live(SCENE.trim_start_matches('/')),
            viewpoints: &viewpoints,
            background: trainer.background().colour(),
            antialias: trainer.config().antialias,
        };
        let page = page(&last_name(out), &viewer)?;
        let shared = Arc::new(Shared::new(page, trainer.steps_done(), scene.ply));
        let server = Arc::new(server);
        let serving = std::thread::spawn({
            let (shared, server) = (Arc::clone(&shared), Arc::clone(&server));
            // Ends when the server is closed. A server that fails does not end the run.
            move || _ = server.serve(&*shared)
        });
        progress::note(&format!("live: {}", server.url()));
        Ok(Self {
            shared,
            server,
            serving: Some(serving),
            test,
            device,
            numbers: Pace::default(),
            scene: Pace::default(),
            taken: 0,
            scores: vec![None; test.len()],
            worst: None,
        })
    }

    /// Whether the button that stops the run has been pressed.
    pub fn stops(&self) -> bool {
        self.shared.stops()
    }

    /// Shows the state after a step, if somebody looks and an update is due.
    pub fn step(&mut self, trainer: &Trainer, log: &mut RunLog) -> Result<()> {
        if !self.shared.is_watched() {
            return Ok(());
        }
        if self.scene.is_due() {
            let begin = Instant::now();
            let rows = trainer.rows();
            self.score(&rows, trainer)?;
            self.shared.show_scene(trainer.steps_done(), rows);
            self.scene.done(begin.elapsed() + self.shared.take_encoding());
        }
        if self.numbers.is_due() {
            let begin = Instant::now();
            let left_s = log.left_s();
            self.shared.show(&Status {
                step: trainer.steps_done(),
                steps: trainer.config().steps,
                splats: trainer.gaussians().len(),
                seconds: log.recorder.seconds(),
                left_s,
                history: &log.recorder.history,
                scene: self.shared.scene_step(),
                worst: self.worst.as_ref(),
                metrics: None,
            });
            self.numbers.done(begin.elapsed());
        }
        Ok(())
    }

    /// Shows the results, with the scene's rows. Waits until a browser that looks has them, but not long.
    pub fn finish(self, rows: GaussianRows, metrics: &Metrics, history: &History) {
        let step = metrics.steps.unwrap_or_default();
        self.shared.show_scene(step, rows);
        self.shared.show(&Status {
            step,
            steps: step,
            splats: metrics.splats,
            seconds: metrics.seconds.train.unwrap_or_default(),
            left_s: 0.0,
            history,
            scene: step,
            worst: self.worst.as_ref(),
            metrics: Some(metrics),
        });
        let begin = Instant::now();
        while self.shared.is_watched() && !self.shared.results_are_taken() && begin.elapsed() < FAREWELL {
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Scores the next test view, and keeps its picture if it is the worst.
    fn score(&mut self, rows: &GaussianRows, trainer: &Trainer) -> Result<()> {
        if self.test.is_empty() {
            return Ok(());
        }
        let view = self.next_view();
        let splats = Gaussians::from_rows(rows, self.device)?.splats();
        let photo = self.test[view..=view].iter().map(|photo| Ok::<_, anyhow::Error>(photo.pixels()?));
        let (background, options) = (trainer.background(), trainer.render_options());
        let scores = &mut self.scores;
        let mut found = None;
        evaluate_each(&splats, photo, &background, &options, None, |comparison, score: &ViewScore| {
            scores[view] = Some(score.psnr);
            let is_worst = scores.iter().flatten().all(|other| !(*other < score.psnr));
            found = is_worst.then(|| (score.clone(), pictures::comparison(comparison)));
        })?;
        if let Some((score, picture)) = found {
            self.shared.show_worst(&picture);
            self.worst = Some(WorstView { name: score.name, psnr: score.psnr, step: trainer.steps_done() });
        }
        Ok(())
    }

    /// Returns the view to score next: all in turn, and the worst in between.
    fn next_view(&mut self) -> usize {
        self.taken += 1;
        let scored = self.scores.iter().enumerate().filter_map(|(view, score)| Some((view, (*score)?)));
        let worst = scored.min_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(view, _)| view);
        worst.filter(|_| self.taken.is_multiple_of(2)).unwrap_or(self.taken / 2 % self.test.len())
    }
}

impl Drop for Live<'_> {
    fn drop(&mut self) {
        self.server.close();
        if let Some(serving) = self.serving.take() {
            // A thread that panicked has printed why.
            let _ = serving.join();
        }
    }
}

/// The page of a run, which asks for everything that changes.
fn page(name: &str, viewer: &Viewer) -> Result<String> {
    const TILES: &str = "<ul class=\"tiles\">\n\
        <li><strong id=\"live-step\">–</strong> steps</li>\n\
        <li><strong id=\"live-left\">–</strong> left</li>\n\
        <li><strong id=\"live-seconds\">–</strong> training</li>\n\
        <li><strong id=\"live-splats\">–</strong> splats</li>\n\
        <li><strong id=\"live-loss\">–</strong> loss</li>\n\
        <li><strong id=\"live-psnr\">–</strong> PSNR of the test views</li>\n\
        </ul>\n<p><button id=\"live-stop\">Stop and keep</button> <span id=\"live-note\"></span></p>\n";
    const WORST: &str = "<section id=\"live-worst\" hidden>\n\
        <h2>Worst test view so far: photograph, render, error</h2>\n<p id=\"live-worst-name\"></p>\n\
        <img id=\"live-worst-picture\" alt=\"photograph, render and error of the worst test view\">\n</section>\n";
    let body = format!(
        "<main>\n<h1>{}</h1>\n{TILES}<section>\n<h2>Scene</h2>\n{}</section>\n{CURVES}{WORST}</main>\n{}\
         <script>{CURVES_SCRIPT}</script>\n<script>{}</script>\n",
        escape(name),
        viewer.element(),
        viewer.scripts()?,
        include_str!("live.js"),
    );
    Ok(document(&format!("{name} – splat"), PAGE_STYLE, &body))
}

/// The time of the next update.
#[derive(Default)]
struct Pace {
    due: Option<Instant>,
}

impl Pace {
    fn is_due(&self) -> bool {
        self.due.is_none_or(|due| Instant::now() >= due)
    }

    /// Waits after an update that took `cost` until it was at most [`SHARE`] of the time.
    fn done(&mut self, cost: Duration) {
        self.due = Some(Instant::now() + BETWEEN.max(cost.mul_f64(1.0 / SHARE)));
    }
}

#[cfg(test)]
mod tests;
