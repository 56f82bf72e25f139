//! What a run depends on besides its photographs.

use serde::{Deserialize, Deserializer, Serialize};
use splat_op::RenderOptions;

use super::Resolution;
use crate::accuracy::Setting;
use crate::density::DensityConfig;
use crate::effects::background::Backdrop;
use crate::effects::depth::DepthConfig;
use crate::effects::exposure::ExposureConfig;
use crate::effects::grid::GridConfig;
use crate::effects::optics::OpticsConfig;
use crate::effects::pose::PoseConfig;
use crate::loss::DEFAULT_LAMBDA;
use crate::optim::schedule::STEPS_PER_SH_DEGREE;
use crate::optim::{LearningRates, near_plane};

/// All that a run depends on besides its photographs. Defaults are those of the original implementation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Steps: 30,000.
    pub steps: usize,
    /// Photographs in each of them: 1. More of them grow learning rates and Adam's memory as the field has it; steps, and what is
    /// counted in steps, stay what they are.
    pub batch: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Share of D-SSIM in the loss: 0.2.
    pub lambda: f64,
    /// Highest degree of the spherical harmonics: 3.
    pub sh_degree: usize,
    /// Steps until the degree rises by one: 1,000.
    pub sh_every: usize,
    /// Learning rates.
    pub learning_rates: LearningRates,
    /// Density control, and its strategy.
    pub density: DensityConfig,
    /// How large photographs are as the run goes on.
    pub resolution: Resolution,
    /// What shows through the Gaussians, and through photographs with alpha: RGB, 0 to 1. Where another background is learnt,
    /// what it begins as.
    #[serde(deserialize_with = "finite_colour")]
    pub background: [f32; 3],
    /// Whether opacities are compensated for the blur (see [`RenderOptions::antialias`]).
    pub antialias: bool,
    /// Dials of the renders that are turned from the standard: none.
    pub dials: Setting,
    /// Whether Gaussians are kept as coarse as the photographs sample them (see [`smoothing`](crate::effects::smoothing)).
    pub smoothing: bool,
    /// What else is behind the Gaussians than [`Self::background`]: nothing else.
    pub backdrop: Backdrop,
    /// Whether and how each photograph learns an exposure of its own: not at all.
    pub exposure: Option<ExposureConfig>,
    /// Whether and how each photograph learns a grid of colour maps: not at all.
    pub grid: Option<GridConfig>,
    /// Whether and how poses are refined: not at all.
    pub poses: Option<PoseConfig>,
    /// Which of the things that happen while a photograph is taken are simulated: none.
    pub optics: OpticsConfig,
    /// Whether and how known depths are learnt from (see [`Trainer::with_depths`](super::Trainer::with_depths)): not at all.
    pub depth: Option<DepthConfig>,
    /// Weight of the mean opacity in the loss: 0 for none, 0.01 as MCMC has it (Kheradmand et al. 2024). Gaussians that no
    /// photograph asks for, floaters in front of the background above all, then fade and are pruned.
    pub opacity_weight: f64,
    /// Memory for photographs prepared for the loss, MiB: 512. On a CPU those beyond it are prepared again at each use; on a
    /// GPU, where they do not all fit, they are kept there in four bytes per pixel, and those beyond it are uploaded again.
    pub cache_mib: usize,
}

/// A number beyond f32 becomes an infinity, which can neither be trained with nor be written as JSON.
fn finite_colour<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f32; 3], D::Error> {
    let colour = <[f32; 3]>::deserialize(deserializer)?;
    match colour.iter().all(|value| value.is_finite()) {
        true => Ok(colour),
        false => Err(serde::de::Error::custom(format!("a colour of {colour:?}, expected three finite f32 numbers"))),
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            steps: 30_000,
            batch: 1,
            seed: 0,
            lambda: DEFAULT_LAMBDA,
            sh_degree: 3,
            sh_every: STEPS_PER_SH_DEGREE,
            learning_rates: LearningRates::default(),
            density: DensityConfig::default(),
            resolution: Resolution::FULL,
            background: [0.0; 3],
            antialias: false,
            dials: Setting::default(),
            smoothing: false,
            backdrop: Backdrop::Fixed,
            exposure: None,
            grid: None,
            poses: None,
            optics: OpticsConfig::default(),
            depth: None,
            opacity_weight: 0.0,
            cache_mib: 512,
        }
    }
}

impl TrainConfig {
    /// The learning rates of a step.
    pub(super) fn step_rates(&self) -> LearningRates {
        self.learning_rates.for_batch(self.batch)
    }

    /// How a run whose cameras see a scene of `extent` renders (see [`scene_extent`](crate::optim::scene_extent)).
    pub fn render_options(&self, extent: f64) -> RenderOptions {
        self.dials.apply(RenderOptions::standard().with_antialias(self.antialias).with_near(near_plane(extent)))
    }
}
