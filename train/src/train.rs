//! `splat train`: photographs in; a scene, its scores and its pictures out.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, anyhow};
use clap::builder::RangedU64ValueParser;
use glam::DAffine3;
use serde::Serialize;
use splat_model::accuracy::Work;
use splat_model::capture::demo::DemoOptions;
use splat_model::capture::{Capture, Photo, Split};
use splat_model::density::matte;
use splat_model::effects::Effect;
use splat_model::effects::background::Backdrop;
use splat_model::gaussians::Gaussians;
use splat_model::ply;
use splat_model::trainer::{Resolution, TrainConfig, TrainError, Trainer};

use crate::accuracy::{Accuracy, AccuracyArgs};
use crate::background::TrainBackground;
use crate::device::{self, DeviceName};
use crate::effects::{Chosen, EffectsArg};
use crate::options::PhotoArgs;
use crate::output::OutputFolder;
use crate::pareto::Shot;
use crate::progress::{self, StepProgress};
use crate::report::metrics::{Metrics, Seconds, peak_rss_mib, seconds_since};
use crate::report::{self, BACKGROUND, METRICS, POSES, SCENE, VIEWS};
use crate::strategy::StrategyName;
use crate::{demo, input};

/// Steps of a run on the demo capture, chosen so that the whole of it takes under 3 minutes on 2 CPU cores.
pub const DEMO_STEPS: usize = 1500;

/// Degree of the spherical harmonics on the demo capture. Its surfaces are matte: their colour is the same from
/// everywhere.
pub const DEMO_SH_DEGREE: usize = 0;

/// Where a run on the demo capture writes to unless told otherwise.
pub const DEMO_OUT: &str = "out/demo";

/// The demo capture, below the output folder.
const DEMO_CAPTURE: &str = "demo-capture";

/// With a target for the accuracy: settings are measured after this part of the steps.
const MEASURED_AFTER: usize = 10;

/// Options of `splat train`.
#[derive(Clone, Debug, clap::Args)]
pub struct TrainArgs {
    /// Folder with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`; without one, the demo capture is made and trained on
    #[arg(requires = "out")]
    pub capture: Option<PathBuf>,
    /// Folder for scene.ply, metrics.json and views/; with the demo capture `out/demo` if not given
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Training steps
    #[arg(long, value_name = "N", help = format!(
        "Training steps, of one photograph each unless there is a `--batch` [default: {}; with the demo capture {DEMO_STEPS}]", TrainConfig::default().steps
    ))]
    pub steps: Option<usize>,
    /// Where to compute
    #[arg(long, value_name = "NAME", default_value_t, help = device::help())]
    pub device: DeviceName,
    /// Seed of everything random
    #[arg(long, value_name = "S", default_value_t = TrainConfig::default().seed)]
    pub seed: u64,
    /// The number of splats never exceeds this
    #[arg(
        long,
        value_name = "N",
        default_value_t = TrainConfig::default().density.max_splats(),
        value_parser = RangedU64ValueParser::<usize>::new().range(1..)
    )]
    pub max_splats: usize,
    /// How splats are added, moved and removed
    #[arg(long, value_name = "NAME", value_enum, default_value_t)]
    pub strategy: StrategyName,
    /// Photographs in each step. Learning rates grow with the root of their number, as the field has it; take `--steps` N times
    /// smaller for a run that sees each photograph as often
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().batch, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub batch: usize,
    /// Photographs.
    #[command(flatten)]
    pub photos: PhotoArgs,
    /// Highest degree of the spherical harmonics
    #[arg(long, value_name = "D", help = format!(
        "Highest degree of the spherical harmonics, 0 to 4: how finely colour may vary with the direction of view \
         [default: {}, or 0 where `--effects auto` finds that no colour does; with the demo capture {DEMO_SH_DEGREE}]",
        TrainConfig::default().sh_degree
    ))]
    pub sh_degree: Option<usize>,
    /// Steps until the degree rises by one, beginning with 0; 0 has all degrees from the start
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().sh_every)]
    pub sh_every: usize,
    /// Give splats one colour for all directions whose colours hardly differ: by less than so many levels of 255, as root mean
    /// square over all directions. Decided each time the degree rises from 1 on. They take less memory and time [default: off]
    #[arg(long, value_name = "LEVELS")]
    pub matte_below: Option<f64>,
    /// Dim splats smaller than a pixel, so that scenes also look right from further away; evaluate and render with it too
    #[arg(long)]
    pub antialias: bool,
    /// Weight of the mean opacity in the loss, against floaters; 0.01 is usual
    #[arg(long, value_name = "W", default_value_t = TrainConfig::default().opacity_weight)]
    pub opacity_weight: f64,
    /// Begin with photographs whose sides are this many times shorter: 1, 2, 4, 8 or 16
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().resolution.coarsest_divisor)]
    pub coarsest: usize,
    /// With `--coarsest`: share of the steps after which photographs have their full size
    #[arg(long, value_name = "SHARE", default_value_t = TrainConfig::default().resolution.full_from)]
    pub full_from: f64,
    /// How accurate the renders are.
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
    /// What is behind the scene: black, white, R,G,B from 0 to 1, random (another colour at each step), learned,
    /// environment or environment:D (light from infinity, harmonics of degree D) [default: black, or what the effects call for]
    #[arg(long, value_name = "WHAT")]
    pub background: Option<TrainBackground>,
    /// Effects to simulate: `auto`, as `splat inspect` decides; `none`; a list of names with commas between them; or `+NAME`
    /// and `-NAME` to adjust `auto`. Names: antialias, alpha, exposure, bilateral-grid, masks, pose-refinement, environment,
    /// motion-blur, rolling-shutter, defocus, depth-supervision
    #[arg(long, value_name = "LIST", default_value_t, allow_hyphen_values = true)]
    pub effects: EffectsArg,
    /// Look at what every stage of every step leaves, and end at the first that goes wrong; several times as slow
    #[arg(long)]
    pub check: bool,
}

