//! `--snapshots`: results of each evaluation during a run, in files for programs that show them, such as
//! `train/rerun/`.
//!
//! ```text
//! snapshots/run.json               all views and the number of steps, once
//! snapshots/history.json           the curves so far
//! snapshots/000500/snapshot.json   the evaluation after step 500: written last, so that all files it names exist
//! snapshots/000500/scene.ply       the scene's splats, or an even selection of them
//! snapshots/000500/0.png           the render of a test view
//! ```
//!
//! Frames are those of `docs/CONVENTIONS.md`. Positions are relative to the capture's `origin`, which `run.json` holds.

use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use glam::{DAffine3, DVec3};
use image::{ImageFormat, RgbImage};
use serde::{Deserialize, Serialize};
use splat_model::capture::{Capture, Photograph};
use splat_model::evaluate::{Comparison, Scores};
use splat_model::gaussians::{GaussianRows, values_of};
use splat_model::ply;

use crate::input::selected;
use crate::output::OutputFolder;
use crate::report::history::History;
use crate::report::pictures::level;

/// Folder of the snapshots, below a run's output folder.
pub const FOLDER: &str = "snapshots";

/// Largest number of splats in a snapshot: enough to recognize a scene, in 7 MB.
const MOST_SPLATS: usize = 100_000;

const RUN: &str = "run.json";
const HISTORY: &str = "history.json";
const SNAPSHOT: &str = "snapshot.json";
const SCENE: &str = "scene.ply";

/// Content of `run.json`.
#[derive(Clone, Debug, Serialize)]
pub struct Described {
    /// Number of steps of the run.
    steps: usize,
    /// Offset subtracted from the positions of the capture's files, scene units.
    origin: [f64; 3],
    views: Vec<SnapshotView>,
}

/// A photograph, at the size it is trained or tested on.
#[derive(Clone, Debug, Serialize)]
struct SnapshotView {
    name: String,
    is_test: bool,
    /// Camera model. Near the middle of their pictures, all models are close to a pinhole.
    model: String,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Rows of `cam_from_world`, OpenCV axes, before any refinement.
    cam_from_world: [[f64; 4]; 3],
}

impl Described {
    /// Describes a run on a capture's photographs.
    pub fn new(steps: usize, capture: &Capture, train: &[Photograph], test: &[Photograph]) -> Self {
        let view = |photo: &Photograph, is_test: bool| {
            let camera = photo.intrinsics;
            SnapshotView {
                name: photo.name.clone(),
                is_test,
                model: format!("{:?}", camera.model),
                width: camera.width,
                height: camera.height,
                fx: camera.fx,
                fy: camera.fy,
                cx: camera.cx,
                cy: camera.cy,
                cam_from_world: matrix_rows(&photo.cam_from_world),
            }
        };
        let train = train.iter().map(|photo| view(photo, false));
        let views = train.chain(test.iter().map(|photo| view(photo, true))).collect();
        Self { steps, origin: capture.origin.to_array(), views }
    }
}

/// Returns the rows of a transform, `[3, 4]`.
pub fn matrix_rows(pose: &DAffine3) -> [[f64; 4]; 3] {
    [0, 1, 2].map(|i| [pose.x_axis[i], pose.y_axis[i], pose.z_axis[i], pose.translation[i]])
}

/// Content of `snapshot.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Snapshot {
    /// Number of steps done.
    step: usize,
    /// Number of splats in the scene; `shown` is the number in the file.
    splats: usize,
    shown: usize,
    views: Vec<SnapshotRender>,
}

/// A test view, as rendered from the scene.
#[derive(Debug, Serialize, Deserialize)]
struct SnapshotRender {
    name: String,
    /// Name of a file beside this one: the render.
    picture: PathBuf,
    psnr: f64,
    ssim: f64,
    lpips: Option<f64>,
}

/// The snapshots of a run.
#[derive(Debug)]
pub struct Snapshots<'a> {
    out: &'a OutputFolder,
}

impl<'a> Snapshots<'a> {
    /// Opens the snapshots of a run that begins or resumes. If it begins, the snapshots of an earlier run are removed.
    ///
    /// # Errors
    /// If the description of the run cannot be written.
    pub fn open(out: &'a OutputFolder, run: &Described, begins: bool) -> Result<Self> {
        if begins {
            remove_all(&out.join(FOLDER));
        }
        out.write(Path::new(FOLDER).join(RUN), |file| Ok(serde_json::to_writer(file, run)?))?;
        Ok(Self { out })
    }

    /// Writes the curves so far.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn keep_history(&self, history: &History) -> Result<()> {
        self.out.write(Path::new(FOLDER).join(HISTORY), |file| Ok(serde_json::to_writer(file, history)?))
    }

    /// Begins the snapshot after a step.
    pub fn after(&self, step: usize) -> Taken<'a> {
        Taken {
            out: self.out,
            folder: Path::new(FOLDER).join(format!("{step:06}")),
            step,
            pictures: RefCell::default(),
        }
    }
}

/// A snapshot in progress.
#[derive(Debug)]
pub struct Taken<'a> {
    out: &'a OutputFolder,
    folder: PathBuf,
    step: usize,
    pictures: RefCell<Vec<Result<PathBuf>>>,
}

