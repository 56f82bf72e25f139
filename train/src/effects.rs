//! `--effects`: the effects that a run simulates, and their entry in `metrics.json`.

use std::fmt;
use std::str::FromStr;

use anyhow::{Result, ensure};
use serde::Serialize;
use splat_model::capture::Capture;
use splat_model::effects::background::Backdrop;
use splat_model::effects::depth::{self, DepthConfig};
use splat_model::effects::exposure::ExposureConfig;
use splat_model::effects::grid::GridConfig;
use splat_model::effects::optics::OpticsConfig;
use splat_model::effects::pose::{PoseConfig, anchors};
use splat_model::effects::{EffectKind, Plan, Survey};
use splat_model::trainer::{TrainConfig, Trainer};

use crate::background::{ENVIRONMENT_DEGREE, TrainBackground};
use crate::parts::{self, Part};
use crate::progress;

/// The value of `--effects`: `auto`, `none`, a list of effects, or `+name` and `-name`, which adjust the base given
/// first, by default `auto`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EffectsArg {
    /// Whether adjustments start from the effects that the capture calls for, instead of none.
    auto: bool,
    /// Effects switched on or off, in order; the last entry for an effect counts.
    adjustments: Vec<(EffectKind, bool)>,
    /// Effects of the [registry](parts::Registry) that are on.
    pub(crate) registered: Vec<String>,
    text: String,
}

impl Default for EffectsArg {
    fn default() -> Self {
        Self { auto: true, adjustments: Vec::new(), registered: Vec::new(), text: "auto".into() }
    }
}

impl fmt::Display for EffectsArg {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.text)
    }
}

impl FromStr for EffectsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut words = text.split(',').map(str::trim).peekable();
        let base = words.next_if(|word| ["auto", "none"].contains(word));
        let (mut adjustments, mut registered, mut listed) = (Vec::new(), Vec::new(), false);
        for word in words {
            let (name, on) = match word.strip_prefix('+') {
                Some(name) => (name, true),
                None => word.strip_prefix('-').map_or((word, true), |name| (name, false)),
            };
            listed |= name.len() == word.len();
            if parts::names(Part::Effect).contains(&name) {
                registered.retain(|other| other != name);
                registered.extend(on.then(|| name.to_owned()));
            } else {
                adjustments.push((name.parse()?, on));
            }
        }
        if listed && base == Some("auto") {
            return Err("`auto` is adjusted with `+name` and `-name`; a list of names stands alone".into());
        }
        let auto = base.map_or(!listed, |base| base == "auto");
        Ok(Self { auto, adjustments, registered, text: text.into() })
    }
}

impl EffectsArg {
    /// Returns the effects of a run, given those that the capture calls for.
    fn of(&self, called_for: &[EffectKind]) -> Vec<EffectKind> {
        let on = |effect: &EffectKind| {
            let adjusted = self.adjustments.iter().rev().find(|(name, _)| name == effect);
            adjusted.map_or(self.auto && called_for.contains(effect), |(_, on)| *on)
        };
        EffectKind::ALL.into_iter().filter(on).collect()
    }

    /// Decides on the effects for a capture, which is surveyed by its training views if `auto` needs it. `antialias`: whether that option
    /// was given. An error if a picture of the capture cannot be read, or the two options contradict each other.
    pub fn choose(&self, capture: &Capture, train: &[usize], antialias: bool) -> Result<ChosenEffects> {
        let adjusted = self.adjustments.iter().rev().find(|(effect, _)| *effect == EffectKind::Antialias);
        ensure!(
            !(antialias && adjusted.is_some_and(|(_, on)| !on)),
            "`--antialias` and `--effects={}` contradict each other: leave out one of them",
            self.text
        );
        let survey = self.auto.then(|| Survey::of_views(capture, train)).transpose()?;
        let plan = survey.as_ref().map(Plan::from);
        let mut on = self.of(&plan.as_ref().map_or(Vec::new(), Plan::effects));
        if antialias && !on.contains(&EffectKind::Antialias) {
            on.push(EffectKind::Antialias);
            on.sort();
        }
        ensure!(
            !(on.contains(&EffectKind::Alpha) && on.contains(&EffectKind::Environment)),
            "`--effects={}`: photographs with transparent parts show no environment to learn: leave out `alpha` or \
             `environment`",
            self.text
        );
        let registered = self.registered.iter().map(|name| &**name);
        let names = on.iter().map(|effect| effect.name()).chain(registered).collect::<Vec<_>>();
        let names = if names.is_empty() { "none".into() } else { names.join(", ") };
        let why = plan.as_ref().map(|_| format!(" (`splat inspect {}` says why)", capture.folder.display()));
        progress::note(&format!("effects: {names}{}", why.unwrap_or_default()));
        if plan.as_ref().and_then(Plan::sh_degree) == Some(0) {
            progress::note(
                "colours do not depend on the view: training with `--sh-degree 0`, unless that option is given",
            );
        }
        Ok(ChosenEffects { asked: self.text.clone(), on, registered: self.registered.clone(), plan, survey })
    }
}

