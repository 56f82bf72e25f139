//! Losses, strategies and effects by name: the program's own, and those of a program that calls [`main_with`].

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::OnceLock;

use anyhow::{Result, anyhow};
use clap::ValueEnum;
use splat_model::density::Strategy;
use splat_model::effects::{Effect, EffectKind};
use splat_model::loss::{l1, photometric};
use splat_model::trainer::{Loss, LossInputs, Trainer};

use crate::strategy::StrategyName;
use crate::train::Interrupted;
use crate::{options, ranks};

/// Name of the loss of a run that asks for none.
pub const USUAL_LOSS: &str = "l1-ssim";

/// The option that chooses a part of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    Loss,
    Strategy,
    Effect,
}

type Change = Box<dyn Fn(Trainer) -> Result<Trainer> + Send + Sync>;

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
pub struct Registry(BTreeMap<(Part, String), Change>);

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
        let none = Self(BTreeMap::new());
        none.with(Part::Loss, USUAL_LOSS, usual)
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
        let before = self.0.insert((part, name.to_owned()), Box::new(change));
        assert!(!is_own && before.is_none(), "there are two parts named `{name}`");
        self
    }

    /// Adds a loss, which a run makes at its start.
    pub fn loss<L: Loss + 'static>(self, name: &str, make: impl Fn() -> L + Send + Sync + 'static) -> Self {
        self.with(Part::Loss, name, move |trainer| Ok(trainer.with_loss(make())))
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

    /// The names of a part, in alphabetical order.
    fn names(&self, part: Part) -> Vec<&str> {
        self.0.keys().filter(|(of, _)| *of == part).map(|(_, name)| &**name).collect()
    }
}

static REGISTRY: OnceLock<Registry> = OnceLock::new();

fn registry() -> &'static Registry {
    REGISTRY.get_or_init(Registry::new)
}

/// The names that this program has for a part.
pub(crate) fn names(part: Part) -> Vec<&'static str> {
    registry().names(part)
}

/// Gives a run the part of that name.
///
/// # Errors
/// If there is none, as for a checkpoint of another program.
pub(crate) fn supply(trainer: Trainer, part: Part, name: &str) -> Result<Trainer> {
    let change = registry().0.get(&(part, name.to_owned()));
    let change = change.ok_or_else(|| {
        let option = format!("{part:?}").to_lowercase();
        anyhow!("this program has no {option} `{name}`: continue with the program that began the run")
    })?;
    change(trainer)
}

/// Silences GPU drivers, which look for a Wayland display: its library prints an error where nobody is logged in to a
/// desktop and this variable is unset or empty.
fn quieten_wayland() {
    const FOLDER: &str = "XDG_RUNTIME_DIR";
    if cfg!(target_os = "linux") && std::env::var_os(FOLDER).is_none_or(|folder| folder.is_empty()) {
        // SAFETY: no other thread exists yet that could read the environment.
        unsafe { std::env::set_var(FOLDER, "/nonexistent") };
    }
}

/// Runs the program `splat` on the command line of the process, with the parts of a registry beside its own. Call it once, as all of
/// `main`.
///
/// Exit codes: 0 on success, 1 on an error, 2 (from clap) for an invalid command line, 130 and 143 for a run stopped by
/// Ctrl-C and SIGTERM.
pub fn main_with(registry: Registry) -> ExitCode {
    main_of(registry, std::env::args_os())
}

/// [`main_with`] on other words than those of the process. For tests.
#[doc(hidden)]
pub fn main_of(registry: Registry, words: impl IntoIterator<Item = OsString>) -> ExitCode {
    // A second call would find the names of the first.
    let _ = REGISTRY.set(registry);
    quieten_wayland();
    match options::parse(words).and_then(|cli| crate::run(&cli.command)) {
        Ok(()) => {
            ranks::leave();
            ExitCode::SUCCESS
        }
        Err(error) => {
            if let Some(error) = error.downcast_ref::<clap::Error>() {
                // Help, the version, or an invalid command line.
                error.exit();
            }
            if let Some(interrupted) = error.downcast_ref::<Interrupted>() {
                ranks::say(&interrupted.to_string());
                ranks::leave();
                return interrupted.exit_code().into();
            }
            ranks::say(&crate::describe(&error));
            ranks::abort(1);
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests;
