//! Which function a render computes, and how accurately: a preset, or whatever measured setting meets a target.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use burn::tensor::Device;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::accuracy::{Choice, Frontier, Preset, Provenance, Setting, Target, Work};
use splat_model::capture::Capture;
use splat_model::gaussians::GaussianRows;
use splat_model::trainer::TrainConfig;
use splat_op::{Order, Projection, RenderOptions};

use crate::pareto::{self, Shot};
use crate::progress;

/// What a scene is a function of: whoever shows one renders as it was trained.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct ModelArgs {
    /// Dim splats smaller than a pixel, so that scenes also look right from further away; a scene that was trained with it is
    /// evaluated and rendered with it too
    #[arg(long)]
    pub antialias: bool,
    /// What a pixel sees of a splat, for cameras without a lens; a scene is evaluated and rendered as it was trained
    #[arg(long, value_enum, value_name = "WHAT", default_value_t)]
    pub projection: SeenOfASplat,
    /// What is sorted by depth, for cameras without a lens; a scene is evaluated and rendered as it was trained
    #[arg(long, value_enum, value_name = "WHAT", default_value_t)]
    pub order: Sorted,
}

/// [`Projection`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum SeenOfASplat {
    /// Its ellipse: its projection, taken as affine around its centre
    #[default]
    Affine,
    /// Its greatest value along the pixel's ray; some ten times as slow
    Exact,
}

/// [`Order`] on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum Sorted {
    /// Splats, by their centres, once for the whole picture
    #[default]
    Centre,
    /// What each pixel sees of them, so that nothing pops as the camera turns; some twenty times as slow
    PerPixel,
}

impl ModelArgs {
    /// The configuration of a run that renders so, and is the usual one otherwise.
    pub fn config(&self) -> TrainConfig {
        TrainConfig { antialias: self.antialias, dials: self.dials(), ..TrainConfig::default() }
    }

    /// What is turned of the standard beside [`Self::antialias`].
    fn dials(&self) -> Setting {
        let projection = match self.projection {
            SeenOfASplat::Affine => Projection::Affine,
            SeenOfASplat::Exact => Projection::Exact,
        };
        let order = match self.order {
            Sorted::Centre => Order::Centre,
            Sorted::PerPixel => Order::PerPixel,
        };
        let standard = RenderOptions::standard();
        Setting::between(&standard, &standard.with_projection(projection).with_order(order))
    }
}

/// How accurate renders are.
#[derive(Clone, Debug, Default, clap::Args, Serialize, Deserialize)]
pub struct AccuracyArgs {
    /// How accurate renders are: fast, standard or exact
    #[arg(long, value_name = "PRESET", default_value_t, conflicts_with_all = ["target_error", "target_ms"])]
    pub accuracy: Preset,
    /// Take the cheapest setting whose PSNR against the exact render is at least this, dB
    #[arg(long, value_name = "DB")]
    pub target_error: Option<f64>,
    /// Take the most accurate setting whose frames take at most so many ms; with --target-error the cheapest that meets both
    #[arg(long, value_name = "MS")]
    pub target_ms: Option<f64>,
    /// With a target: the pareto.json that `splat pareto` left, measured on this device and scene, or when training on a scene of
    /// this capture. Without it a few settings are measured briefly: on the scene, or when training on what it has become after a
    /// tenth of the steps
    #[arg(long, value_name = "FILE")]
    pub frontier: Option<PathBuf>,
}

/// What the options come to before anything is measured.
#[derive(Clone, Debug, PartialEq)]
pub enum Accuracy {
    /// These dials are turned.
    Known(Setting),
    /// Whatever meets the target on the frontier of a file.
    Measured(Box<Frontier>, PathBuf, Target),
    /// Whatever meets this is to be found by measuring.
    ToMeasure(Target),
}

impl AccuracyArgs {
    /// What they say, on a device by the name that `metrics.json` has for it.
    ///
    /// # Errors
    /// If a target is no positive number, or the frontier cannot be read or is another device's.
    pub fn resolve(&self, device: &str) -> Result<Accuracy> {
        let target = Target { error_db: self.target_error, ms: self.target_ms };
        for (option, value) in [("--target-error", target.error_db), ("--target-ms", target.ms)] {
            let valid = value.is_none_or(|value| value.is_finite() && value > 0.0);
            ensure!(valid, "`{option}` is {}: give a positive number", value.unwrap_or_default());
        }
        let Some(path) = &self.frontier else {
            let preset = || Accuracy::Known(self.accuracy.setting());
            return Ok(if target.is_empty() { preset() } else { Accuracy::ToMeasure(target) });
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
        Ok(Accuracy::Measured(Box::new(frontier), path.clone(), target))
    }
}

/// What is rendered: a capture, the scene unless it is only going to be trained, and the mean number of pixels of a frame.
pub type Subject<'a> = (&'a Capture, Option<&'a GaussianRows>, usize);

impl Accuracy {
    /// The same, chosen from the frontier if there is one. Says which dials are turned, and why. `base` has the model choices.
    ///
    /// # Errors
    /// If the frontier is another scene's, or was measured under other model choices, or nothing on it meets the target.
    pub fn on(self, (capture, scene, pixels): Subject, base: &RenderOptions, work: Work) -> Result<Self> {
        let Self::Measured(frontier, path, target) = self else { return Ok(self) };
        let (path, of) = (path.display(), &frontier.provenance);
        const REMEDY: &str = "measure this one with `splat pareto`, or leave out `--frontier`";
        ensure!(
            of.capture == Provenance::of_capture(capture),
            "{path} was measured on another capture than {}: {REMEDY}",
            capture.folder.display()
        );
        if let Some(rows) = scene {
            ensure!(
                of.scene == Provenance::of_scene(rows),
                "{path} was measured on another scene of this capture, of {} splats, where this one has {}: {REMEDY}",
                frontier.splats,
                rows.len()
            );
        }
        let choices = Provenance::choices(base);
        ensure!(
            of.choices == choices,
            "{path} was measured with other model choices ({}) than these ({choices}): {REMEDY}, or give `--antialias`, \
             `--projection` and `--order` as they were",
            of.choices
        );
        if pixels.abs_diff(frontier.pixels) > frontier.pixels / 4 {
            progress::note(&format!(
                "{path} was measured on frames of {} pixels, and these have {pixels}: their times are others",
                frontier.pixels
            ));
        }
        Ok(Self::Known(chosen(frontier.choose(&target, work)?)))
    }

    /// The setting; measured briefly on a scene and some views of it where it is not known yet.
    ///
    /// # Errors
    /// If nothing that was measured meets the target, or measuring fails.
    pub fn setting(
        self,
        (rows, shots): (&GaussianRows, Vec<Shot>),
        base: &RenderOptions,
        device: (&Device, &str),
        work: Work,
    ) -> Result<Setting> {
        match self {
            Self::Known(setting) => Ok(setting),
            Self::Measured(_, path, _) => bail!("{} was not held to the scene", path.display()),
            Self::ToMeasure(target) => Ok(chosen(pareto::choose_briefly(rows, shots, base, device, (&target, work))?)),
        }
    }
}

/// Says what was chosen and why.
fn chosen(choice: Choice) -> Setting {
    progress::note(&format!("accuracy: {}", choice.why));
    choice.measured.turned
}
