//! Choice of the function that a render computes and of its accuracy: a preset, or a measured setting that meets a
//! target.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::accuracy::{ChosenSetting, Frontier, Preset, Provenance, Setting, Spread, Target, Workload};
use splat_model::capture::Capture;
use splat_model::gaussians::GaussianRows;
use splat_model::trainer::TrainConfig;
use splat_op::{Projection, RenderOptions};

use crate::pareto::{self, UnmeasuredScene};
use crate::progress;

/// Model choices: the function that a scene's parameters define. A scene is rendered with the choices it was trained
/// with.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct ModelArgs {
    /// Dim splats smaller than a pixel, so that the scene also looks right from further away. Evaluate and render a
    /// scene with the setting it was trained with
    #[arg(long)]
    pub antialias: bool,
    /// How a splat contributes to a pixel. Evaluate and render a scene with the setting it was trained with
    #[arg(long, value_enum, value_name = "WHAT", default_value_t)]
    pub projection: ProjectionArg,
}

/// [`Projection`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum ProjectionArg {
    /// Projected ellipse: the projection is taken as affine around the splat's centre
    #[default]
    Affine,
    /// Largest value along the pixel's ray; about twice as slow
    RayMax,
}

impl ModelArgs {
    /// Returns the default configuration of a run with these model choices.
    pub fn config(&self) -> TrainConfig {
        TrainConfig { antialias: self.antialias, dials: self.dials(), ..TrainConfig::default() }
    }

    /// The dials turned from the standard setting, apart from [`Self::antialias`].
    fn dials(&self) -> Setting {
        let projection = match self.projection {
            ProjectionArg::Affine => Projection::Affine,
            ProjectionArg::RayMax => Projection::RayMax,
        };
        let standard = RenderOptions::standard();
        Setting::between(&standard, &standard.with_projection(projection))
    }
}

/// Accuracy of renders.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct AccuracyArgs {
    /// Accuracy preset: fast, standard or exact
    #[arg(long, value_name = "PRESET", default_value_t, conflicts_with_all = ["target_error", "target_ms"])]
    pub accuracy: Preset,
    /// Choose the cheapest setting whose PSNR against the exact render is at least this, dB
    #[arg(long, value_name = "DB")]
    pub target_error: Option<f64>,
    /// Choose the most accurate setting whose frames take at most this long, ms; with --target-error, the cheapest that
    /// meets both
    #[arg(long, value_name = "MS")]
    pub target_ms: Option<f64>,
    /// With a target: read settings from this pareto.json, written by `splat pareto` on this device and scene, or for
    /// training on a scene of this capture [default, and for another scene: measure briefly, on the scene or, when
    /// training, after a tenth of the steps]
    #[arg(long, value_name = "FILE")]
    pub frontier: Option<PathBuf>,
}

/// Accuracy options after parsing, before anything is measured.
#[derive(Clone, Debug, PartialEq)]
pub enum RequestedAccuracy {
    /// The dials to turn are known.
    Known(Setting),
    /// A setting that meets the target is to be chosen from the frontier in a file.
    Measured(Box<Frontier>, PathBuf, Target),
    /// A setting that meets the target is to be found by measuring.
    ToMeasure(Target),
}

/// Factor by which frames may take longer than `--target-ms` before this is reported.
const LATE: f64 = 1.25;

impl AccuracyArgs {
    /// Resolves the options. `device` is the device's name in `metrics.json`.
    ///
    /// # Errors
    /// If a target is not a positive number, or the frontier cannot be read or was measured on another device.
    pub fn resolve(&self, device: &str) -> Result<RequestedAccuracy> {
        let target = Target { error_db: self.target_error, ms: self.target_ms };
        for (option, value) in [("--target-error", target.error_db), ("--target-ms", target.ms)] {
            let valid = value.is_none_or(|value| value.is_finite() && value > 0.0);
            ensure!(valid, "`{option}` is {}: give a positive number", value.unwrap_or_default());
        }
        let Some(path) = &self.frontier else {
            let preset = || RequestedAccuracy::Known(self.accuracy.setting());
            return Ok(if target.is_empty() { preset() } else { RequestedAccuracy::ToMeasure(target) });
        };
        if target.is_empty() {
            bail!("`--frontier` without a target chooses nothing: add `--target-error DB` or `--target-ms MS`");
        }
        let frontier = Frontier::read(path)?;
        ensure!(
            frontier.device == device,
            "{} was measured on {}, and this is {device}: measure here with `splat pareto`, or leave out `--frontier`",
            path.display(),
            frontier.device
        );
        Ok(RequestedAccuracy::Measured(Box::new(frontier), path.clone(), target))
    }

