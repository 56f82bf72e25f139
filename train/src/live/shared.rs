//! What the trainer's thread and the server's thread share.

use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use serde::Serialize;
use splat_model::gaussians::GaussianRows;

use crate::report::{History, Metrics, SCENE_BYTES};
use crate::view::{ShownScene, Site};

/// The paths of the server.
pub const SCENE: &str = "/scene.ply";
const STATUS: &str = "/status.json";
const WORST: &str = "/worst.jpg";
const STOP: &str = "/stop";

/// Time after the last request for the status for which somebody looks. Browsers slow pages in the background down to a request a minute.
pub const LOOKS: Duration = Duration::from_secs(10);

/// The longest time that a finished run waits for a browser that still looks to load its results. Whoever pressed the button that stops the
/// run looks for as long: a busy page may ask late.
pub const FAREWELL: Duration = Duration::from_secs(60);

/// JPEG quality of the worst view.
const QUALITY: u8 = 90;

/// The numbers of a run, as `/status.json`.
#[derive(Serialize)]
pub struct Status<'a> {
    /// Steps done, and steps of the whole run.
    pub step: usize,
    pub steps: usize,
    pub splats: usize,
    /// Training time so far, and the time left, s.
    pub seconds: f64,
    pub left_s: f64,
    pub history: &'a History,
    /// Step of the scene that `/scene.ply` gives.
    pub scene: usize,
    /// The worst test view; null if none has been scored.
    pub worst: Option<&'a WorstView>,
    /// Content of `metrics.json`; null until the run has ended.
    pub metrics: Option<&'a Metrics>,
}

/// The test view with the lowest score.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorstView {
    pub name: String,
    /// PSNR, dB.
    pub psnr: f64,
    /// Step at which it was scored.
    pub step: usize,
}

#[derive(Default)]
pub struct Shared {
    page: Vec<u8>,
    /// The time until which somebody looks. It has a lock of its own, because the trainer asks after each step.
    pub watched_until: Mutex<Option<Instant>>,
    stops: AtomicBool,
    shown: Mutex<Shown>,
}

/// The latest state of the run.
#[derive(Default)]
struct Shown {
    status: Vec<u8>,
    /// Step of the scene, and whether a browser has loaded it.
    scene_step: usize,
    is_loaded: bool,
    /// Whether the status has the results, and whether a browser has loaded them.
    has_results: bool,
    results_are_loaded: bool,
    /// Rows of the scene until it is asked for, and its file from then on.
    rows: Option<GaussianRows>,
    ply: Vec<u8>,
    /// Time spent on encoding scenes since it was last taken.
    encoding: Duration,
    worst: Vec<u8>,
}

impl Shared {
    /// The state before a run's next step, with the step and the file of its present scene.
    pub fn new(page: String, scene_step: usize, ply: Vec<u8>) -> Self {
        let shown = Shown { status: b"null".to_vec(), scene_step, ply, ..Shown::default() };
        Self { page: page.into_bytes(), shown: Mutex::new(shown), ..Self::default() }
    }

    /// Whether a browser has asked lately.
    pub fn is_watched(&self) -> bool {
        locked(&self.watched_until).is_some_and(|until| Instant::now() <= until)
    }

    fn watch_for(&self, time: Duration) {
        let until = Some(Instant::now() + time);
        let mut watched = locked(&self.watched_until);
        *watched = until.max(*watched);
    }

    pub fn stops(&self) -> bool {
        self.stops.load(Ordering::Relaxed)
    }

    pub fn show(&self, status: &Status) {
        // No value of a status fails to be written.
        if let Ok(written) = serde_json::to_vec(status) {
            let mut shown = self.lock();
            (shown.status, shown.has_results) = (written, status.metrics.is_some());
        }
    }

    pub fn show_scene(&self, step: usize, rows: GaussianRows) {
        let mut shown = self.lock();
        (shown.scene_step, shown.is_loaded, shown.rows) = (step, false, Some(rows));
    }

    pub fn show_worst(&self, picture: &RgbImage) {
        let mut file = Vec::new();
        // Writing to memory does not fail.
        if picture.write_with_encoder(JpegEncoder::new_with_quality(&mut file, QUALITY)).is_ok() {
            self.lock().worst = file;
        }
    }

    pub fn scene_step(&self) -> usize {
        self.lock().scene_step
    }

    /// Whether a browser has loaded the results, and after them the scene.
    pub fn results_are_taken(&self) -> bool {
        let shown = self.lock();
        shown.results_are_loaded && shown.is_loaded
    }

    /// Returns the status for a browser. A page loads the scene after the results, and a scene that it asked for before is another.
    fn status(&self) -> Vec<u8> {
        let mut shown = self.lock();
        if shown.has_results && !shown.results_are_loaded {
            (shown.results_are_loaded, shown.is_loaded) = (true, false);
        }
        shown.status.clone()
    }

    /// Returns the time spent on encoding scenes since the last call.
    pub fn take_encoding(&self) -> Duration {
        std::mem::take(&mut self.lock().encoding)
    }

    /// Returns the file of the scene, which is encoded at the first request. The trainer does not wait meanwhile.
    fn scene(&self) -> Vec<u8> {
        let (step, rows) = {
            let mut shown = self.lock();
            (shown.scene_step, shown.rows.take())
        };
        if let Some(rows) = rows {
            let begin = Instant::now();
            // A scene of which nothing can be drawn leaves the one before.
            let scene = ShownScene::new(&rows, SCENE_BYTES);
            let mut shown = self.lock();
            shown.encoding += begin.elapsed();
            if let Ok(scene) = scene {
                shown.ply = scene.ply;
            }
        }
        let mut shown = self.lock();
        shown.is_loaded |= shown.scene_step == step;
        shown.ply.clone()
    }

    fn lock(&self) -> MutexGuard<'_, Shown> {
        locked(&self.shown)
    }
}

/// Locks a state. No code panics while it holds a lock.
pub fn locked<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Site for Shared {
    fn get(&self, path: &str) -> Option<(&'static str, Cow<'_, [u8]>)> {
        Some(match path {
            "/" => ("text/html; charset=utf-8", Cow::Borrowed(&self.page[..])),
            STATUS => {
                self.watch_for(LOOKS);
                ("application/json", Cow::Owned(self.status()))
            }
            SCENE => ("application/octet-stream", Cow::Owned(self.scene())),
            WORST => ("image/jpeg", Cow::Owned(self.lock().worst.clone())),
            _ => return None,
        })
    }

    fn act(&self, path: &str) -> bool {
        if path == STOP {
            self.watch_for(FAREWELL);
            self.stops.store(true, Ordering::Relaxed);
        }
        path == STOP
    }
}
