//! Results of a run: the scene, everything learned with it, its scores and its report.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::{Result, anyhow};
use glam::DAffine3;
use serde::Serialize;
use splat_model::FileError;
use splat_model::capture::{Capture, Photograph};
use splat_model::effects::background::{Backdrop, Background};
use splat_model::gaussians::Gaussians;
use splat_model::ply::{self, TrainedAs, WorldFrame};
use splat_model::trainer::{TrainConfig, TrainError, Trainer};
use splat_op::Projection;

use super::checkpoints::Checkpoints;
use super::setup::Setup;
use crate::background::BACKGROUND;
use crate::input::PhotoArgs;
use crate::live::Live;
use crate::lpips::LpipsArgs;
use crate::output::OutputFolder;
use crate::progress;
use crate::report::{
    self, History, LogLine, METRICS, Metrics, POSES, ReportPage, SCENE, SCENE_BYTES, Seconds, metrics, peak_rss_mib,
    seconds_since,
};
use crate::view::{SceneSource, ShownScene, Viewer, Viewpoint};

/// Result of the steps, when all are done.
pub struct Done<'a> {
    /// Training time of all parts of the run, s.
    pub seconds: f64,
    /// Time of the scores during this part of the run, s.
    pub scoring_s: f64,
    pub history: History,
    pub checkpoints: Checkpoints,
    pub live: Option<Live<'a>>,
    /// The step at which the view's button ended the run before its last step. The checkpoint of that step is kept.
    pub stopped_at: Option<usize>,
}

/// The `options` of `metrics.json`.
#[derive(Serialize)]
struct TrainOptionsRecord<'a> {
    capture: &'a Path,
    #[serde(flatten)]
    photos: &'a PhotoArgs,
    #[serde(flatten)]
    config: &'a TrainConfig,
    start: Option<&'a Path>,
    #[serde(flatten)]
    lpips: &'a LpipsArgs,
}

/// Writes the scene, scores it, writes the report, and prints the location of all files. `load_s` is the time that reading took.
pub fn write(setup: &Setup, trainer: Trainer, test: &[Photograph], load_s: f64, done: Done) -> Result<Metrics> {
    let Setup { job, out, lpips, .. } = setup;
    // Schedules may have changed since the start.
    let config = trainer.config().clone();
    let (background, render_options) = (trainer.background(), trainer.render_options());
    // Before measuring, so that a failure there does not lose the scene.
    let unusable = write_scene(&trainer, &job.capture, &out.join(SCENE))?;
    write_learnt(&trainer, &config, &job.capture, out)?;
    progress::note_unusable(&out.join(SCENE), unusable, trainer.gaussians().len());
    let gaussians = match config.smoothing {
        true => Gaussians::from_rows(&trainer.rows(), &job.device)?,
        false => trainer.gaussians().untracked(),
    };
    // The page and the scores need the memory of photographs and moments, which are no longer used.
    drop(trainer);
    let rows = gaussians.to_rows();
    let scene = ShownScene::new(&rows, SCENE_BYTES).ok();
    let last = done.live.map(|live| (live, rows));

    let start = Instant::now();
    let measure = || report::measure(&gaussians.splats(), test, &background, &render_options, lpips.as_ref(), out);
    let scores = if test.is_empty() { None } else { Some(measure()?) };
    let seconds =
        Seconds { load: load_s, train: Some(done.seconds), scores: Some(done.scoring_s), eval: seconds_since(start) };
    let options = TrainOptionsRecord {
        capture: &job.capture.folder,
        photos: &setup.photos,
        config: &config,
        start: job.args.start.as_deref(),
        lpips: &job.args.lpips,
    };
    let metrics = Metrics {
        test: scores,
        splats: gaussians.len(),
        culled_non_finite: unusable,
        steps: Some(config.steps),
        seconds,
        peak_rss_mib: peak_rss_mib(),
        device: setup.device_name.clone(),
        effects: Some(job.effects.clone()),
        seed: Some(config.seed),
        options: serde_json::to_value(options)?,
        version: env!("CARGO_PKG_VERSION"),
    };
    report::finish(&metrics, out)?;
    let viewpoints = Viewpoint::all(test);
    let viewer = scene.as_ref().map(|scene| Viewer {
        scene,
        source: SceneSource::Page,
        viewpoints: &viewpoints,
        background: background.colour(),
        antialias: config.antialias,
    });
    ReportPage { metrics: &metrics, history: &done.history, viewer }.write(out)?;
    match done.stopped_at {
        None => done.checkpoints.finish(),
        Some(step) => progress::note(&format!(
            "stopped in the browser after step {step}; `splat resume {}` continues from there",
            out.path().display()
        )),
    }
    if let Some((live, rows)) = last {
        live.finish(rows, &metrics, &done.history);
    }
    report::say(&metrics, &out.join(SCENE), out);
    progress::line(&LogLine::Done { out: out.path().display().to_string(), metrics: &metrics });
    Ok(metrics)
}

