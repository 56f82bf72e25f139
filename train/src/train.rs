//! `splat train`: trains a scene on photographs, and writes the scene, its scores and its pictures.

mod budget;
pub(crate) mod checkpoints;
pub mod config;
pub(crate) mod job;
mod results;
mod run;
mod setup;
mod steps;
mod time_limit;

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, RangedU64ValueParser, TypedValueParser};
use serde::{Deserialize, Serialize};
use serde_with::{As, DisplayFromStr};
use splat_model::density::DensityConfig;
use splat_model::optim::{LearningRates, MomentBits, sh_every_for};
use splat_model::trainer::{Resolution, TrainConfig, Trainer};

pub use self::checkpoints::{RunState, state_of};
pub use self::run::{resume_together, run, run_together, run_with};
use self::time_limit::{GUESS, parse_time};
use crate::accuracy::{AccuracyArgs, ModelArgs};
use crate::background::TrainBackground;
use crate::device::DeviceName;
use crate::effects::EffectsArg;
use crate::input::PhotoArgs;
use crate::live::LiveArgs;
use crate::lpips::LpipsArgs;
use crate::parts::{self, Part, StrategyName, USUAL_LOSS};
use crate::progress::VoiceArgs;
use crate::reconstruct::CameraArgs;
pub use crate::stop::Interrupted;

/// Default number of steps on the demo capture, chosen so that the whole run takes under 3 minutes on 2 CPU cores.
pub const DEMO_STEPS: usize = 1500;

/// Default degree of the spherical harmonics on the demo capture. Its surfaces are matte: their colour is the same from everywhere.
pub const DEMO_SH_DEGREE: usize = 0;

