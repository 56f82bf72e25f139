//! The coarse scene of a whole capture, from which all its blocks start.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use splat_model::capture::Capture;
use splat_model::density::Focus;

use super::job;
use crate::lpips::LpipsArgs;
use crate::progress;
use crate::report::SCENE;
use crate::train::{self, TrainArgs};

/// Output folder of its run, beside the blocks.
pub const COARSE: &str = "coarse";

/// Photographs are not made smaller than this, px: the window of SSIM has eleven.
const SMALLEST_SIDE: u32 = 32;

/// Steps of the coarse scene where the blocks have `steps`.
pub fn steps_for(steps: usize) -> usize {
    steps / 2
}

/// The run of the coarse scene: photographs have half their size, and there are as many splats as a block with `splats` may have beyond its
/// region, so that it can start with all of them. `common` are the options of all blocks.
pub fn run_of(
    out: &Path,
    capture: &Capture,
    (training, common): (&TrainArgs, &[String]),
    (steps, splats): (usize, usize),
) -> Result<TrainArgs> {
    let longest = capture.views.iter().map(|view| view.intrinsics.width.max(view.intrinsics.height)).max();
    let longest = longest.and_then(|side| u32::try_from(side).ok()).unwrap_or(u32::MAX);
    let side = training.photos.max_side.unwrap_or(u32::MAX).min(longest);
    let mut run = job::training(&capture.folder, common)?;
    run.out = Some(out.join(COARSE));
    (run.steps, run.time) = (Some(steps), None);
    run.max_splats = ((Focus::BEYOND_SHARE * splats as f64) as usize).max(1);
    run.photos.test_every = training.photos.test_every;
    run.photos.max_side = Some((side / 2).max(SMALLEST_SIDE));
    (run.eval_during, run.export_every, run.lpips) = (Some(0), None, LpipsArgs::default());
    Ok(run)
}

/// Trains the coarse scene, and returns its path. On the CPU it is the same in each run.
///
/// # Errors
/// Those of [`train::run`].
pub fn train(run: &TrainArgs) -> Result<PathBuf> {
    let out = run.out.as_ref().context("the run of a coarse scene has a folder")?;
    progress::note(&format!("the coarse scene that all blocks start from: {}", out.display()));
    train::run(run)?;
    let scene = out.join(SCENE);
    scene.canonicalize().with_context(|| format!("cannot find {}", scene.display()))
}