/// What `metrics.json` says under `options`.
#[derive(Serialize)]
struct Options<'a> {
    capture: &'a Path,
    #[serde(flatten)]
    photos: &'a PhotoArgs,
    #[serde(flatten)]
    config: &'a TrainConfig,
    check: bool,
}

impl TrainArgs {
    /// The configuration of the run, before effects are decided on.
    ///
    /// # Errors
    /// If the steps are zero or there is no such degree: found here, before anything is read or written.
    pub fn config(&self) -> Result<TrainConfig, TrainError> {
        let mut config = TrainConfig { seed: self.seed, antialias: self.antialias, ..TrainConfig::default() };
        config.opacity_weight = self.opacity_weight;
        config.density = self.strategy.config().with_max_splats(self.max_splats);
        config.batch = self.batch;
        config.resolution = Resolution { coarsest_divisor: self.coarsest, full_from: self.full_from };
        if self.capture.is_none() {
            (config.steps, config.sh_degree) = (DEMO_STEPS, DEMO_SH_DEGREE);
        }
        config.steps = self.steps.unwrap_or(config.steps);
        config.sh_degree = self.sh_degree.unwrap_or(config.sh_degree);
        config.sh_every = self.sh_every;
        config.dials = self.accuracy.accuracy.setting();
        config.matte_below = self.matte_below.map(|levels| levels / 255.0);
        match config {
            TrainConfig { steps: 0, .. } => Err(TrainError::NoSteps),
            TrainConfig { sh_degree, .. } if sh_degree > splat_op::shade::SH_DEGREE_MAX => {
                Err(TrainError::ShDegree(sh_degree))
            }
            TrainConfig { resolution, .. } if !resolution.is_valid() => Err(TrainError::Resolution(resolution)),
            TrainConfig { matte_below: Some(below), .. } if !matte::is_threshold(below) => {
                Err(TrainError::MatteBelow(below))
            }
            config => Ok(config),
        }
    }