/// Options of `splat train`. Checkpoints store them, and `run.toml` (see [`config`]).
#[derive(Clone, Debug, clap::Args, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainArgs {
    /// Capture, photographs or video; without one, the demo capture
    ///
    /// Capture folder, with `images/` and COLMAP's `sparse/0/`, or with `transforms.json` or `transforms_train.json`; or a
    /// folder of photographs or a video, whose cameras are found first, as `splat reconstruct` does; without one, make the
    /// demo capture and train on it
    pub capture: Option<PathBuf>,
    /// Folder for scene.ply, metrics.json and views/ [default: out/NAME]
    ///
    /// Folder for scene.ply, metrics.json and views/, replacing the results of an earlier run [default: out/NAME, after
    /// the capture, or out/demo for the demo capture; out/NAME-2 and so on if that is not empty]
    #[arg(long, value_name = "DIR")]
    #[serde(skip)]
    pub out: Option<PathBuf>,
    /// Read options from a file such as the run.toml that each run writes
    ///
    /// Read options from a file such as the run.toml that each run writes into its folder. Options of the command line come before those
    /// of the file
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub config: Option<PathBuf>,
    /// Scene to start from, with the capture's points
    ///
    /// Scene to start from, in any format, with the capture's points as far as `--max-splats` leaves room for them [default: the points alone]
    #[arg(long, value_name = "FILE", requires = "capture")]
    #[serde(default)]
    pub start: Option<PathBuf>,
    /// Training steps
    #[arg(long, value_name = "N", help = format!(
        "Training steps, each on `--batch` photographs [default: {}; with the demo capture {DEMO_STEPS}]", TrainConfig::default().steps
    ))]
    pub steps: Option<usize>,
    /// Train for this time instead of a number of steps: 60s, 10min, '1h 30m'
    ///
    /// Train for this time instead of a number of steps: 60s, 10min, '1h 30m'. The first steps are measured, and the number of
    /// steps is chosen and corrected so that training ends in time; reading the capture and scoring come on top. Two such
    /// runs differ, because machines are never equally fast twice
    #[arg(long = "for", value_name = "TIME", value_parser = parse_time, conflicts_with = "steps")]
    #[serde(with = "As::<Option<DisplayFromStr>>", default, rename = "for")]
    pub time: Option<humantime::Duration>,
    #[command(flatten, next_help_heading = "Capture")]
    #[serde(default)]
    pub cameras: CameraArgs,
    /// Device to compute on: auto, cpu, flex, ndarray, gpu, gpu:N and what else `splat devices` lists
    #[arg(long, value_name = "NAME", default_value_t, help_heading = USUAL)]
    #[serde(with = "As::<DisplayFromStr>")]
    pub device: DeviceName,
    /// Random seed
    #[arg(long, value_name = "S", default_value_t = TrainConfig::default().seed, help_heading = OPTIMISER)]
    pub seed: u64,
    /// Maximum number of splats
    #[arg(
        long,
        value_name = "N",
        default_value_t = TrainConfig::default().density.max_splats(),
        help_heading = USUAL,
        value_parser = RangedU64ValueParser::<usize>::new().range(1..)
    )]
    pub max_splats: usize,
    /// Density strategy: how splats are added, moved and removed
    #[arg(long, value_name = "NAME", default_value_t, value_parser = strategies(), help_heading = DENSITY)]
    #[serde(with = "As::<DisplayFromStr>")]
    pub strategy: StrategyName,
    /// Loss; `l1-ssim` is L1 + D-SSIM, `l2` the mean square, and `surfaces` makes depth smooth for `splat mesh`
    #[arg(long, value_name = "NAME", default_value = USUAL_LOSS, value_parser = PossibleValuesParser::new(parts::names(Part::Loss)), help_heading = OPTIMISER)]
    #[serde(default = "usual_loss")]
    pub loss: String,
    /// Gradient from which a splat is split or copied, in the strategy's own unit; a smaller one gives more splats [default: the
    /// strategy's]
    #[arg(long, value_name = "G", value_parser = positive, help_heading = DENSITY)]
    pub grad_threshold: Option<f64>,
    #[command(flatten, next_help_heading = OPTIMISER)]
    pub lr: RateArgs,
    /// Weight of D-SSIM in the losses `l1-ssim` and `surfaces`, 0 to 1; the rest is that of L1
    #[arg(long, value_name = "W", value_parser = share, default_value_t = TrainConfig::default().lambda, help_heading = OPTIMISER)]
    pub ssim_weight: f64,
    /// Photographs per step. Learning rates grow with the square root of their number; divide `--steps` by it to use
    /// each photograph as often
    #[arg(long, value_name = "N", default_value_t = TrainConfig::default().batch, help_heading = OPTIMISER,
        value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub batch: usize,
    #[command(flatten, next_help_heading = USUAL)]
    pub photos: PhotoArgs,
    /// Highest degree of the spherical harmonics
    #[arg(long, value_name = "D", help_heading = USUAL, help = "Highest degree of the spherical harmonics, 0 to 4 [default: 3, or 0 where colours need none]",
        long_help = format!(
        "Highest degree of the spherical harmonics, 0 to 4: how finely colour may vary with the direction of view \
         [default: {}, or 0 where `--effects auto` finds no such variation; with the demo capture {DEMO_SH_DEGREE}]",
        TrainConfig::default().sh_degree
    ))]
    pub sh_degree: Option<usize>,
    /// Steps between increases of the degree, which begins at 0; 0 uses all degrees from the start
    #[arg(long, value_name = "N", help_heading = OPTIMISER, help = format!(
        "Steps between increases of the degree, which begins at 0; 0 uses all degrees from the start [default: {}, or an \
         eighth of a shorter run]", TrainConfig::default().sh_every
    ))]
    pub sh_every: Option<usize>,
    /// Bits of each of Adam's moments, 32 or 8: they take 472 or 124 bytes of a Gaussian of degree 3 (see docs/ACCURACY.md for what
    /// fewer bits cost)
    #[arg(long, value_name = "BITS", default_value_t, help_heading = MEMORY)]
    #[serde(with = "As::<DisplayFromStr>", default)]
    pub moment_bits: MomentBits,
    #[command(flatten, next_help_heading = ACCURACY)]
    pub model: ModelArgs,
    /// Weight of the mean opacity in the loss, against floaters, until the strategy neither adds nor removes splats [default: 0.01
    /// with the strategy `gradual`, else 0]
    #[arg(long, value_name = "W", help_heading = DENSITY)]
    pub opacity_weight: Option<f64>,
    /// Begin with photographs downsized by this factor, 1, 2, 4, 8 or 16, until half of the steps are done [default: 1; with `--for`,
    /// 8 in a run of up to 1,000 steps, else 4]
    #[arg(long, value_name = "N", help_heading = OPTIMISER)]
    pub coarsest: Option<usize>,
    #[command(flatten, next_help_heading = ACCURACY)]
    pub accuracy: AccuracyArgs,
    /// Compute everything but the rasterizer in tensor code: the same results up to rounding, slower, to check the operations
    #[arg(long, help_heading = ACCURACY)]
    #[serde(default)]
    pub plain: bool,
    /// Background: black, white, R,G,B, random, learned or environment
    ///
    /// Background behind the scene: black, white, R,G,B from 0 to 1, random (a new colour at each step), learned,
    /// environment or environment:D (learned light from infinity, spherical harmonics of degree D) [default: black, or
    /// the background that the effects call for]
    #[arg(long, value_name = "WHAT", help_heading = USUAL)]
    #[serde(with = "As::<Option<DisplayFromStr>>", default)]
    pub background: Option<TrainBackground>,
    /// Effects to simulate: auto, none, a list, or +NAME and -NAME
    ///
    /// Effects to simulate: `auto` (as `splat inspect` decides), `none`, a comma-separated list of names, or `+NAME`
    /// and `-NAME` to adjust `auto`. Names: antialias, alpha, exposure, bilateral-grid, masks, pose-refinement,
    /// environment, motion-blur, rolling-shutter, depth-supervision
    #[arg(long, value_name = "LIST", default_value_t, allow_hyphen_values = true, help_heading = USUAL)]
    #[serde(with = "As::<DisplayFromStr>")]
    pub effects: EffectsArg,
    /// Score the scene on at most four held-out views every N steps, before the refinement of the same step, for the curve in
    /// report.html and for --json; 0: never [default: ten times where that takes at most 2% of the run]
    #[arg(long, value_name = "N", help_heading = ACCURACY)]
    pub eval_during: Option<usize>,
    /// Also write the scene every N steps, as scene-000500.ply
    #[arg(long, value_name = "N", help_heading = USUAL, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub export_every: Option<usize>,
    #[command(flatten, next_help_heading = ACCURACY)]
    #[serde(default)]
    pub lpips: LpipsArgs,
    #[command(flatten, next_help_heading = USUAL)]
    #[serde(skip)]
    pub voice: VoiceArgs,
    #[command(flatten, next_help_heading = USUAL)]
    #[serde(skip)]
    pub live: LiveArgs,
    /// Memory for decoded photographs, and as much for photographs prepared for the loss, MB. Photographs that do not
    /// fit are decoded again, in the background, each time they are used [default: half of the available memory]
    #[arg(long, value_name = "MB", help_heading = MEMORY)]
    pub cache_mb: Option<usize>,
    /// Write a checkpoint, from which `splat resume` continues, every K steps too, and not only every two minutes; 0 writes one only when
    /// the run is stopped by Ctrl-C or SIGTERM
    #[arg(long, value_name = "K", help_heading = MEMORY)]
    pub checkpoint_every: Option<usize>,
}

