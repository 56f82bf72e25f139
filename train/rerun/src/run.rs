//! The files that `splat train --snapshots` writes to a run's folder. Their writer is `train/src/snapshots.rs`.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::Deserialize;
use serde::de::DeserializeOwned;

/// Largest accepted JSON file, bytes. A camera takes half a kilobyte, a point of a curve a tenth of one.
const MOST_BYTES: u64 = 256 << 20;

/// `run.json`.
#[derive(Debug, Deserialize)]
pub struct Run {
    /// Number of steps of the run.
    pub steps: usize,
    pub views: Vec<SnapshotView>,
}

/// Camera of a photograph: OpenCV axes, pixel centres at half-integers.
#[derive(Debug, Deserialize)]
pub struct SnapshotView {
    pub name: String,
    pub is_test: bool,
    pub width: usize,
    pub height: usize,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub cam_from_world: [[f64; 4]; 3],
}

/// `history.json`.
#[derive(Debug, Default, Deserialize)]
pub struct History {
    pub points: Vec<HistoryPoint>,
    pub scores: Vec<HistoryScore>,
}

#[derive(Debug, Deserialize)]
pub struct HistoryPoint {
    pub step: usize,
    /// Training time so far, s.
    pub seconds: f64,
    /// Training loss; `None` where it was not finite.
    pub loss: Option<f64>,
    pub splats: usize,
}

#[derive(Debug, Deserialize)]
pub struct HistoryScore {
    pub step: usize,
    pub seconds: f64,
    pub psnr: Option<f64>,
    pub ssim: Option<f64>,
    pub lpips: Option<f64>,
}

/// `snapshot.json`, with its folder.
#[derive(Debug, Deserialize)]
pub struct Snapshot {
    pub step: usize,
    pub views: Vec<SnapshotRender>,
    #[serde(skip)]
    pub folder: PathBuf,
}

#[derive(Debug, Deserialize)]
pub struct SnapshotRender {
    pub name: String,
    /// Name of a file beside `snapshot.json`: the render.
    pub picture: PathBuf,
}

impl Snapshot {
    pub fn scene(&self) -> PathBuf {
        self.folder.join("scene.ply")
    }

    /// Reads the render of a view.
    ///
    /// # Errors
    /// If it cannot be read, or lies outside the snapshot's folder.
    pub fn picture(&self, seen: &SnapshotRender) -> Result<Vec<u8>> {
        if seen.picture.file_name() != Some(seen.picture.as_os_str()) {
            bail!("{}: {:?} is not a file of the snapshot", self.folder.display(), seen.picture);
        }
        bytes(&self.folder.join(&seen.picture))
    }
}

/// The folder with the snapshots of a run.
pub struct Folder(PathBuf);

impl Folder {
    /// Returns the snapshot folder of the run whose output folder is `out`.
    pub fn of(out: &Path) -> Self {
        Self(out.join("snapshots"))
    }

    /// Reads `run.json`.
    ///
    /// # Errors
    /// If the file is missing or cannot be read.
    pub fn run(&self) -> Result<Run> {
        let remedy = "is this the output folder of a run of `splat train --snapshots`?";
        json(&self.0.join("run.json")).with_context(|| format!("{}: {remedy}", self.0.display()))
    }

    /// Reads the curves so far.
    ///
    /// # Errors
    /// If they cannot be read.
    pub fn history(&self) -> Result<History> {
        let path = self.0.join("history.json");
        if path.exists() { json(&path) } else { Ok(History::default()) }
    }

    /// Reads the snapshots after step `after`, or all of them, in the order of their steps.
    ///
    /// # Errors
    /// If one of them cannot be read.
    pub fn snapshots(&self, after: Option<usize>) -> Result<Vec<Snapshot>> {
        let entries = fs::read_dir(&self.0).with_context(|| format!("could not list {}", self.0.display()))?;
        let mut found = Vec::new();
        for folder in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            let file = folder.join("snapshot.json");
            // This file is written last: without it, the snapshot is incomplete or the folder holds none.
            if !file.exists() {
                continue;
            }
            let snapshot = Snapshot { folder, ..json(&file)? };
            if after.is_none_or(|after| snapshot.step > after) {
                found.push(snapshot);
            }
        }
        found.sort_by_key(|snapshot| snapshot.step);
        Ok(found)
    }
}

fn json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&bytes(path)?)
        .with_context(|| format!("{} is not what `splat train` writes", path.display()))
}

fn bytes(path: &Path) -> Result<Vec<u8>> {
    let shown = path.display();
    let size = fs::metadata(path).with_context(|| format!("could not read {shown}"))?.len();
    if size > MOST_BYTES {
        bail!("{shown} is {size} bytes long, expected at most {MOST_BYTES}");
    }
    fs::read(path).with_context(|| format!("could not read {shown}"))
}
