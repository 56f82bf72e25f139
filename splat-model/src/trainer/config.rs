//! The options of a run, and whether they fit together.

use serde::{Deserialize, Deserializer};
use splat_op::sh::SH_DEGREE_MAX;
use splat_op::{Projection, RenderOptions};

use super::{Resolution, Result, TrainError};
use crate::accuracy::Setting;
use crate::density::{AdaptiveConfig, DensityConfig, GRADUAL_OPACITY_WEIGHT};
use crate::effects::background::Backdrop;
use crate::effects::depth::DepthConfig;
use crate::effects::exposure::ExposureConfig;
use crate::effects::grid::GridConfig;
use crate::effects::optics::OpticsConfig;
use crate::effects::pose::PoseConfig;
use crate::loss::DEFAULT_LAMBDA;
use crate::optim::schedule::STEPS_PER_SH_DEGREE;
use crate::optim::{LearningRates, MomentBits, near_plane, sh_every_for};

options! {
    /// All options of a run. Defaults are those of the original implementation; [`Self::for_steps`] gives those of `splat train`.
    pub struct TrainConfig {
        /// Number of steps: 30,000.
        pub steps: usize = 30_000,
        /// Photographs per step: 1. Learning rates and Adam's constants follow the square-root scaling rule (see
        /// [`crate::optim::Adam::for_batch`]). The number of steps and all schedules in steps stay unchanged.
        pub batch: usize = 1,
        /// Seed of all random numbers.
        pub seed: u64 = 0,
        /// Weight of D-SSIM in the loss: 0.2.
        pub lambda: f64 = DEFAULT_LAMBDA,
        /// Highest degree of the spherical harmonics: 3.
        pub sh_degree: usize = 3,
        /// Steps between increases of the degree by one: 1,000.
        pub sh_every: usize = STEPS_PER_SH_DEGREE,
        /// Learning rates.
        pub learning_rates: LearningRates = LearningRates::default(),
        /// Bits of each of Adam's moments of the scene: 32. They are half of a scene's memory in training.
        pub moment_bits: MomentBits = MomentBits::default(),
        /// Strategy of density control and its options.
        pub density: DensityConfig = DensityConfig::default(),
        /// Whether steps take nothing but the rasterizer as custom operations (see [`splat_op::in_tensor_code`]): false. Results are the same
        /// up to rounding, and several times slower.
        pub plain: bool = false,
        /// Schedule of the photographs' size.
        pub resolution: Resolution = Resolution::FULL,
        /// The background behind the Gaussians and behind photographs with alpha: RGB, 0 to 1. The initial value of a learned background.
        #[serde(deserialize_with = "finite_colour")]
        pub background: [f32; 3] = [0.0; 3],
        /// Whether opacities are compensated for the screen-space blur (see [`RenderOptions::antialias`]).
        pub antialias: bool = false,
        /// Dials of the renders that differ from the standard: none.
        pub dials: Setting = Setting::default(),
        /// Whether Gaussians are limited to the photographs' sampling rate (see [`smoothing`](crate::effects::smoothing)).
        pub smoothing: bool = false,
        /// The kind of background: [`Self::background`].
        pub backdrop: Backdrop = Backdrop::Fixed,
        /// Options of learned exposures: off.
        pub exposure: Option<ExposureConfig> = None,
        /// Options of bilateral grids: off.
        pub grid: Option<GridConfig> = None,
        /// Options of pose refinement: off.
        pub poses: Option<PoseConfig> = None,
        /// The simulated effects of motion and optics: none.
        pub optics: OpticsConfig = OpticsConfig::default(),
        /// Options of depth supervision (see [`Trainer::with_depths`](super::Trainer::with_depths)): off.
        pub depth: Option<DepthConfig> = None,
        /// Weight of the mean opacity in the loss: 0 for none, 0.01 in MCMC (Kheradmand et al. 2024), which adds its own. Gaussians that no
        /// photograph needs, mainly floaters in front of the background, then fade and are pruned. The weight ends with
        /// [`DensityConfig::until_share`]: what fades later would stay, and all others would be fainter than photographs show.
        pub opacity_weight: f64 = 0.0,
        /// Memory for prepared photographs, MiB: 512. On a CPU, photographs beyond it are prepared again at each use. On a GPU where not
        /// all prepared photographs fit, they are stored in four bytes per pixel, and those beyond the limit are uploaded again.
        pub cache_mib: usize = 512,
    }
}

/// Numbers beyond the range of f32 become infinite, which is unusable in training and in JSON.
fn finite_colour<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f32; 3], D::Error> {
    let colour = <[f32; 3]>::deserialize(deserializer)?;
    match colour.iter().all(|value| value.is_finite()) {
        true => Ok(colour),
        false => Err(serde::de::Error::custom(format!("a colour of {colour:?}, expected three finite f32 numbers"))),
    }
}

impl TrainConfig {
    /// The options with which `splat train` runs for `steps`.
    pub fn for_steps(steps: usize) -> Self {
        Self::default().with_steps(steps)
    }

    /// The same options for a run of `steps`. Learning rates and the schedule of degrees are replaced by those for this length, density
    /// control and the weight on opacity by those of `splat train`.
    pub fn with_steps(self, steps: usize) -> Self {
        Self {
            steps,
            sh_every: sh_every_for(steps),
            learning_rates: LearningRates::for_steps(steps),
            density: AdaptiveConfig::gradual().into(),
            opacity_weight: GRADUAL_OPACITY_WEIGHT,
            ..self
        }
    }

    /// The weight on opacity at `step`, counted from 1.
    pub(super) fn opacity_weight_at(&self, step: usize) -> f64 {
        let prunes_later = (step as f64) < self.density.until_share() * self.steps as f64;
        if prunes_later { self.opacity_weight } else { 0.0 }
    }

    /// Render options of a run whose cameras see a scene of `extent` (see [`scene_extent`](crate::optim::scene_extent)).
    pub fn render_options(&self, extent: f64) -> RenderOptions {
        self.dials.apply(RenderOptions::standard().with_antialias(self.antialias).with_near(near_plane(extent)))
    }

    /// Checks each option and whether they can be combined.
    ///
    /// # Errors
    /// If an option is out of range, if effects on ellipses are combined with a render that has no ellipses, or moments of few bits with tensor
    /// code.
    pub fn check(&self) -> Result<()> {
        let along_rays = self.dials.apply(RenderOptions::standard()).projection != Projection::Affine;
        let refuse = |what: String| Err(TrainError::Option(what));
        match () {
            () if self.steps == 0 => Err(TrainError::NoSteps),
            () if self.batch == 0 => refuse("`batch` is 0, expected at least 1: give `--batch N`".into()),
            () if !self.resolution.is_valid() => Err(TrainError::Resolution(self.resolution)),
            () if self.sh_degree > SH_DEGREE_MAX => refuse(format!("`sh_degree` is {}, expected 0 to 4", self.sh_degree)),
            () if along_rays && self.optics.any() => refuse(
                "motion blur and rolling shutters change ellipses on the screen, which `--projection ray-max` does not \
                 compute: leave out one of them (`--effects=-NAME`)"
                    .into(),
            ),
            () if self.plain && self.moment_bits != MomentBits::ThirtyTwo => refuse(format!(
                "`moment_bits` is {} and `plain` is set, expected 32 bits: those of fewer have no tensor code",
                self.moment_bits
            )),
            () => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests;