/// Headings of the help, below the options that people use. Short help leaves out what is below a heading.
///
/// A heading of flattened options holds for what follows them, until the next one.
const USUAL: Option<&str> = None;
const DENSITY: &str = "Density";
const OPTIMISER: &str = "Optimiser";
const ACCURACY: &str = "Accuracy";
const MEMORY: &str = "Memory";

/// Learning rates that replace single ones of a run of this length. Their decay stays.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct RateArgs {
    /// Learning rate of the centres at the first step, as a share of the scene's extent
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_means: Option<f64>,
    /// Learning rate of the logarithms of the standard deviations at the first step
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_scales: Option<f64>,
    /// Learning rate of the quaternions at the first step
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_rotations: Option<f64>,
    /// Learning rate of the logits of the opacities at the first step
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_opacities: Option<f64>,
    /// Learning rate of the colours, which are the harmonics of degree 0, at the first step
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_sh_dc: Option<f64>,
    /// Learning rate of the higher harmonics at the first step
    #[arg(long, value_name = "R", value_parser = positive)]
    pub lr_sh_rest: Option<f64>,
}

impl RateArgs {
    /// Returns the rates with those that were given.
    fn over(&self, rates: LearningRates) -> LearningRates {
        LearningRates {
            means: self.lr_means.unwrap_or(rates.means),
            scales: self.lr_scales.unwrap_or(rates.scales),
            rotations: self.lr_rotations.unwrap_or(rates.rotations),
            opacities: self.lr_opacities.unwrap_or(rates.opacities),
            sh_dc: self.lr_sh_dc.unwrap_or(rates.sh_dc),
            sh_rest: self.lr_sh_rest.unwrap_or(rates.sh_rest),
            ..rates
        }
    }
}