impl Taken<'_> {
    /// Writes the render of the next view.
    pub fn look(&self, comparison: &Comparison) {
        let mut pictures = self.pictures.borrow_mut();
        let name = PathBuf::from(format!("{}.png", pictures.len()));
        let [height, width, _] = comparison.image.dims();
        let bytes = values_of(comparison.image.clone()).into_iter().map(level).collect();
        let write = || {
            let picture =
                RgbImage::from_raw(width as u32, height as u32, bytes).context("three values for each pixel")?;
            self.out.write(self.folder.join(&name), |file| Ok(picture.write_to(file, ImageFormat::Png)?))?;
            Ok(name.clone())
        };
        pictures.push(write());
    }

    /// Writes the scene, then the description with the scores of the views.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn keep(self, rows: &GaussianRows, scores: &Scores) -> Result<()> {
        let Self { out, folder, step, pictures } = self;
        let shown = some_of(rows);
        fs::create_dir_all(out.join(&folder))?;
        ply::write(&out.join(folder.join(SCENE)), &shown, DVec3::ZERO)?;
        let views = scores.views.iter().zip(pictures.into_inner()).map(|(view, picture)| {
            let (name, picture) = (view.name.clone(), picture?);
            Ok(SnapshotRender { name, picture, psnr: view.psnr, ssim: view.ssim, lpips: view.lpips })
        });
        let views = views.collect::<Result<_>>()?;
        let snapshot = Snapshot { step, splats: rows.len(), shown: shown.len(), views };
        out.write(folder.join(SNAPSHOT), |file| Ok(serde_json::to_writer(file, &snapshot)?))
    }
}

/// Returns an even selection of the rows, in which neighbours are adjacent, limited to splats that can be drawn, with
/// one colour each.
fn some_of(rows: &GaussianRows) -> GaussianRows {
    let every = rows.len().div_ceil(MOST_SPLATS).max(1);
    selected(rows, (0..rows.len()).step_by(every).filter(|&i| rows.is_usable(i)), 0)
}

/// Removes the snapshots in a folder: the files that they name, then their folders if empty. All other files stay.
fn remove_all(folder: &Path) {
    let found = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    for folder in found.filter(|path| path.is_dir()) {
        let read = || serde_json::from_slice::<Snapshot>(&fs::read(folder.join(SNAPSHOT)).ok()?).ok();
        let Some(Snapshot { views, .. }) = read() else { continue };
        let pictures = views.into_iter().map(|seen| seen.picture).filter(|picture| is_a_name(picture));
        for name in pictures.chain([SCENE, SNAPSHOT].map(PathBuf::from)) {
            // They may have been removed by hand.
            let _ = fs::remove_file(folder.join(name));
        }
        let _ = fs::remove_dir(folder);
    }
}

/// Whether a path is the name of a file in the same folder: a path read from a file may lead anywhere.
fn is_a_name(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == path.as_os_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(count: usize) -> GaussianRows {
        GaussianRows {
            means: (0..count).map(|i| [i as f32, 0.0, 0.0]).collect(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            log_scales: vec![[-2.0; 3]; count],
            logit_opacities: vec![2.0; count],
            sh_dc: vec![[0.5; 3]; count],
            sh_rest: vec![0.1; count * 9],
            sh_degree: 1,
        }
    }

    #[test]
    fn a_snapshot_holds_some_splats_of_all_over_the_scene() {
        let mut many = rows(2 * MOST_SPLATS + 10);
        many.means[6] = [f32::NAN; 3];
        let some = some_of(&many);
        assert!(some.len() <= MOST_SPLATS && some.len() > MOST_SPLATS / 2, "{}", some.len());
        assert_eq!(some.means[..3], [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [9.0, 0.0, 0.0]]);
        assert!(some.means[some.len() - 1][0] > 2.0 * MOST_SPLATS as f32);
        some.check().unwrap();
        assert_eq!((some_of(&rows(7)).len(), some_of(&rows(0)).len()), (7, 0));
    }

    #[test]
    fn what_snapshots_name_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, theirs) = (folder.path().join("all/000010"), folder.path().join("all/mine"));
        fs::create_dir_all(&ours).unwrap();
        fs::create_dir_all(&theirs).unwrap();
        let seen = |picture: &str| SnapshotRender {
            name: "a".into(),
            picture: picture.into(),
            psnr: 1.0,
            ssim: 0.0,
            lpips: None,
        };
        let views = vec![seen("0.png"), seen("../../outside.png"), seen("..")];
        let snapshot = Snapshot { step: 10, splats: 1, shown: 1, views };
        fs::write(ours.join(SNAPSHOT), serde_json::to_string(&snapshot).unwrap()).unwrap();
        for kept in [folder.path().join("outside.png"), theirs.join(SCENE), folder.path().join("all/notes")] {
            fs::write(kept, "kept").unwrap();
        }
        fs::write(ours.join("0.png"), "").unwrap();
        fs::write(ours.join(SCENE), "").unwrap();
        remove_all(&folder.path().join("all"));
        assert!(!ours.exists() && theirs.join(SCENE).exists());
        assert!(folder.path().join("outside.png").exists() && folder.path().join("all/notes").exists());
    }
}
