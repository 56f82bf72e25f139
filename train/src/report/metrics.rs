//! `metrics.json`.

use std::path::Path;
use std::time::Instant;

use serde::Serialize;
use serde_json::Value;
use splat_model::evaluate::Scores;

use crate::effects::ChosenEffects;

/// Results of a run and its options. Keys are added over time, and never renamed.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Metrics {
    /// Scores on the held-out photographs; null if there are none.
    pub test: Option<Scores>,
    /// Number of Gaussians in the scene.
    pub splats: usize,
    /// Number of Gaussians that are never drawn: a parameter is not finite or out of the range of f32 arithmetic, or
    /// the rotation is zero (see `splat_op::activate`).
    pub culled_non_finite: usize,
    /// Number of training steps; null without training.
    pub steps: Option<usize>,
    /// Wall-clock times.
    pub seconds: Seconds,
    /// Peak memory of the process, MiB; null where the system does not report it.
    pub peak_rss_mib: Option<f64>,
    /// Device: a CPU backend, or an adapter and its runtime.
    pub device: String,
    /// Simulated effects, the reasons for them, and their cost; null without training.
    pub effects: Option<ChosenEffects>,
    /// Seed of everything random; null where nothing was random.
    pub seed: Option<u64>,
    /// All options, including defaults.
    pub options: Value,
    /// Version of the program.
    pub version: &'static str,
}

/// Wall-clock times, s.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Seconds {
    /// Reading and decoding.
    pub load: f64,
    /// The training steps alone; null without training.
    pub train: Option<f64>,
    /// The scores during training, since the run began or was resumed; null without training.
    pub scores: Option<f64>,
    /// The test views, including their pictures.
    pub eval: f64,
}

pub fn seconds_since(start: Instant) -> f64 {
    (start.elapsed().as_secs_f64() * 1e3).round() / 1e3
}

/// Largest resident set of this process so far, MiB to a tenth. Known on Linux only.
pub fn peak_rss_mib() -> Option<f64> {
    peak_of(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// Reads the field `VmHWM` ("high water mark", KiB) of proc(5)'s status.
fn peak_of(status: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some((kib / 1024.0 * 10.0).round() / 10.0)
}

/// Reads a `metrics.json`; null if the file is missing or no JSON.
pub fn read(path: &Path) -> Value {
    let read = || serde_json::from_slice::<Value>(&std::fs::read(path).ok()?).ok();
    read().unwrap_or_default()
}

/// Whether a run of this program wrote a file.
pub fn is_in(path: &Path) -> bool {
    let metrics = read(path);
    ["test", "culled_non_finite", "options", "version"].iter().all(|key| metrics.get(key).is_some())
}

#[cfg(test)]
mod tests;
