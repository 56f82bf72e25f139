//! `splat train`: trains a scene on photographs, and writes the scene, its scores and its pictures.

pub(crate) mod budget;
pub(crate) mod checkpoints;
mod folders;
mod results;
mod run;
mod start;
mod steps;
mod stop;
mod time_limit;

use std::path::PathBuf;

use anyhow::Result;
use clap::builder::RangedU64ValueParser;
use serde::{Deserialize, Serialize};
use splat_model::optim::{LearningRates, MomentBits, sh_every_for};
use splat_model::trainer::{Resolution, TrainConfig, TrainError};

pub use self::checkpoints::{RunState, state_of};
pub(crate) use self::run::{photographs, views_of};
pub use self::run::{resume, resume_together, run, run_or_resume, run_with};
pub(crate) use self::start::{start_points, started};
pub use self::stop::Interrupted;
pub(crate) use self::stop::Stop;
use self::time_limit::{GUESS, TrainingTime};
use crate::accuracy::{AccuracyArgs, ModelArgs};
use crate::background::TrainBackground;
use crate::device::{self, DeviceName};
use crate::effects::EffectsArg;
use crate::live::LiveArgs;
use crate::lpips::LpipsArgs;
use crate::options::PhotoArgs;
use crate::progress::VoiceArgs;
use crate::reconstruct::CameraArgs;
use crate::strategy::StrategyName;

/// Default number of steps on the demo capture, chosen so that the whole run takes under 3 minutes on 2 CPU cores.
pub const DEMO_STEPS: usize = 1500;

/// Default degree of the spherical harmonics on the demo capture. Its surfaces are matte: their colour is the same from
/// everywhere.
pub const DEMO_SH_DEGREE: usize = 0;

/// Default parent folder of the runs, each of which has its own folder.
pub const OUT: &str = "out";

/// Default number of steps between checkpoints: a minute or two of the usual run on a CPU, seconds on a GPU.
pub const CHECKPOINT_EVERY: usize = 500;

