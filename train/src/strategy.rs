//! `--strategy` chooses a density strategy, which adds, moves and removes splats.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::density::{AdaptiveConfig, DensityConfig, GRADUAL_OPACITY_WEIGHT, McmcConfig};

/// Density strategies by name. All but `gradual` have their published settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
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
}

impl StrategyName {
    /// Returns its settings.
    pub fn config(self) -> DensityConfig {
        match self {
            Self::Gradual => AdaptiveConfig::gradual().into(),
            Self::Adaptive => AdaptiveConfig::default().into(),
            Self::Absgrad => AdaptiveConfig::absgrad().into(),
            Self::Mcmc => McmcConfig::default().into(),
        }
    }

    /// Returns the weight of the mean opacity in the loss that belongs to it. MCMC adds its own.
    pub fn opacity_weight(self) -> f64 {
        if self == Self::Gradual { GRADUAL_OPACITY_WEIGHT } else { 0.0 }
    }
}
