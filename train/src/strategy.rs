//! `--strategy` chooses a density strategy, which adds, moves and removes splats.

use std::fmt;
use std::str::FromStr;

use clap::ValueEnum;
use splat_model::density::{AdaptiveConfig, DensityConfig, GRADUAL_OPACITY_WEIGHT, McmcConfig};

use crate::registry::{self, Part};

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
    /// One of the [`registry`], which replaces the settings of `gradual`.
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
        let registered = registry::names(Part::Strategy);
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
