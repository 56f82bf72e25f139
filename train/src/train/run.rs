//! A run, from its options or its last checkpoint to its results.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use splat_model::capture::{Capture, Photograph};
use splat_model::density::Focus;
use splat_model::effects::EffectKind;
use splat_model::gaussians::Gaussians;
use splat_model::trainer::ranks::{Alone, Ranks};
use splat_model::trainer::{TrainConfig, Trainer};

use super::budget::{self, MemoryEstimate};
use super::checkpoints::{self, Checkpoints, RunState, SavedRun, SoFar};
use super::config::{self, CONFIG};
use super::folders::{inputs_of, open, prepare};
use super::results::{write_learnt, write_scene};
use super::start::{is_random, start_points, started};
use super::steps::{Done, Steps};
use super::{ResumeArgs, TrainArgs};
use crate::effects::Chosen;
use crate::input::PhotoSelection;
use crate::inputs::Inputs;
use crate::live::Live;
use crate::lpips::LpipsArgs;
use crate::options::PhotoArgs;
use crate::progress;
use crate::ranks::{self, RunSetup};
use crate::reconstruct;
use crate::report::log::LogLine;
use crate::report::metrics::{Metrics, Seconds, peak_rss_mib, seconds_since};
use crate::report::page::{self, ReportPage};
use crate::report::{self, SCENE};
use crate::view::scene::{ShownScene, Viewpoint};

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

/// Trains, measures, writes all files, and prints their location.
///
/// # Errors
/// If the capture cannot be read, the results cannot be written, or an option is out of range; or if a loss or a
/// gradient is not finite: `scene.ply` is the scene before that step then. [`Interrupted`](super::Interrupted) if
/// Ctrl-C or SIGTERM ended it.
pub fn run(args: &TrainArgs) -> Result<Metrics> {
    run_with(args, |trainer| trainer)
}

/// Runs as [`run`] does, with the trainer changed before its first step. For tests, which make the run fail.
#[doc(hidden)]
pub fn run_with(args: &TrainArgs, change: impl FnOnce(Trainer) -> Trainer) -> Result<Metrics> {
    to_the_end(args.clone(), None, Rc::new(Alone), change)
}

/// Runs as [`run`] does, on all ranks that were started together.
///
/// # Errors
/// Those of [`run`], and if the ranks differ in version or options.
pub fn run_together(args: &TrainArgs) -> Result<()> {
    let ranks = ranks::join()?;
    ranks::agree_on_start(&*ranks, args)?;
    if ranks.rank() > 0 {
        return ranks::follow(&ranks);
    }
    to_the_end(args.clone(), None, ranks, |trainer| trainer).map(drop)
}

/// Resumes a run from its newest checkpoint, with its original options.
///
/// # Errors
/// If no checkpoint can be resumed from, and as for [`run`].
pub fn resume(args: &ResumeArgs) -> Result<Metrics> {
    resume_on(args, Rc::new(Alone))
}

/// Resumes as [`resume`] does, on all ranks that were started together. A run of which there is nothing but its options begins, and a
/// finished one is left alone, so that the same line can be run again and again.
///
/// # Errors
/// Those of [`resume`], and if the ranks differ in version or options.
pub fn resume_together(args: &ResumeArgs) -> Result<()> {
    let ranks = ranks::join()?;
    ranks::agree_on_start(&*ranks, args)?;
    if ranks.rank() > 0 {
        return ranks::follow(&ranks);
    }
    let options = args.out.join(CONFIG);
    match checkpoints::state_of(&args.out) {
        RunState::Finished => {
            progress::note(&format!("the run in {} is finished", args.out.display()));
            ranks::tell::<Option<RunSetup>>(&*ranks, Some(None))?;
            Ok(())
        }
        RunState::New if options.is_file() => {
            let (out, voice, live) = (Some(args.out.clone()), args.voice, args.live.clone());
            let args = TrainArgs { out, voice, live, ..config::read(&options)? };
            to_the_end(args, None, ranks, |trainer| trainer).map(drop)
        }
        // A run that is under way is refused by its lock.
        _ => resume_on(args, ranks).map(drop),
    }
}

fn resume_on(args: &ResumeArgs, ranks: Rc<dyn Ranks>) -> Result<Metrics> {
    let kept = checkpoints::newest(&args.out)?;
    let of_the_run =
        TrainArgs { out: Some(args.out.clone()), voice: args.voice, live: args.live.clone(), ..kept.args.clone() };
    to_the_end(of_the_run, Some(kept), ranks, |trainer| trainer)
}