    /// Prepares the output folder and reads the capture, after making it if none was given.
    fn open(&self) -> Result<(OutputFolder, Capture, Instant)> {
        let out = self.out.as_deref().unwrap_or(Path::new(DEMO_OUT));
        let prepare = || OutputFolder::prepare(out, &[SCENE, METRICS, BACKGROUND, POSES], &[VIEWS]);
        match &self.capture {
            Some(folder) => {
                let start = Instant::now();
                let capture = input::capture(folder)?;
                Ok((prepare()?, capture, start))
            }
            None => {
                let out = prepare()?;
                let folder = out.join(DEMO_CAPTURE);
                demo::ensure(&folder, &DemoOptions::default())?;
                let start = Instant::now();
                Ok((out, input::capture(&folder)?, start))
            }
        }
    }
}

/// Trains, measures, writes everything, and says where it is.
///
/// # Errors
/// If the capture cannot be read, the results not be written, or an option is out of range; or if a loss or a gradient is
/// not finite: then `scene.ply` is the scene before that step.
pub fn run(args: &TrainArgs) -> Result<Metrics> {
    run_with(args, |trainer| trainer)
}

/// As [`run`], with the run changed before its first step. For tests, which make it go wrong.
#[doc(hidden)]
pub fn run_with(args: &TrainArgs, change: impl FnOnce(Trainer) -> Trainer) -> Result<Metrics> {
    let mut config = args.config()?;
    let (device, device_name) = args.device.resolve()?;
    let mut accuracy = Some(args.accuracy.resolve(&device_name, Work::Train)?);
    if let Some(Accuracy::Known(setting)) = accuracy.take_if(|accuracy| matches!(accuracy, Accuracy::Known(_))) {
        config.dials = setting;
    }
    let (out, capture, start) = args.open()?;
    let (split, photo_args) = args.photos.split(&capture);
    let mut effects = args.effects.choose(&capture, split.require_train()?, args.antialias)?;
    effects.configure(&mut config, args.background, args.sh_degree);
    let (train, test) = photographs(&capture, &split, &photo_args, &effects)?;
    let train_views = views_of(&capture, &train);
    let cameras: Vec<Shot> = train.iter().map(|photo| Shot::unseen(&photo.intrinsics, &photo.cam_from_world)).collect();
    progress::note(&format!(
        "{}: {} photographs to train on, {} to test on, {} points",
        capture.folder.display(),
        train.len(),
        test.len(),
        capture.points.positions.len()
    ));
    let trainer = Trainer::new(train, &capture.points, config.clone(), &device)?;
    let trainer = effects.supply(trainer, &capture, &train_views)?;
    let mut trainer = change(if args.check { trainer.with_checks() } else { trainer });
    let load = seconds_since(start);

    let start = Instant::now();
    let mut bar = StepProgress::new(config.steps);
    while !trainer.is_done() {
        // Earlier a scene is not yet like what it will be.
        if trainer.steps_done() >= config.steps / MEASURED_AFTER
            && let Some(accuracy) = accuracy.take()
        {
            let (rows, base) = (trainer.rows(), trainer.render_options());
            config.dials = accuracy.setting((&rows, cameras.clone()), &base, (&device, &device_name), Work::Train)?;
            trainer.turn(&config.dials);
        }
        match trainer.step() {
            Ok(report) => bar.step(&report),
            Err(error) => {
                bar.finish();
                return Err(keep_scene(error, &trainer, &capture, &out));
            }
        }
    }
    bar.finish();
    let train = seconds_since(start);
    let background = trainer.background();
    let render_options = trainer.render_options();
    // Before measuring, so that whatever goes wrong there does not cost the scene.
    let rows = trainer.rows();
    ply::write(&out.join(SCENE), &rows, capture.origin)?;
    write_learnt(&trainer, &config, &capture, &out)?;
    let matte = trainer.gaussians().len() - trainer.gaussians().directional();
    let gaussians = match config.smoothing {
        true => Gaussians::from_rows(&rows, &device)?,
        false => trainer.gaussians().untracked(),
    };
    let unusable = rows.unusable();
    progress::note_unusable(&out.join(SCENE), unusable, rows.len());
    drop(rows);
    effects.measure(&mut trainer)?;
    // Photographs and moments are not needed for the scores, and their memory is.
    drop(trainer);

    let start = Instant::now();
    let measure = || report::measure(&gaussians.splats(), &test, &background, &render_options, &out);
    let test_scores = if test.is_empty() { None } else { Some(measure()?) };
    let eval = seconds_since(start);
    let options = Options { capture: &capture.folder, photos: &photo_args, config: &config, check: args.check };
    let metrics = Metrics {
        test: test_scores,
        splats: gaussians.len(),
        matte,
        culled_non_finite: unusable,
        steps: Some(config.steps),
        seconds: Seconds { load, train: Some(train), eval },
        peak_rss_mib: peak_rss_mib(),
        device: device_name,
        effects: Some(effects),
        seed: Some(config.seed),
        options: serde_json::to_value(options)?,
        version: env!("CARGO_PKG_VERSION"),
    };
    report::finish(&metrics, &out)?;
    report::say(&metrics, &out);
    Ok(metrics)
}

