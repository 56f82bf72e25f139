//! Losses, strategies, effects and formats of captures by name: the program's own, and those of a program that calls [`main_with`](crate::registry::main_with).

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::sync::{Arc, OnceLock};

use anyhow::{Result, anyhow};
use clap::ValueEnum;
use splat_model::capture::{self, CaptureFormat};
use splat_model::density::{AdaptiveConfig, DensityConfig, GRADUAL_OPACITY_WEIGHT, McmcConfig, Strategy};
use splat_model::effects::{Effect, EffectKind};
use splat_model::loss::{l1, photometric};
use splat_model::trainer::{Loss, LossInputs, SurfaceLoss, TrainError, Trainer};

/// Name of the loss of a run that asks for none.
pub const USUAL_LOSS: &str = "l1-ssim";

/// The option that chooses a part of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    Loss,
    Strategy,
    Effect,
}

type Supply = Box<dyn Fn(Trainer) -> Result<Trainer> + Send + Sync>;

/// Parts of runs by the names that `--loss`, `--strategy` and `--effects` take.
///
/// Names are words without commas. Adding a part panics if the name is taken, by the program too.
///
/// A program with a loss of its own:
///
/// ```no_run
/// use splat_model::trainer::LossInputs;
/// use splat_train::registry::{Registry, main_with};
///
/// splat_train::allocator!();
///
/// fn main() -> std::process::ExitCode {
///     // `mine train CAPTURE --loss squares`; all other options and subcommands are those of `splat`.
///     let squares = || |seen: &LossInputs| (seen.image.clone() - seen.truth.image()).square().mean();
///     main_with(Registry::new().loss("squares", squares))
/// }
/// ```
pub struct Registry {
    parts: BTreeMap<(Part, String), Supply>,
    formats: Vec<Arc<dyn CaptureFormat>>,
}

impl Default for Registry {
    fn default() -> Self {
        Self::new()
    }
}

impl Registry {
    /// The losses of `splat`. Its strategies and effects have options of their own and are no part of it.
    pub fn new() -> Self {
        let usual = |trainer: Trainer| {
            let lambda = trainer.config().lambda;
            Ok(trainer.with_loss(move |seen: &LossInputs| photometric(seen.image.clone(), seen.truth, lambda)))
        };
        let none = Self { parts: BTreeMap::new(), formats: Vec::new() };
        let surfaces = |trainer: Trainer| {
            let loss = SurfaceLoss::new(trainer.config().lambda, trainer.config().steps);
            Ok(trainer.with_loss(loss))
        };
        none.with(Part::Loss, USUAL_LOSS, usual)
            .with(Part::Loss, "surfaces", surfaces)
            .loss("l1", || |seen: &LossInputs| l1(seen.image.clone(), seen.truth.image()))
            .loss("l2", || |seen: &LossInputs| (seen.image.clone() - seen.truth.image()).square().mean())
    }

    fn with(
        mut self,
        part: Part,
        name: &str,
        change: impl Fn(Trainer) -> Result<Trainer> + Send + Sync + 'static,
    ) -> Self {
        let odd = ["", "auto", "none"].contains(&name) || name.starts_with(['+', '-']) || name.contains([',', ' ']);
        assert!(!odd, "{name:?} is no name that an option can take");
        let is_own = match part {
            Part::Loss => false,
            Part::Strategy => StrategyName::value_variants().iter().any(|own| own.to_string() == name),
            Part::Effect => name.parse::<EffectKind>().is_ok(),
        };
        let before = self.parts.insert((part, name.to_owned()), Box::new(change));
        assert!(!is_own && before.is_none(), "there are two parts named `{name}`");
        self
    }