fn to_the_end(
    mut args: TrainArgs,
    kept: Option<SavedRun>,
    ranks: Rc<dyn Ranks>,
    change: impl FnOnce(Trainer) -> Trainer,
) -> Result<Metrics> {
    let mut config = args.config()?;
    // An unavailable port is found before the capture is read.
    let server = args.live.listen()?;
    if let Some(steps) = kept.as_ref().and_then(|kept| kept.so_far.steps) {
        config = args.schedule(config, steps);
    }
    let (device, device_name) = args.device.resolve()?;
    let lpips = args.lpips.read(&device)?;
    let (out, mut capture, start) = open(&args)?;
    let inputs = Inputs::of(&args.capture);
    // A run may be resumed from any working directory, and a video does not tell which folder its frames are in.
    if let Some(source) = args.capture.take() {
        args.cameras = args.cameras.from_anywhere();
        let found = if reconstruct::is_needed(&source) { &capture.folder } else { &source };
        args.capture = Some(std::path::absolute(found)?);
    }
    let (split, photo_args) = args.photos.split(&capture);
    let out = prepare(&out, inputs_of(inputs, &args, &capture, kept.is_none()), (&capture, &split, &photo_args))?;
    args.cameras.scale(&mut capture)?;
    let capture = Arc::new(capture);
    args.lpips = args.lpips.from_anywhere();
    args.start = args.start.map(std::path::absolute).transpose()?;
    let (seen, max_side) = (split.require_train()?, args.photos.max_side);
    let effects = args.effects.choose(&capture, seen, args.model.antialias.unwrap_or_default())?;
    effects.configure(&mut config, args.background, args.sh_degree);
    config.density = config.density.focused(capture.focus.map(Focus::on));
    if args.start.is_none() && is_random(&capture, seen, max_side) {
        config.density = config.density.without_points();
    }
    let available = budget::available();
    let cache = budget::cache(args.cache_mb, available) / ranks.count();
    if ranks.count() > 1 {
        let checkpoint = kept.as_ref().map(|kept| std::path::absolute(&kept.path)).transpose()?;
        let mut args = args.clone();
        if args.capture.is_none() {
            args.capture = Some(std::path::absolute(&capture.folder)?);
        }
        let effects = effects.on.iter().map(|effect| effect.name().to_owned()).collect();
        let setup = RunSetup { args, config: config.clone(), effects, checkpoint };
        ranks::tell(&*ranks, Some(Some(setup)))?;
        ranks::agree_on_files(&*ranks, &capture, seen)?;
    }
    let resolved = TrainArgs {
        steps: args.time.is_none().then_some(config.steps),
        sh_degree: Some(config.sh_degree),
        effects: effects.asked_again(),
        ..args.clone()
    };
    // `--test-every 0` asks for no test; any other number that holds out no photograph is a mistake.
    let test = if photo_args.test_every == Some(0) { &[] } else { split.require_test()? };
    let (train, test) = photographs(&capture, (seen, test), &photo_args, (&effects, cache), &*ranks)?;
    ensure!(
        args.eval_during.unwrap_or(0) == 0 || !test.is_empty(),
        "`--eval-during` scores test views, and `--test-every 0` holds out none: leave out one of them"
    );
    ensure!(
        lpips.is_none() || !test.is_empty(),
        "`--lpips` is measured on test views, and `--test-every 0` holds out none: leave out one of them"
    );
    let train_views = views_of(&capture, &train);
    progress::note(&format!(
        "{}: {} photographs to train on, {} to test on, {} points",
        capture.folder.display(),
        train.len(),
        test.len(),
        capture.points.positions.len()
    ));
    let most = config.density.max_splats();
    progress::note(&MemoryEstimate::of(&train, &test, &config, most).said(most, available));
    let points = start_points(&capture, &train, &args)?;
    let trainer = args.supply(Trainer::of(train, &points, config.clone(), &device)?)?;
    let trainer = if kept.is_none() { started(trainer, &args, &capture)? } else { trainer };
    let trainer = effects.supply(trainer, &capture, &train_views)?;
    let mut trainer = change(trainer).with_ranks(Rc::clone(&ranks));
    let load = seconds_since(start);

    // All errors in the capture have been found by now: a run that does not begin leaves no files.
    let checkpoints = Checkpoints::open(out.path())?;
    out.sweep();
    // Without the file a run is as good.
    let kept_options =
        config::to_toml(&resolved).and_then(|text| out.write(CONFIG, |file| Ok(file.write_all(text.as_bytes())?)));
    if let Err(error) = kept_options {
        progress::note(&format!("{CONFIG} was not written: {error:#}"));
    }
    let so_far = match kept {
        None => {
            checkpoints.begin()?;
            SoFar::default()
        }
        Some(kept) => {
            let cannot = || format!("cannot resume from {}", kept.path.display());
            trainer.resume(kept.trainer).with_context(cannot)?;
            progress::note(&format!("resuming from step {} of {}", trainer.steps_done(), config.steps));
            kept.so_far
        }
    };
    progress::line(&LogLine::Start {
        steps: config.steps,
        train_views: train_views.len(),
        test_views: test.len(),
        splats: trainer.gaussians().len(),
        device: &device_name,
        version: env!("CARGO_PKG_VERSION"),
    });
    let live = server.map(|server| Live::start(server, &trainer, &test, &device, out.path())).transpose()?;
    let steps = Steps {
        args: &args,
        capture: &capture,
        out: &out,
        test: &test,
        device: &device,
        lpips: lpips.as_ref(),
        checkpoints,
        live,
        ranks,
    };
    let Done { seconds: train, history, checkpoints, live, stopped_at } = steps.run(&mut trainer, so_far)?;
    // Schedules may have changed since the start.
    config = trainer.config().clone();
    let background = trainer.background();
    let render_options = trainer.render_options();
    // Before measuring, so that a failure there does not lose the scene.
    let unusable = write_scene(&trainer, &capture, &out.join(SCENE))?;
    write_learnt(&trainer, &config, &capture, &out)?;
    progress::note_unusable(&out.join(SCENE), unusable, trainer.gaussians().len());
    let gaussians = match config.smoothing {
        true => Gaussians::from_rows(&trainer.rows(), &device)?,
        false => trainer.gaussians().untracked(),
    };
    // The page and the scores need the memory of photographs and moments, which are no longer used.
    drop(trainer);
    let rows = gaussians.to_rows();
    let scene = ShownScene::new(&rows, page::SCENE_BYTES).ok();
    let last = live.map(|live| (live, rows));

    let start = Instant::now();
    let measure = || report::measure(&gaussians.splats(), &test, &background, &render_options, lpips.as_ref(), &out);
    let test_scores = if test.is_empty() { None } else { Some(measure()?) };
    let eval = seconds_since(start);
    let options = TrainOptionsRecord {
        capture: &capture.folder,
        photos: &photo_args,
        config: &config,
        start: args.start.as_deref(),
        lpips: &args.lpips,
    };
    let metrics = Metrics {
        test: test_scores,
        splats: gaussians.len(),
        culled_non_finite: unusable,
        steps: Some(config.steps),
        seconds: Seconds { load, train: Some(train), eval },
        peak_rss_mib: peak_rss_mib(),
        device: device_name.clone(),
        effects: Some(effects),
        seed: Some(config.seed),
        options: serde_json::to_value(options)?,
        version: env!("CARGO_PKG_VERSION"),
    };
    report::finish(&metrics, &out)?;
    let viewpoints: Vec<Viewpoint> = test.iter().map(Viewpoint::of).collect();
    let page = ReportPage {
        metrics: &metrics,
        history: &history,
        scene: scene.as_ref(),
        viewpoints: &viewpoints,
        background: background.colour(),
        antialias: config.antialias,
    };
    page.write(&out)?;
    match stopped_at {
        None => checkpoints.finish(),
        Some(step) => progress::note(&format!(
            "stopped in the browser after step {step}; `splat resume {}` continues from there",
            out.path().display()
        )),
    }
    if let Some((live, rows)) = last {
        live.finish(rows, &metrics, &history);
    }
    report::say(&metrics, SCENE, &out);
    progress::line(&LogLine::Done { out: out.path().display().to_string(), metrics: &metrics });
    Ok(metrics)
}

