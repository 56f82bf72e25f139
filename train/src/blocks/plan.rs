//! `splat blocks plan`: cuts a capture into blocks.

use std::io::Write;
use std::path::{Component, Path, PathBuf};
use std::{env, fs};

use anyhow::{Context, Result, ensure};
use clap::builder::RangedU64ValueParser;
use splat_model::capture::Capture;
use splat_model::capture::blocks::{self, Block, BlockFile, BlockOptions};
use splat_model::density::Focus;
use splat_model::effects::EffectKind;

use super::job;
use super::planned::{BlockPlan, JOBS, PLAN, PlanFolder};
use crate::lpips::LpipsArgs;
use crate::progress::{self, VoiceArgs};
use crate::report::SCENE;
use crate::train::config::{self, CONFIG};
use crate::train::{self, TrainArgs};
use crate::{input, output};

/// The splats that a block may have, relative to its share of the scene's: some of them lie in its margin or beyond, and are not kept.
const ALLOWANCE: f64 = 1.3;

/// Output folder of the coarse scene, beside the blocks.
const COARSE: &str = "coarse";

/// Photographs of the coarse scene are not made smaller than this, px: the window of SSIM has eleven.
const SMALLEST_SIDE: u32 = 32;

/// Options of `splat blocks plan`.
#[derive(Clone, Debug, clap::Args)]
pub struct PlanArgs {
    /// Capture folder
    pub capture: PathBuf,
    /// Folder for the plan and its blocks
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Number of blocks
    #[arg(long, value_name = "N", required_unless_present = "splats_per_block", conflicts_with = "splats_per_block",
        value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub blocks: Option<usize>,
    /// Splats that a block may have, which decide its memory; there are as many blocks as `--max-splats` after `--`, the
    /// splats of the whole scene, asks for
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub splats_per_block: Option<usize>,
    /// Width of the margin around a block in which it trains with all detail, as a share of the block's size
    #[arg(long, value_name = "SHARE", default_value_t = BlockOptions::default().margin, value_parser = train::share)]
    pub margin: f64,
    /// Give a block the photographs that see at least this share of its points, or at least this share of whose points lie in it
    #[arg(long, value_name = "SHARE", default_value_t = BlockOptions::default().min_share, value_parser = train::share)]
    pub min_share: f64,
    /// Steps of the coarse scene of the whole capture, which the plan trains and all blocks start from; 0: blocks start from their points
    /// alone [default: half of the blocks' steps]
    #[arg(long, value_name = "N")]
    pub coarse_steps: Option<usize>,
    /// After `--`: options of `splat train` for all blocks. `--max-splats` is for the whole scene; `--effects auto` is decided on
    /// the whole capture
    #[arg(last = true, value_name = "OPTION")]
    pub options: Vec<String>,
}

/// Trains the coarse scene, writes the plan and prints its blocks. An error if the capture cannot be read or cut, an
/// option is refused, or the folder holds a plan already.
pub fn plan(args: &PlanArgs) -> Result<()> {
    let training = job::training(&args.capture, &args.options)?;
    // What the plan prints is no log of a run.
    VoiceArgs { json: false, ..training.voice }.apply();
    let steps = training.config()?.steps;
    let capture = input::capture(&args.capture)?;
    ensure!(
        capture.focus.is_none(),
        "{} is a block already: plan the capture that it is a part of",
        args.capture.display()
    );
    let (split, _) = training.photos.split(&capture);
    split.require_train()?;
    let (count, splats) = counts(args, training.max_splats);
    let options = BlockOptions { blocks: count, margin: args.margin, min_share: args.min_share };
    let planned = blocks::plan(&capture, &split, &options)
        .with_context(|| format!("cannot cut {} into blocks", args.capture.display()))?;
    let common = common_options(args, &training, &capture, splats)?;

    let width = (count - 1).max(1).ilog10() as usize + 1;
    let names: Vec<String> = (0..count).map(|block| format!("block-{block:0width$}")).collect();
    let folder = prepare(&args.out, &names)?;
    let coarse_steps = if count == 1 { 0 } else { args.coarse_steps.unwrap_or(steps / 2) };
    let start = match coarse_steps {
        0 => None,
        steps => {
            let run = TrainArgs { steps: Some(steps), ..job::training(&capture.folder, &common)? };
            Some(coarse(run, &folder, &capture, &training, splats)?)
        }
    };
    let program = env::current_exe().context("cannot tell the path of this program")?;
    let mut lines = Vec::with_capacity(count);
    for (name, block) in names.iter().zip(&planned) {
        let path = folder.join(name);
        fs::create_dir_all(&path).with_context(|| format!("cannot make {}", path.display()))?;
        BlockFile::of(&capture, path_from(&path, &args.capture)?, block).write(&path)?;
    }
    let plan = BlockPlan { version: env!("CARGO_PKG_VERSION").into(), blocks: names.clone(), options: common };
    let planned_folder = PlanFolder { path: folder.clone(), plan };
    for (name, block) in names.iter().zip(&planned) {
        let (path, run) = (folder.join(name), planned_folder.run(name));
        let mut options = TrainArgs { start: start.clone(), ..job::training(&path, &planned_folder.plan.options)? };
        options.lpips.lpips = options.lpips.lpips.map(std::path::absolute).transpose()?;
        if block.test.is_empty() {
            options.photos.test_every = Some(0);
        }
        let text = config::to_toml(&options)?;
        output::write(&run.join(CONFIG), |file| Ok(file.write_all(text.as_bytes())?))?;
        lines.push(job::line(&[job::utf8(&program)?, "resume", job::utf8(&run)?])?);
    }
    planned_folder.write(&lines)?;
    say(&names, &planned);
    progress::say(&format!("each block may have {splats} splats"));
    progress::say(&format!("jobs: {}", folder.join(JOBS).display()));
    Ok(())
}