    /// Adds a loss, which a run makes at its start.
    pub fn loss<L: Loss + 'static>(self, name: &str, make: impl Fn() -> L + Send + Sync + 'static) -> Self {
        self.with(Part::Loss, name, move |trainer| Ok(trainer.with_loss(make())))
    }

    /// Adds a loss that needs more of a run than itself, such as a group of parameters: `set` gives a trainer both.
    pub fn loss_with(
        self,
        name: &str,
        set: impl Fn(Trainer) -> Result<Trainer, TrainError> + Send + Sync + 'static,
    ) -> Self {
        self.with(Part::Loss, name, move |trainer| Ok(set(trainer)?))
    }

    /// Adds a density strategy, for a run of a number of steps on a scene of an extent (see
    /// [`scene_extent`](splat_model::optim::scene_extent)).
    pub fn strategy<S: Strategy + 'static>(
        self,
        name: &str,
        make: impl Fn(f64, usize) -> S + Send + Sync + 'static,
    ) -> Self {
        self.with(Part::Strategy, name, move |trainer| {
            let strategy = make(trainer.extent(), trainer.config().steps);
            Ok(trainer.with_strategy(strategy)?)
        })
    }

    /// Adds an effect, made from the trainer of a run. `--effects` never chooses it by itself.
    pub fn effect<E: Effect>(self, name: &str, make: impl Fn(&Trainer) -> E + Send + Sync + 'static) -> Self {
        self.with(Part::Effect, name, move |trainer| {
            let effect = make(&trainer);
            Ok(trainer.with_effect(effect))
        })
    }

    /// Adds a format of captures, which is tried before those of the program.
    pub fn capture_format(mut self, format: impl CaptureFormat + 'static) -> Self {
        self.formats.push(Arc::new(format));
        self
    }

    /// The names of a part, in alphabetical order.
    fn names(&self, part: Part) -> Vec<&str> {
        self.parts.keys().filter(|(of, _)| *of == part).map(|(_, name)| &**name).collect()
    }
}

static REGISTRY: OnceLock<Registry> = OnceLock::new();

/// Makes a registry that of the program. The first one stays.
pub(crate) fn install(registry: Registry) {
    let formats = registry.formats.clone();
    if REGISTRY.set(registry).is_ok() {
        formats.into_iter().for_each(capture::register);
    }
}

fn registry() -> &'static Registry {
    REGISTRY.get_or_init(Registry::new)
}

/// The names that this program has for a part.
pub(crate) fn names(part: Part) -> Vec<&'static str> {
    registry().names(part)
}

/// Gives a run the part of that name. An error if there is none, as for a checkpoint of another program.
pub(crate) fn supply(trainer: Trainer, part: Part, name: &str) -> Result<Trainer> {
    let change = registry().parts.get(&(part, name.to_owned()));
    let change = change.ok_or_else(|| {
        let option = format!("{part:?}").to_lowercase();
        anyhow!("this program has no {option} `{name}`: continue with the program that began the run")
    })?;
    change(trainer)
}

/// Density strategies by name. All but `gradual` have their published settings.
#[derive(Clone, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum StrategyName {
    /// From early on, split a tenth of the splats at a time, those with the largest gradients, in two halves across their
    /// longest axis (after Improved-GS, Deng et al. 2025), and remove faint ones
    #[default]
    Gradual,
    /// Clone and split splats with large gradients, and remove faint ones (Kerbl et al. 2023)
    Adaptive,
    /// Like adaptive, but with absolute gradients, which find splats that blur fine detail (AbsGS, Ye et al. 2024)
    Absgrad,
    /// Move faint splats to others and grow by 5% at a time, up to `--max-splats`, which should be chosen for the
    /// capture (3DGS-MCMC, Kheradmand et al. 2024)
    Mcmc,
    /// One of the [`Registry`], which replaces the settings of `gradual`.
    #[value(skip)]
    Registered(String),
}

impl fmt::Display for StrategyName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self, self.to_possible_value()) {
            (Self::Registered(name), _) => f.write_str(name),
            (_, value) => f.write_str(value.as_ref().map_or("", |value| value.get_name())),
        }
    }
}

impl FromStr for StrategyName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let registered = names(Part::Strategy);
        match <Self as ValueEnum>::from_str(text, false) {
            Err(_) if registered.contains(&text) => Ok(Self::Registered(text.to_owned())),
            Err(_) => {
                let own = Self::value_variants().iter().map(ToString::to_string);
                let all: Vec<String> = own.chain(registered.into_iter().map(String::from)).collect();
                Err(format!("this program has no strategy `{text}`, only {}", all.join(", ")))
            }
            found => found,
        }
    }
}

impl StrategyName {
    /// Returns its settings.
    pub fn config(&self) -> DensityConfig {
        match self {
            Self::Gradual | Self::Registered(_) => AdaptiveConfig::gradual().into(),
            Self::Adaptive => AdaptiveConfig::default().into(),
            Self::Absgrad => AdaptiveConfig::absgrad().into(),
            Self::Mcmc => McmcConfig::default().into(),
        }
    }

    /// Returns the weight of the mean opacity in the loss that belongs to it. MCMC adds its own.
    pub fn opacity_weight(&self) -> f64 {
        if *self == Self::Gradual { GRADUAL_OPACITY_WEIGHT } else { 0.0 }
    }
}

#[cfg(test)]
mod tests;