/// Options of `splat train`. Checkpoints store them.
#[derive(Clone, Debug, clap::Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainArgs {
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`; or a
    /// folder of photographs or a video, whose cameras are found first, as `splat reconstruct` does; without one, make the
    /// demo capture and train on it
    pub capture: Option<PathBuf>,
    /// Folder for scene.ply, metrics.json and views/, replacing the results of an earlier run [default: out/NAME, after
    /// the capture, or out/demo for the demo capture; out/NAME-2 and so on if that is not empty]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Scene to start from, in any format, with the capture's points as far as `--max-splats` leaves room for them [default: the points alone]
    #[arg(long, value_name = "FILE", requires = "capture")]
    #[serde(default)]
    pub start: Option<PathBuf>,
    /// Training steps
    #[arg(long, value_name = "N", help = format!(
        "Training steps, each on `--batch` photographs [default: {}; with the demo capture {DEMO_STEPS}]", TrainConfig::default().steps
    ))]
    pub steps: Option<usize>,
    /// Train for this time instead of a number of steps: 60s, 10min, '1h 30m'. The first steps are measured, and the number of
    /// steps is chosen and corrected so that training ends in time; reading the capture and scoring come on top. Two such
    /// runs differ, because machines are never equally fast twice
    #[arg(long = "for", value_name = "TIME", conflicts_with_all = ["steps", "snapshots"])]
    #[serde(default)]
    pub time: Option<TrainingTime>,
    /// Cameras.
    #[command(flatten)]
    #[serde(default)]
    pub cameras: CameraArgs,
    /// Device to compute on
    #[arg(long, value_name = "NAME", default_value_t, help = device::help())]
    #[serde(with = "crate::as_text")]
    pub device: DeviceName,
    /// Random seed
    #[arg(long, value_name = "S", default_value_t = TrainConfig::default().seed)]
    pub seed: u64,
    /// Maximum number of splats
    #[arg(
        long,
        value_name = "N",
        default_value_t = TrainConfig::default().density.max_splats(),
        value_parser = RangedU64ValueParser::<usize>::new().range(1..)
    )]
    pub max_splats: usize,
    /// Density strategy: how splats are added, moved and removed
    #[arg(long, value_name = "NAME", value_enum, default_value_t)]
    pub strategy: StrategyName,
    /// Photographs per step. Learning rates grow with the square root of their number; divide `--steps` by it to use
    /// each photograph as often
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().batch, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub batch: usize,
    /// Photographs.
    #[command(flatten)]
    pub photos: PhotoArgs,
    /// Highest degree of the spherical harmonics
    #[arg(long, value_name = "D", help = format!(
        "Highest degree of the spherical harmonics, 0 to 4: how finely colour may vary with the direction of view \
         [default: {}, or 0 where `--effects auto` finds no such variation; with the demo capture {DEMO_SH_DEGREE}]",
        TrainConfig::default().sh_degree
    ))]
    pub sh_degree: Option<usize>,
    /// Steps between increases of the degree, which begins at 0; 0 uses all degrees from the start
    #[arg(long, value_name = "N", help = format!(
        "Steps between increases of the degree, which begins at 0; 0 uses all degrees from the start [default: {}, or an \
         eighth of a shorter run]", TrainConfig::default().sh_every
    ))]
    pub sh_every: Option<usize>,
    /// Bits of each of Adam's moments, 32, 16 or 8: they take 472, 236 or 124 bytes of a Gaussian of degree 3 (see docs/ACCURACY.md for
    /// what fewer bits cost)
    #[arg(long, value_name = "BITS", default_value_t)]
    #[serde(with = "crate::as_text", default)]
    pub moment_bits: MomentBits,
    /// Model choices.
    #[command(flatten)]
    pub model: ModelArgs,
    /// Weight of the mean opacity in the loss, against floaters, until the strategy neither adds nor removes splats [default: 0.01
    /// with the strategy `gradual`, else 0]
    #[arg(long, value_name = "W")]
    pub opacity_weight: Option<f64>,
    /// Begin with photographs downsized by this factor, 1, 2, 4, 8 or 16, until half of the steps are done [default: 1; with `--for`,
    /// 8 in a run of up to 1,000 steps, else 4]
    #[arg(long, value_name = "N")]
    pub coarsest: Option<usize>,
    /// Accuracy of the renders.
    #[command(flatten)]
    pub accuracy: AccuracyArgs,
    /// Background behind the scene: black, white, R,G,B from 0 to 1, random (a new colour at each step), learned,
    /// environment or environment:D (learned light from infinity, spherical harmonics of degree D) [default: black, or
    /// the background that the effects call for]
    #[arg(long, value_name = "WHAT")]
    pub background: Option<TrainBackground>,
    /// Effects to simulate: `auto` (as `splat inspect` decides), `none`, a comma-separated list of names, or `+NAME`
    /// and `-NAME` to adjust `auto`. Names: antialias, alpha, exposure, bilateral-grid, masks, pose-refinement,
    /// environment, motion-blur, rolling-shutter, defocus, depth-supervision
    #[arg(long, value_name = "LIST", default_value_t, allow_hyphen_values = true)]
    #[serde(with = "crate::as_text")]
    pub effects: EffectsArg,
    /// Score the scene on a few held-out views every N steps, before the refinement of the same step, for the curve in
    /// report.html and for --json [default: off]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub eval_during: Option<usize>,
    /// With `--eval-during`: save the scene and the renders of each evaluation in the folder snapshots of the output
    /// folder, at most 100,000 splats and four renders each. `train/rerun/` shows them in the Rerun viewer (see
    /// docs/RERUN.md)
    #[arg(long, requires = "eval_during")]
    #[serde(default)]
    pub snapshots: bool,
    /// LPIPS.
    #[command(flatten)]
    #[serde(default)]
    pub lpips: LpipsArgs,
    /// Amount of output.
    #[command(flatten)]
    #[serde(skip)]
    pub voice: VoiceArgs,
    /// View in the browser.
    #[command(flatten)]
    #[serde(skip)]
    pub live: LiveArgs,
    /// Memory for decoded photographs, and as much for photographs prepared for the loss, MB. Photographs that do not
    /// fit are decoded again, in the background, each time they are used [default: half of the available memory]
    #[arg(long, value_name = "MB")]
    pub cache_mb: Option<usize>,
    /// Steps between checkpoints, from which `splat resume` continues; 0 writes them only when the run is stopped by
    /// Ctrl-C or SIGTERM
    #[arg(long, value_name = "K", default_value_t = CHECKPOINT_EVERY)]
    pub checkpoint_every: usize,
    /// Resume the run in `--out` where it was stopped, with its own options; begin it where there is none, and leave a finished
    /// one as it is. The same line can then be run again and again
    #[arg(long, requires = "out")]
    #[serde(skip)]
    pub resume: bool,
}

/// Options of `splat resume`.
#[derive(Clone, Debug, clap::Args, Serialize)]
pub struct ResumeArgs {
    /// Output folder of the run: its `--out`
    #[arg(value_name = "DIR")]
    pub out: PathBuf,
    /// Amount of output.
    #[command(flatten)]
    #[serde(skip)]
    pub voice: VoiceArgs,
    /// View in the browser.
    #[command(flatten)]
    #[serde(skip)]
    pub live: LiveArgs,
}

impl TrainArgs {
    /// Returns the configuration of the run, before effects are decided on.
    ///
    /// # Errors
    /// If the number of steps is zero or the degree is not supported. This is checked before any file is read or
    /// written.
    pub fn config(&self) -> Result<TrainConfig, TrainError> {
        let mut config = TrainConfig { seed: self.seed, ..self.model.config() };
        config.opacity_weight = self.opacity_weight.unwrap_or(self.strategy.opacity_weight());
        config.batch = self.batch;
        if self.capture.is_none() {
            (config.steps, config.sh_degree) = (DEMO_STEPS, DEMO_SH_DEGREE);
        }
        let steps = self.time.map_or(self.steps.unwrap_or(config.steps), |_| GUESS);
        config = self.schedule(config, steps);
        config.sh_degree = self.sh_degree.unwrap_or(config.sh_degree);
        config.moment_bits = self.moment_bits;
        config.density = self.strategy.config().with_max_splats(self.max_splats);
        config.dials = config.dials.and(&self.accuracy.accuracy.setting());
        if let Some(mb) = self.cache_mb {
            config.cache_mib = config.cache_mib.min(mb.saturating_mul(1_000_000) >> 20);
        }
        match config {
            TrainConfig { steps: 0, .. } => Err(TrainError::NoSteps),
            TrainConfig { sh_degree, .. } if sh_degree > splat_op::sh::SH_DEGREE_MAX => {
                Err(TrainError::ShDegree(sh_degree))
            }
            TrainConfig { resolution, .. } if !resolution.is_valid() => Err(TrainError::Resolution(resolution)),
            config => config.check().map(|()| config),
        }
    }

    /// Returns the configuration with the schedules of a run of `steps` (see [`Trainer::reschedule`]).
    ///
    /// [`Trainer::reschedule`]: splat_model::trainer::Trainer::reschedule
    fn schedule(&self, config: TrainConfig, steps: usize) -> TrainConfig {
        let sh_every = self.sh_every.unwrap_or(sh_every_for(steps));
        let usual = if self.time.is_some() { Resolution::within_time(steps) } else { Resolution::FULL };
        let coarsest_divisor = self.coarsest.unwrap_or(usual.coarsest_divisor);
        let resolution = Resolution { coarsest_divisor, ..usual };
        TrainConfig { steps, sh_every, learning_rates: LearningRates::for_steps(steps), resolution, ..config }
    }
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
        let of = |steps: &str| config(&["capture", "--out", "out", "--steps", steps]).unwrap();
        assert_eq!(config(&["capture", "--out", "out"]).unwrap(), TrainConfig::for_steps(30_000));
        assert_eq!(of("2000"), TrainConfig::for_steps(2_000));
        assert_eq!(config(&["capture", "--opacity-weight", "0"]).unwrap().opacity_weight, 0.0);
        let original = config(&["capture", "--strategy", "adaptive", "--sh-every", "1000"]).unwrap();
        assert_eq!(
            original,
            TrainConfig { learning_rates: LearningRates::for_steps(30_000), ..TrainConfig::default() }
        );
    }

    #[test]
    fn what_a_checkpoint_keeps_of_the_options_is_all_of_them() {
        let arguments =
            ["c", "--out", "o", "--device", "gpu:1", "--effects=auto,-masks", "--background", "0.1,0.2,0.3"];
        let more = ["--projection", "ray-max", "--accuracy", "fast", "--opacity-weight", "0.1", "--eval-during", "9"];
        let cli = Cli::try_parse_from(["splat", "train"].iter().chain(&arguments).chain(&more)).unwrap();
        let Command::Train(args) = cli.command else { panic!("asked for train") };
        let text = serde_json::to_string(&args).unwrap();
        let read: TrainArgs = serde_json::from_str(&text).unwrap();
        assert_eq!(format!("{read:?}"), format!("{args:?}"));
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
        let cache = |mb: &str| self::config(&["--cache-mb", mb]).unwrap().cache_mib;
        assert_eq!([cache("0"), cache("100"), cache("9000")], [0, 95, TrainConfig::default().cache_mib]);
        assert_eq!(self::config(&["--sh-every", "300"]).unwrap().sh_every, 300);
    }

    #[test]
    fn a_model_choice_and_a_preset_are_dials_of_one_run() {
        let dials = |arguments: &[&str]| config(arguments).unwrap().dials.to_string();
        assert_eq!(dials(&["--projection", "affine", "--order", "centre-depth"]), "nothing turned");
        assert_eq!(dials(&["--projection", "ray-max"]), "projection ray-max");
        let both = ["--order", "per-pixel-sort", "--accuracy", "fast"];
        assert_eq!(dials(&both), "alpha_min 4/255, order per-pixel-sort, transmittance_min 1e-3");
        let options = config(&both).unwrap().render_options(1.0);
        assert_eq!((options.order, options.alpha_min), (splat_op::Order::PerPixelSort, 4.0 / 255.0));
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
        assert_eq!(
            [(&["--for", "60s"][..]), &["--for", "60s", "--coarsest", "1"]].map(|flags| divisor(flags, 1)),
            [4, 1]
        );
    }

    #[test]
    fn impossible_options_are_refused() {
        assert!(config(&["--steps", "0"]).unwrap_err().to_string().contains("--steps"));
        assert!(config(&["--sh-degree", "5"]).unwrap_err().to_string().contains("sh_degree"));
        assert!(config(&["--coarsest", "3"]).unwrap_err().to_string().contains("--coarsest"));
    }
}