/// The effects of a run, under `effects` in `metrics.json`.
#[derive(Clone, Debug, Serialize)]
pub struct ChosenEffects {
    /// The value of `--effects`, as written.
    pub asked: String,
    pub on: Vec<EffectKind>,
    /// Effects of the [registry](parts::Registry) that are on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    registered: Vec<String>,
    /// The plan; null where nothing was left to decide.
    pub plan: Option<Plan>,
    /// The survey that the plan is based on.
    #[serde(skip)]
    pub survey: Option<Survey>,
}

impl ChosenEffects {
    /// The effects of these names, as another rank of the run has chosen them. An error if a name is unknown.
    pub fn named(names: &[String]) -> Result<Self> {
        let on = names.iter().map(|name| name.parse()).collect::<Result<_, String>>().map_err(anyhow::Error::msg)?;
        Ok(Self { asked: names.join(","), on, registered: Vec::new(), plan: None, survey: None })
    }

    pub fn has(&self, effect: EffectKind) -> bool {
        self.on.contains(&effect)
    }

    /// The value of `--effects` that chooses them again.
    pub fn asked_again(&self) -> EffectsArg {
        let adjustments: Vec<_> = self.on.iter().map(|effect| (*effect, true)).collect();
        let (own, registered) = (self.on.iter().map(|effect| effect.name()), self.registered.clone());
        let names = own.chain(registered.iter().map(|name| &**name)).collect::<Vec<_>>().join(",");
        EffectsArg { auto: false, adjustments, registered, text: if names.is_empty() { "none".into() } else { names } }
    }

    /// Applies the effects to the configuration of a run; options given on the command line stay. `degree`: the degree
    /// of the spherical harmonics, if it was given.
    pub fn configure(&self, config: &mut TrainConfig, background: Option<TrainBackground>, degree: Option<usize>) {
        if let (None, Some(called_for)) = (degree, self.plan.as_ref().and_then(Plan::sh_degree)) {
            config.sh_degree = called_for;
        }
        config.antialias |= self.has(EffectKind::Antialias);
        config.smoothing |= self.has(EffectKind::Antialias);
        config.exposure = self.has(EffectKind::Exposure).then(ExposureConfig::default);
        config.grid = self.has(EffectKind::BilateralGrid).then(GridConfig::default);
        config.poses = self.has(EffectKind::PoseRefinement).then(PoseConfig::default);
        config.optics =
            OpticsConfig { motion: self.has(EffectKind::MotionBlur), rolling: self.has(EffectKind::RollingShutter) };
        config.depth = self.has(EffectKind::DepthSupervision).then(DepthConfig::default);
        match background {
            Some(background) => background.configure(config),
            None if self.has(EffectKind::Environment) => {
                config.backdrop = Backdrop::Environment { degree: ENVIRONMENT_DEGREE };
            }
            None if self.has(EffectKind::Alpha) => config.backdrop = Backdrop::Random,
            None => {}
        }
    }

    /// Gives the trainer the data that effects need beside the photographs: pose anchors and depth samples. An error if
    /// a depth map cannot be read.
    pub fn supply(&self, mut trainer: Trainer, capture: &Capture, views: &[usize]) -> Result<Trainer> {
        if self.has(EffectKind::PoseRefinement) {
            trainer = trainer.with_anchors(&anchors::from_tracks(capture, views));
        }
        if !self.has(EffectKind::DepthSupervision) {
            return Ok(trainer);
        }
        let samples =
            depth::from_maps(capture, views, progress::note)?.unwrap_or_else(|| depth::from_tracks(capture, views));
        Ok(trainer.with_depths(samples))
    }
}

#[cfg(test)]
mod tests;