/// Returns the indices of the views of photographs, some of which may have been left out.
pub(crate) fn views_of(capture: &Capture, photos: &[Photograph]) -> Vec<usize> {
    let by_name: BTreeMap<&str, usize> =
        capture.views.iter().enumerate().map(|(i, view)| (view.name.as_str(), i)).collect();
    photos.iter().map(|photo| by_name[photo.name.as_str()]).collect()
}

/// Returns the photographs to train on and those to test on, with at most this many bytes of pixels in memory; those to
/// train on come first.
pub(crate) fn photographs(
    capture: &Arc<Capture>,
    (train, test): (&[usize], &[usize]),
    args: &PhotoArgs,
    (effects, mut room): (&Chosen, usize),
    ranks: &dyn Ranks,
) -> Result<(Vec<Photograph>, Vec<Photograph>)> {
    let (masked, opaque) = (effects.has(EffectKind::Masks), !effects.has(EffectKind::Alpha));
    let wanted = PhotoSelection { capture, max_side: args.max_side, masked, opaque };
    let train = match ranks.count() {
        1 => wanted.within(train, &mut room)?,
        _ => {
            let train = wanted.shared(train, room, ranks)?;
            room = room.saturating_sub(train.iter().map(Photograph::bytes).sum());
            train
        }
    };
    Ok((train, wanted.within(test, &mut room)?))
}
