//! How accurately is computed: a preset, or whatever measured setting meets a target.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use burn::tensor::Device;
use serde::{Deserialize, Serialize};
use splat_model::accuracy::{Choice, Frontier, Preset, Setting, Target, Work};
use splat_model::gaussians::GaussianRows;
use splat_op::RenderOptions;

use crate::pareto::{self, Shot};
use crate::progress;

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
    /// With a target: the pareto.json that `splat pareto` left, measured on this device. Without it a few settings are measured
    /// briefly: on the scene, or when training on what it has become after a tenth of the steps
    #[arg(long, value_name = "FILE")]
    pub frontier: Option<PathBuf>,
}

/// What the options come to before anything is measured.
#[derive(Clone, Debug, PartialEq)]
pub enum Accuracy {
    /// These dials are turned.
    Known(Setting),
    /// Whatever meets this is to be found by measuring.
    ToMeasure(Target),
}

impl AccuracyArgs {
    /// The setting, if it is known without measuring on `device`, as `metrics.json` calls it. Says which dials are turned
    /// for a target, and why.
    ///
    /// # Errors
    /// If a target is no positive number, the frontier cannot be read or is another device's, or nothing on it meets the target.
    pub fn resolve(&self, device: &str, work: Work) -> Result<Accuracy> {
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
        Ok(Accuracy::Known(chosen(frontier.choose(&target, work)?)))
    }
}

impl Accuracy {
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
            Self::ToMeasure(target) => Ok(chosen(pareto::choose_briefly(rows, shots, base, device, (&target, work))?)),
        }
    }
}

/// Says what was chosen and why.
fn chosen(choice: Choice) -> Setting {
    progress::note(&format!("accuracy: {}", choice.why));
    choice.measured.turned
}