/// Trains the coarse scene of the whole capture, from which all blocks start, and returns its path. Photographs have half their size, and
/// there are as many splats as a block with `splats` may have beyond its region, so that it can start with all of them. On the CPU the scene is
/// the same in each run.
fn coarse(
    mut run: TrainArgs,
    folder: &Path,
    capture: &Capture,
    training: &TrainArgs,
    splats: usize,
) -> Result<PathBuf> {
    let longest = capture.views.iter().map(|view| view.intrinsics.width.max(view.intrinsics.height)).max();
    let longest = longest.and_then(|side| u32::try_from(side).ok()).unwrap_or(u32::MAX);
    let side = training.photos.max_side.unwrap_or(u32::MAX).min(longest);
    let out = folder.join(COARSE);
    (run.out, run.time) = (Some(out.clone()), None);
    run.max_splats = ((Focus::BEYOND_SHARE * splats as f64) as usize).max(1);
    run.photos.test_every = training.photos.test_every;
    run.photos.max_side = Some((side / 2).max(SMALLEST_SIDE));
    (run.eval_during, run.export_every, run.lpips) = (Some(0), None, LpipsArgs::default());
    progress::note(&format!("the coarse scene that all blocks start from: {}", out.display()));
    train::run(&run)?;
    let scene = out.join(SCENE);
    scene.canonicalize().with_context(|| format!("cannot find {}", scene.display()))
}

/// Number of blocks, and of splats that each may have.
fn counts(args: &PlanArgs, total: usize) -> (usize, usize) {
    let allowed = ALLOWANCE * total as f64;
    match (args.blocks, args.splats_per_block) {
        (_, Some(most)) if most < total => ((allowed / most as f64).ceil() as usize, most),
        (None | Some(1), _) => (1, total),
        (Some(blocks), _) => (blocks, (allowed / blocks as f64).ceil() as usize),
    }
}

/// The options that all lines share. What depends on the capture is decided now, on the whole of it, so that all blocks agree.
fn common_options(args: &PlanArgs, training: &TrainArgs, capture: &Capture, splats: usize) -> Result<Vec<String>> {
    let (split, _) = training.photos.split(capture);
    let antialias = training.model.antialias.unwrap_or_default();
    let chosen = training.effects.choose(capture, &split.train, antialias)?;
    let apart = [EffectKind::Environment, EffectKind::PoseRefinement];
    for effect in apart.iter().filter(|effect| chosen.has(**effect)) {
        progress::note(&format!(
            "without `{}`: each block would find its own, and a merged scene has one",
            effect.name()
        ));
    }
    let mut config = training.config()?;
    chosen.configure(&mut config, training.background, training.sh_degree);
    let names: Vec<&str> =
        chosen.on.iter().filter(|effect| !apart.contains(effect)).map(|effect| effect.name()).collect();
    let effects = if names.is_empty() { "none".into() } else { names.join(",") };
    let mut common = vec![
        format!("--max-splats={splats}"),
        format!("--effects={effects}"),
        format!("--sh-degree={}", config.sh_degree),
    ];
    common.extend(job::without(&args.options, &job::REPLACED));
    Ok(common)
}

/// Makes the folder, which must not hold a plan.
fn prepare(out: &Path, names: &[String]) -> Result<PathBuf> {
    fs::create_dir_all(out).with_context(|| format!("cannot make {}: choose another `--out`", out.display()))?;
    let taken = [PLAN, JOBS].into_iter().chain(names.iter().map(String::as_str));
    if let Some(taken) = taken.map(|name| out.join(name)).find(|path| path.exists()) {
        anyhow::bail!(
            "{} already exists: a new plan would lose what was trained by the old one; choose another `--out`, or remove it",
            taken.display()
        );
    }
    out.canonicalize().with_context(|| format!("cannot find {}", out.display()))
}

/// The path that leads from a folder to another: relative where both lie below one folder that is not the root, so that they can be moved together; otherwise absolute.
fn path_from(folder: &Path, to: &Path) -> Result<PathBuf> {
    let canonical = |path: &Path| path.canonicalize().with_context(|| format!("cannot find {}", path.display()));
    let (from, to) = (canonical(folder)?, canonical(to)?);
    let same = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    if !from.components().take(same).any(|part| matches!(part, Component::Normal(_))) {
        return Ok(to);
    }
    let up = from.components().skip(same).map(|_| Component::ParentDir);
    Ok(up.chain(to.components().skip(same)).collect())
}

fn say(names: &[String], planned: &[Block]) {
    progress::say(&format!("{:<12}{:>12}{:>10}{:>10}{:>10}", "block", "photographs", "held out", "points", "in cell"));
    for (name, block) in names.iter().zip(planned) {
        let (train, test, points) = (block.train.len(), block.test.len(), block.points.len());
        progress::say(&format!("{name:<12}{train:>12}{test:>10}{points:>10}{:>10}", block.points_in_cell));
    }
}

#[cfg(test)]
mod tests;