fn positive(text: &str) -> Result<f64, &'static str> {
    let value = text.parse().ok().filter(|value: &f64| *value > 0.0 && value.is_finite());
    value.ok_or("expected a positive number, such as 0.001")
}

pub(crate) fn share(text: &str) -> Result<f64, &'static str> {
    text.parse().ok().filter(|value| (0.0..=1.0).contains(value)).ok_or("expected a number from 0 to 1")
}

/// Options of `splat resume`.
#[derive(Clone, Debug, clap::Args, Serialize)]
pub struct ResumeArgs {
    /// Output folder of the run: its `--out`
    #[arg(value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    #[serde(skip)]
    pub voice: VoiceArgs,
    #[command(flatten)]
    #[serde(skip)]
    pub live: LiveArgs,
}

fn usual_loss() -> String {
    USUAL_LOSS.into()
}

/// Parses `--strategy`; the help lists those with settings.
fn strategies() -> impl TypedValueParser<Value = StrategyName> {
    let all = StrategyName::value_variants().iter().filter_map(ValueEnum::to_possible_value);
    let registered = parts::names(Part::Strategy).into_iter().map(PossibleValue::new);
    PossibleValuesParser::new(all.chain(registered)).try_map(|name| name.parse::<StrategyName>())
}

impl TrainArgs {
    /// Gives a run the parts that its options take from the [registry](parts::Registry). An error if this program does not have them.
    pub(crate) fn supply(&self, mut trainer: Trainer) -> Result<Trainer> {
        if self.loss != USUAL_LOSS {
            trainer = parts::supply(trainer, Part::Loss, &self.loss)?;
        }
        if let StrategyName::Registered(name) = &self.strategy {
            trainer = parts::supply(trainer, Part::Strategy, name)?;
        }
        self.effects.registered.iter().try_fold(trainer, |trainer, name| parts::supply(trainer, Part::Effect, name))
    }

    /// Returns the configuration of the run, before effects are decided on. An error if an option is out of range or
    /// does not fit another. This is checked before any file is read or written.
    pub fn config(&self) -> Result<TrainConfig> {
        let mut config = TrainConfig { seed: self.seed, ..self.model.config() };
        config.opacity_weight = self.opacity_weight.unwrap_or(self.strategy.opacity_weight());
        config.batch = self.batch;
        if self.capture.is_none() {
            (config.steps, config.sh_degree) = (DEMO_STEPS, DEMO_SH_DEGREE);
        }
        let steps = self.time.map_or(self.steps.unwrap_or(config.steps), |_| GUESS);
        config = self.schedule(config, steps);
        config.sh_degree = self.sh_degree.unwrap_or(config.sh_degree);
        (config.moment_bits, config.plain) = (self.moment_bits, self.plain);
        config.lambda = self.ssim_weight;
        config.density = self.strategy.config().with_max_splats(self.max_splats);
        match (&mut config.density, self.grad_threshold) {
            (DensityConfig::Adaptive(config), Some(threshold)) => config.grad_threshold = threshold,
            (DensityConfig::Mcmc(_), Some(_)) => {
                bail!(
                    "`--strategy mcmc` splits by opacity and has no threshold: leave out `--grad-threshold`, or choose another strategy"
                )
            }
            (_, None) => {}
        }
        config.dials = config.dials.and(&self.accuracy.accuracy.setting());
        if let Some(mb) = self.cache_mb {
            config.cache_mib = config.cache_mib.min(mb.saturating_mul(1_000_000) >> 20);
        }
        config.check()?;
        Ok(config)
    }

    /// Returns the configuration with the schedules of a run of `steps` (see [`Trainer::reschedule`]).
    ///
    /// [`Trainer::reschedule`]: splat_model::trainer::Trainer::reschedule
    fn schedule(&self, config: TrainConfig, steps: usize) -> TrainConfig {
        let sh_every = self.sh_every.unwrap_or(sh_every_for(steps));
        let usual = if self.time.is_some() { Resolution::within_time(steps) } else { Resolution::FULL };
        let coarsest_divisor = self.coarsest.unwrap_or(usual.coarsest_divisor);
        let resolution = Resolution { coarsest_divisor, ..usual };
        let learning_rates = self.lr.over(LearningRates::for_steps(steps));
        TrainConfig { steps, sh_every, learning_rates, resolution, ..config }
    }
}

#[cfg(test)]
mod tests;