/// Writes what was learnt beside the scene, and removes what an earlier run had learnt.
fn write_learnt(trainer: &Trainer, config: &TrainConfig, capture: &Capture, out: &OutputFolder) -> Result<()> {
    let is_learnt = matches!(config.backdrop, Backdrop::Learned | Backdrop::Environment { .. });
    let background = is_learnt.then(|| trainer.background().to_json()).transpose()?;
    let poses = trainer.refined_poses().map(|poses| poses_json(&poses, capture)).transpose()?;
    for (name, text) in [(BACKGROUND, background), (POSES, poses)] {
        match text {
            Some(text) => out.write(name, |file| Ok(file.write_all(text.as_bytes())?))?,
            // There may be none.
            None => _ = fs::remove_file(out.join(name)),
        }
    }
    Ok(())
}

/// By photograph: the rows of `cam_from_world`, `[3, 4]`, OpenCV axes, in the world frame of the capture's file.
fn poses_json(poses: &[(String, DAffine3)], capture: &Capture) -> serde_json::Result<String> {
    let local_from_world = DAffine3::from_translation(-capture.origin);
    let rows = |pose: &DAffine3| {
        let pose = *pose * local_from_world;
        let row = |i: usize| [pose.x_axis[i], pose.y_axis[i], pose.z_axis[i], pose.translation[i]];
        [row(0), row(1), row(2)]
    };
    let by_name: BTreeMap<&str, [[f64; 4]; 3]> = poses.iter().map(|(name, pose)| (name.as_str(), rows(pose))).collect();
    serde_json::to_string_pretty(&by_name)
}

/// Writes the scene of a run that went wrong: as it was before the step that did. The error as the user sees it.
fn keep_scene(error: TrainError, trainer: &Trainer, capture: &Capture, out: &OutputFolder) -> anyhow::Error {
    if !error.keeps_scene() {
        return error.into();
    }
    let path = out.join(SCENE);
    let kept = match ply::write(&path, &trainer.rows(), capture.origin) {
        Ok(()) => format!("{} is the scene before that step", path.display()),
        Err(reason) => format!("the scene before that step could not be kept: {reason}"),
    };
    anyhow!("{error}. {kept}")
}

/// The views of photographs, some of which may have been left out.
fn views_of(capture: &Capture, photos: &[Photo]) -> Vec<usize> {
    let by_name: BTreeMap<&str, usize> =
        capture.views.iter().enumerate().map(|(i, view)| (view.name.as_str(), i)).collect();
    photos.iter().map(|photo| by_name[photo.name.as_str()]).collect()
}

