//! A run as Rerun entities, on the timelines `step` and `training` (training time so far).
//!
//! | entity | holds |
//! |---|---|
//! | `world/cameras/train/NAME`, `world/cameras/test/NAME` | pinhole and pose of a photograph, for all times |
//! | `world/cameras/test/NAME/render` | render of the scene from that camera |
//! | `world/splats` | splats as points: colour and opacity, and the geometric mean of the standard deviations as radius |
//! | `curves/loss`, `curves/splats` | training loss, number of splats |
//! | `test/psnr`, `test/ssim`, `test/lpips` | means over the held-out views that are evaluated during the run |

use anyhow::{Context, Result};
use re_sdk::{EntityPath, EntityPathPart, RecordingStream};
use re_sdk_types::archetypes::{EncodedImage, Pinhole, Points3D, Scalars, Transform3D};
use re_sdk_types::components::{TransformRelation, ViewCoordinates};

use crate::run::{Folder, Run, Snapshot, SnapshotView};

/// Distance from a camera to its image plane, as a fraction of the distance between cameras.
const FRUSTUM: f64 = 0.2;

/// The part of a run that is shown already.
#[derive(Debug, Default)]
pub struct Shown {
    points: usize,
    scores: usize,
    /// Step of the last snapshot.
    snapshot: Option<usize>,
}

impl Shown {
    /// Logs the cameras, which do not change.
    ///
    /// # Errors
    /// If they cannot be logged.
    pub fn begin(recording: &RecordingStream, run: &Run) -> Result<Self> {
        let distance = FRUSTUM * spacing(&run.views);
        for view in &run.views {
            let path = camera(view.is_test, &view.name);
            recording.log_static(path.clone(), &pose(view))?;
            recording.log_static(path, &pinhole(view, distance as f32))?;
        }
        Ok(Self::default())
    }

    /// Logs whatever is new in the folder and returns the last step found there.
    ///
    /// # Errors
    /// If a file cannot be read, or was not written by `splat train`.
    pub fn update(&mut self, recording: &RecordingStream, folder: &Folder) -> Result<usize> {
        let history = folder.history()?;
        for point in history.points.iter().skip(self.points) {
            at(recording, point.step, Some(point.seconds));
            scalar(recording, "curves/loss", point.loss)?;
            scalar(recording, "curves/splats", Some(point.splats as f64))?;
        }
        for score in history.scores.iter().skip(self.scores) {
            at(recording, score.step, Some(score.seconds));
            for (name, value) in [("psnr", score.psnr), ("ssim", score.ssim), ("lpips", score.lpips)] {
                scalar(recording, &format!("test/{name}"), value)?;
            }
        }
        (self.points, self.scores) = (history.points.len(), history.scores.len());
        for taken in folder.snapshots(self.snapshot)? {
            let seconds = history.scores.iter().find(|score| score.step == taken.step).map(|score| score.seconds);
            at(recording, taken.step, seconds);
            snapshot(recording, &taken)?;
            self.snapshot = Some(taken.step);
        }
        Ok(history.points.last().map_or(0, |point| point.step))
    }
}

/// Sets the time of all data logged from now on.
fn at(recording: &RecordingStream, step: usize, seconds: Option<f64>) {
    recording.reset_time();
    recording.set_time_sequence("step", step as i64);
    if let Some(seconds) = seconds {
        recording.set_duration_secs("training", seconds);
    }
}

/// Logs a value. An absent value logs nothing, because a missing measurement is not zero.
fn scalar(recording: &RecordingStream, path: &str, value: Option<f64>) -> Result<()> {
    if let Some(value) = value {
        recording.log(path, &Scalars::new([value]))?;
    }
    Ok(())
}

fn snapshot(recording: &RecordingStream, taken: &Snapshot) -> Result<()> {
    let scene = taken.scene();
    let points = Points3D::from_file_path(&scene).with_context(|| format!("could not read {}", scene.display()))?;
    recording.log("world/splats", &points)?;
    for seen in &taken.views {
        let path = camera(true, &seen.name).join(&EntityPath::from("render"));
        recording.log(path, &EncodedImage::from_file_contents(taken.picture(seen)?))?;
    }
    Ok(())
}

/// A camera's entity path. A name is a single part of the path, whatever characters it holds.
fn camera(is_test: bool, name: &str) -> EntityPath {
    let parts = ["world", "cameras", if is_test { "test" } else { "train" }, name];
    EntityPath::new(parts.map(EntityPathPart::new).to_vec())
}

fn pose(view: &SnapshotView) -> Transform3D {
    let rows = view.cam_from_world;
    let column = |i: usize| [rows[0][i] as f32, rows[1][i] as f32, rows[2][i] as f32];
    // Rerun's matrices are column-major, and its default relation is parent from child, the inverse of
    // `cam_from_world`.
    Transform3D::from_translation_mat3x3(column(3), [column(0), column(1), column(2)])
        .with_relation(TransformRelation::ChildFromParent)
}

/// The pinhole of a view. Rerun's pixel coordinates begin at the corner of the first pixel, as ours do.
fn pinhole(view: &SnapshotView, distance: f32) -> Pinhole {
    let number = |value: f64| value as f32;
    Pinhole::new([[number(view.fx), 0.0, 0.0], [0.0, number(view.fy), 0.0], [number(view.cx), number(view.cy), 1.0]])
        .with_resolution([view.width as f32, view.height as f32])
        .with_camera_xyz(ViewCoordinates::RDF)
        .with_image_plane_distance(distance)
}

/// Approximate distance between neighbouring cameras: the edge of the cube around all of them, divided by the square
/// root of their number.
fn spacing(views: &[SnapshotView]) -> f64 {
    let centre = |view: &SnapshotView| {
        let rows = view.cam_from_world;
        [0, 1, 2].map(|i| -(0..3).map(|row| rows[row][i] * rows[row][3]).sum::<f64>())
    };
    let centres: Vec<[f64; 3]> = views.iter().map(centre).collect();
    let extent = |axis: usize| {
        let along = || centres.iter().map(|centre| centre[axis]);
        along().fold(f64::MIN, f64::max) - along().fold(f64::MAX, f64::min)
    };
    let edge = [0, 1, 2].map(extent).into_iter().fold(0.0, f64::max);
    let spacing = edge / (views.len() as f64).sqrt();
    if spacing.is_finite() && spacing > 0.0 { spacing } else { 1.0 }
}