/// Writes the trained scene. Returns the number of its Gaussians that cannot be rendered.
fn write_scene(trainer: &Trainer, capture: &Capture, path: &Path) -> Result<usize, FileError> {
    let (count, sh_degree) = (trainer.gaussians().len(), trainer.gaussians().sh_degree());
    let mut unusable = 0;
    let parts = trainer.parts_of_rows().inspect(|part| unusable += part.unusable());
    let config = trainer.config();
    let trained = TrainedAs {
        antialias: config.antialias,
        ray_max: trainer.render_options().projection == Projection::RayMax,
        background: trainer.background().colour(),
        environment: matches!(config.backdrop, Backdrop::Environment { .. }),
    };
    ply::write_parts(path, count, sh_degree, parts, WorldFrame { trained, ..capture.world_frame() })?;
    Ok(unusable)
}

/// Writes the scene after a step beside the final one. A failure does not end the run: a disk that is full now may have room later.
pub fn export(trainer: &Trainer, capture: &Capture, out: &OutputFolder) {
    let name = format!("scene-{:06}.ply", trainer.steps_done());
    let written = out.spared(&name).and_then(|path| Ok(write_scene(trainer, capture, &path)?));
    if let Err(error) = written {
        progress::note(&format!("{name} was not written: {error:#}"));
    }
}

/// Writes what was learned beside the scene, and removes such files of an earlier run: those that hold what this function writes, where
/// that run left its scores.
fn write_learnt(trainer: &Trainer, config: &TrainConfig, capture: &Capture, out: &OutputFolder) -> Result<()> {
    let is_learnt = matches!(config.backdrop, Backdrop::Learned | Backdrop::Environment { .. });
    let background = is_learnt.then(|| trainer.background().to_json()).transpose()?;
    let poses = trainer.refined_poses().map(|poses| poses_json(&poses, capture)).transpose()?;
    let is_ours: [fn(&Path) -> bool; 2] = [|path| Background::read(path).is_ok(), |path| read_poses(path).is_some()];
    for (name, text, is_ours) in [(BACKGROUND, background, is_ours[0]), (POSES, poses, is_ours[1])] {
        match text {
            Some(text) => out.write(name, |file| Ok(file.write_all(text.as_bytes())?))?,
            None if metrics::is_in(&out.join(METRICS)) && is_ours(&out.join(name)) => {
                // A leftover file does no harm.
                _ = fs::remove_file(out.join(name));
            }
            None => {}
        }
    }
    Ok(())
}

/// Reads the file of [`poses_json`]; `None` for any other.
fn read_poses(path: &Path) -> Option<BTreeMap<String, [[f64; 4]; 3]>> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

/// Returns the poses by photograph, as JSON: the rows of `cam_from_world`, `[3, 4]`, OpenCV axes, in the world frame of the capture's file.
fn poses_json(poses: &[(String, DAffine3)], capture: &Capture) -> serde_json::Result<String> {
    let local_from_world = DAffine3::from_translation(-capture.origin);
    let rows = |pose: &DAffine3| {
        let pose = *pose * local_from_world;
        [0, 1, 2].map(|i| [pose.x_axis[i], pose.y_axis[i], pose.z_axis[i], pose.translation[i]])
    };
    let by_name: BTreeMap<&str, [[f64; 4]; 3]> = poses.iter().map(|(name, pose)| (name.as_str(), rows(pose))).collect();
    serde_json::to_string_pretty(&by_name)
}

/// Saves the scene of a failed run, as it was before the failing step. Returns the error to show to the user.
pub fn keep_scene(error: TrainError, trainer: &Trainer, capture: &Capture, out: &OutputFolder) -> anyhow::Error {
    if !error.keeps_scene() {
        return error.into();
    }
    let path = out.join(SCENE);
    let kept = match write_scene(trainer, capture, &path) {
        Ok(_) => format!("{} is the scene before that step", path.display()),
        Err(reason) => format!("the scene before that step could not be saved: {reason}"),
    };
    anyhow!("{error}. {kept}")
}