    /// Says it if more than half of the frames took longer than the target, ms, by more than a quarter.
    pub fn late(&self, frames_ms: &[f64]) -> Option<String> {
        let (most, median) = (self.target_ms?, Spread::of(frames_ms)?.median);
        (median > LATE * most).then(|| {
            format!(
                "accuracy: half of the frames took {median:.2} ms or longer, more than the {most} ms of `--target-ms`: the machine \
                 was faster while settings were measured"
            )
        })
    }
}

/// Subject of a render: the capture, the scene if there is one already, and the mean number of pixels of a frame.
pub type AccuracySubject<'a> = (&'a Capture, Option<&'a GaussianRows>, usize);

impl RequestedAccuracy {
    /// Chooses from the frontier, if there is one, and prints which dials are turned and why. A frontier of another scene or of
    /// frames of another size promises nothing here: the choice is then left to [`Self::setting`]. `base` has the model
    /// choices.
    ///
    /// # Errors
    /// If the frontier was measured under other model choices, or nothing on it meets the target.
    pub fn on(self, (capture, scene, pixels): AccuracySubject, base: &RenderOptions, work: Workload) -> Result<Self> {
        let Self::Measured(frontier, path, target) = self else { return Ok(self) };
        let (path, of) = (path.display(), &frontier.provenance);
        let choices = Provenance::choices(base);
        ensure!(
            of.choices == choices,
            "{path} was measured with other model choices ({}) than these ({choices}): measure this scene with `splat pareto`, \
             or leave out `--frontier`, or give `--antialias` and `--projection` as they were",
            of.choices
        );
        let other = match scene {
            _ if of.capture != Provenance::of_capture(capture) => "another capture".into(),
            Some(rows) if of.scene != Provenance::of_scene(rows) => "another scene".into(),
            _ if pixels.abs_diff(frontier.pixels) > frontier.pixels / 4 => {
                format!("frames of {} pixels, and these have {pixels}", frontier.pixels)
            }
            _ => {
                let mut choice = frontier.choose(&target, work)?;
                choice.why.push_str(&pareto::beyond_f32(choice.measured.error_db));
                return Ok(Self::Known(chosen(choice)));
            }
        };
        progress::note(&format!("{path} was measured on {other}, and is not used"));
        Ok(Self::ToMeasure(target))
    }

    /// Returns the setting, after measuring it briefly on some views of the scene if it is not known yet.
    ///
    /// # Errors
    /// If no measured setting meets the target, or measuring fails.
    pub fn setting(self, scene: &UnmeasuredScene) -> Result<Setting> {
        match self {
            Self::Known(setting) => Ok(setting),
            Self::Measured(_, path, _) => bail!("{} was not checked against the scene", path.display()),
            Self::ToMeasure(target) => Ok(chosen(pareto::choose(scene, &target)?)),
        }
    }
}

/// Prints the choice and the reason for it.
fn chosen(choice: ChosenSetting) -> Setting {
    progress::note(&format!("accuracy: {}", choice.why));
    choice.measured.turned
}

/// Prints the error of a finished scene, rendered as it was trained, beside the error that was asked for. The scene may have
/// changed since its dials were chosen.
///
/// # Errors
/// If a view cannot be rendered.
pub fn note_reached(target_db: f64, scene: &UnmeasuredScene) -> Result<()> {
    let reached_db = pareto::error_db(scene, &scene.base, target_db)?;
    let kept = if reached_db < target_db { "less than" } else { "at least" };
    progress::note(&format!(
        "accuracy: the finished scene has {reached_db:.1} dB against the exact render, {kept} the {target_db} dB of `--target-error`"
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_miss_their_time_are_said_to() {
        let args = AccuracyArgs { target_ms: Some(10.0), ..AccuracyArgs::default() };
        assert_eq!(args.late(&[9.0, 12.4, 30.0]), None);
        assert!(args.late(&[9.0, 12.6, 13.0]).unwrap().contains("took 12.60 ms or longer, more than the 10 ms"));
        assert_eq!(args.late(&[]), None);
        assert_eq!(AccuracyArgs::default().late(&[1e9]), None);
    }
}