/// The photographs to train on and those to test on. All are decoded before the first step, so that a broken picture
/// does not end a long run.
fn photographs(
    capture: &Capture,
    split: &Split,
    args: &PhotoArgs,
    effects: &Chosen,
) -> Result<(Vec<Photo>, Vec<Photo>)> {
    let train = split.require_train()?;
    // `--eval-every 0` asks for no test; any other number that leaves none is a mistake.
    let test = if args.eval_every == Some(0) { &[] } else { split.require_test()? };
    let photos = |views| -> Result<Vec<Photo>> {
        let mut photos = input::photographs(capture, views, args.max_side, effects.has(Effect::Masks))?;
        if !effects.has(Effect::Alpha) {
            photos.iter_mut().for_each(|photo| photo.alpha = None);
        }
        Ok(photos)
    };
    Ok((photos(train)?, photos(test)?))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use splat_model::density::{AdaptiveConfig, DensityConfig, McmcConfig};

    use super::*;
    use crate::options::{Cli, Command};

    fn config(arguments: &[&str]) -> Result<TrainConfig, TrainError> {
        let cli = Cli::try_parse_from(["splat", "train"].iter().chain(arguments)).unwrap();
        let Command::Train(args) = cli.command else { panic!("asked for train") };
        args.config()
    }

    #[test]
    fn without_options_a_capture_trains_as_the_library_does() {
        assert_eq!(config(&["capture", "--out", "out"]).unwrap(), TrainConfig::default());
    }

    #[test]
    fn the_demo_is_short_unless_told_otherwise() {
        assert_eq!(config(&[]).unwrap().steps, DEMO_STEPS);
        assert_eq!(config(&["--steps", "9"]).unwrap().steps, 9);
    }

    #[test]
    fn options_reach_the_configuration() {
        let arguments =
            ["--seed", "5", "--max-splats", "77", "--sh-degree", "2", "--antialias", "--opacity-weight", "0.01"];
        let config = config(&arguments).unwrap();
        assert_eq!((config.seed, config.density.max_splats(), config.sh_degree, config.antialias), (5, 77, 2, true));
        assert_eq!(config.opacity_weight, 0.01);
        let config = self::config(&["--sh-every", "300", "--matte-below", "2.55"]).unwrap();
        assert_eq!(config.sh_every, 300);
        assert!((config.matte_below.unwrap() - 0.01).abs() < 1e-12);
    }

    #[test]
    fn strategies_have_the_settings_of_the_library() {
        let density = |arguments: &[&str]| config(arguments).unwrap().density;
        assert_eq!(density(&["--strategy", "adaptive"]), DensityConfig::from(AdaptiveConfig::default()));
        let absgrad = AdaptiveConfig { max_splats: 5, ..AdaptiveConfig::absgrad() };
        assert_eq!(density(&["--strategy", "absgrad", "--max-splats", "5"]), absgrad.into());
        let mcmc = McmcConfig { max_splats: 5, ..McmcConfig::default() };
        assert_eq!(density(&["--strategy", "mcmc", "--max-splats", "5"]), mcmc.into());
        assert_eq!(config(&["--batch", "4"]).unwrap().batch, 4);
    }

    #[test]
    fn photographs_are_small_at_first_where_asked_for() {
        let divisor = |arguments: &[&str], step| config(arguments).unwrap().resolution.divisor_at(step, 100);
        assert_eq!(divisor(&[], 1), 1);
        assert_eq!([1, 26, 51].map(|step| divisor(&["--coarsest", "4"], step)), [4, 2, 1]);
        assert_eq!(divisor(&["--coarsest", "4", "--full-from", "0.8"], 80), 2);
    }

    #[test]
    fn impossible_options_are_refused() {
        assert!(config(&["--steps", "0"]).unwrap_err().to_string().contains("--steps"));
        assert!(config(&["--sh-degree", "5"]).unwrap_err().to_string().contains("sh_degree"));
        assert!(config(&["--coarsest", "3"]).unwrap_err().to_string().contains("--coarsest"));
        assert!(config(&["--matte-below", "inf"]).unwrap_err().to_string().contains("--matte-below"));
    }
}
