//! `--strategy`: how splats are added, moved and removed.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use splat_model::density::{AdaptiveConfig, DensityConfig, McmcConfig};

/// The strategies by name, each with the settings that were published with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum StrategyName {
    /// Copy and split where gradients are large, remove what is faint (Kerbl et al. 2023)
    #[default]
    Adaptive,
    /// The same by absolute gradients, which finds splats that blur fine detail (AbsGS, Ye et al. 2024)
    Absgrad,
    /// As adaptive, but only where several views find the picture wrong, and without splats that hardly show in any (in the manner
    /// of FastGS, Ren et al. 2025)
    Consistent,
    /// Move faint splats to where others are and grow by 5% at a time, up to `--max-splats`, which is to be chosen for the capture
    /// (3DGS-MCMC, Kheradmand et al. 2024)
    Mcmc,
}

impl StrategyName {
    /// Its settings.
    pub fn config(self) -> DensityConfig {
        match self {
            Self::Adaptive => AdaptiveConfig::default().into(),
            Self::Absgrad => AdaptiveConfig::absgrad().into(),
            Self::Consistent => AdaptiveConfig::consistent().into(),
            Self::Mcmc => McmcConfig::default().into(),
        }
    }
}
