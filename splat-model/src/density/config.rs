//! The choice of a density control strategy.

use serde::{Deserialize, Serialize};

use super::{Adaptive, AdaptiveConfig, Focus, Mcmc, McmcConfig, Strategy};

/// A strategy and its options.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "strategy", rename_all = "kebab-case")]
#[allow(clippy::large_enum_variant, reason = "a run has one, and copies it a few times")]
pub enum DensityConfig {
    /// Copies and splits Gaussians with large gradients, removes faint ones.
    Adaptive(AdaptiveConfig),
    /// Moves dead Gaussians to the positions of others.
    Mcmc(McmcConfig),
}

impl Default for DensityConfig {
    fn default() -> Self {
        Self::Adaptive(AdaptiveConfig::default())
    }
}

impl From<AdaptiveConfig> for DensityConfig {
    fn from(config: AdaptiveConfig) -> Self {
        Self::Adaptive(config)
    }
}

impl From<McmcConfig> for DensityConfig {
    fn from(config: McmcConfig) -> Self {
        Self::Mcmc(config)
    }
}

impl DensityConfig {
    /// Largest number of Gaussians.
    pub fn max_splats(&self) -> usize {
        let (Self::Adaptive(AdaptiveConfig { max_splats, .. }) | Self::Mcmc(McmcConfig { max_splats, .. })) = self;
        *max_splats
    }

    /// Share of the run after which Gaussians are neither added nor removed.
    pub fn until_share(&self) -> f64 {
        let (Self::Adaptive(AdaptiveConfig { until_share, .. }) | Self::Mcmc(McmcConfig { until_share, .. })) = self;
        *until_share
    }

    /// The same options with another cap.
    pub fn with_max_splats(mut self, most: usize) -> Self {
        let (Self::Adaptive(AdaptiveConfig { max_splats, .. }) | Self::Mcmc(McmcConfig { max_splats, .. })) = &mut self;
        *max_splats = most;
        self
    }

    /// The same options with growth in a part of the scene only. MCMC draws by opacity, not by place, and stays as it is.
    pub fn focused(self, focus: Option<Focus>) -> Self {
        match self {
            Self::Adaptive(config) => AdaptiveConfig { focus, ..config }.into(),
            mcmc @ Self::Mcmc(_) => mcmc,
        }
    }

    /// The strategy for a run of `steps` on a scene of `extent` (see [`crate::optim::scene_extent`]).
    pub fn strategy(&self, extent: f64, steps: usize) -> Box<dyn Strategy> {
        match self {
            Self::Adaptive(config) => Box::new(Adaptive::new(*config, extent, steps)),
            Self::Mcmc(config) => Box::new(Mcmc::new(*config, extent, steps)),
        }
    }
}

#[cfg(test)]
mod tests;
