//! `--strategy`: density strategies, which add, move and remove splats.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::density::{AdaptiveConfig, DensityConfig, McmcConfig};

/// Density strategies by name, each with its published settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum StrategyName {
    /// Clone and split splats with large gradients, and remove faint ones (Kerbl et al. 2023)
    #[default]
    Adaptive,
    /// Like adaptive, but with absolute gradients, which find splats that blur fine detail (AbsGS, Ye et al. 2024)
    Absgrad,
    /// Like adaptive, but densify only where several views show an error, and remove splats that hardly show in any
    /// view (after FastGS, Ren et al. 2025)
    Consistent,
    /// Move faint splats to others and grow by 5% at a time, up to `--max-splats`, which should be chosen for the
    /// capture (3DGS-MCMC, Kheradmand et al. 2024)
    Mcmc,
}

impl StrategyName {
    /// Returns its settings.
    pub fn config(self) -> DensityConfig {
        match self {
            Self::Adaptive => AdaptiveConfig::default().into(),
            Self::Absgrad => AdaptiveConfig::absgrad().into(),
            Self::Consistent => AdaptiveConfig::consistent().into(),
            Self::Mcmc => McmcConfig::default().into(),
        }
    }
}
