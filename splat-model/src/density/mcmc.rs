//! 3D Gaussian splatting as Markov chain Monte Carlo (Kheradmand et al. 2024): Gaussians are samples with noise on their positions, faded
//! ones are moved to the positions of others, and their number grows to a cap by a schedule instead of a threshold.

mod relocate;

use burn::tensor::{DType, Device, Int, Tensor, activation::sigmoid};
use rand::{Rng, RngExt};
use splat_op::{Splats, read_back};

use self::relocate::share;
use super::noise::{Noise, apart};
use super::order::z_order;
use super::pick::{counts, ones, picked, repeated, rounded_down, rows_on, running_sums};
use super::rotate::{rotated, unit};
use super::rows::{RowEdit, Trained};
use super::strategy::{RefineReport, Refined, Strategy, StrategyContext};
use crate::gaussians::{GaussianRows, Gaussians, logit};
use crate::loss::regularise;
use crate::state::{State, StateError};

options! {
    /// Options of MCMC density control. Defaults are those of the paper and its code.
    ///
    /// That code assumes scenes some units across and uses their unit directly. Here lengths are in units of the scene extent
    /// (see [`crate::optim::scene_extent`]), so that training does not depend on the unit of a scene.
    #[derive(Copy)]
    pub struct McmcConfig {
        /// Steps between refinements: 100.
        pub every: usize = 100,
        /// First step of refinement: 500.
        pub from: usize = 500,
        /// Share of the run after which Gaussians are neither moved nor added: 5/6. The noise continues to the end.
        pub until_share: f64 = 5.0 / 6.0,
        /// Growth factor of the number of Gaussians at each refinement: 1.05.
        pub growth: f64 = 1.05,
        /// Largest number of Gaussians.
        pub max_splats: usize = 1_000_000,
        /// Largest opacity of a dead Gaussian, which is moved: 0.005.
        pub dead_opacity: f64 = 0.005,
        /// Scale of the noise on positions, in multiples of the centres' learning rate: 5e5.
        pub noise: f64 = 5e5,
        /// Weight of the mean opacity in the loss: 0.01.
        pub opacity_weight: f64 = 0.01,
        /// Weight of the mean standard deviation, as a share of the extent, in the loss: 0.01.
        pub scale_weight: f64 = 0.01,
        /// Initial opacity of the Gaussians: 0.5.
        pub start_opacity: f64 = 0.5,
        /// Factor on the initial standard deviations, relative to those without a strategy: 0.1.
        pub start_scale: f64 = 0.1,
    }
}

/// Steepness of the noise's decrease where opacities exceed [`McmcConfig::dead_opacity`] (Kheradmand et al. 2024, eq. 8).
const SUDDENNESS: f64 = 100.0;

/// The strategy and its stock of noise.
#[derive(Debug)]
pub struct Mcmc {
    config: McmcConfig,
    extent: f64,
    steps: usize,
    noise: Noise,
}

impl Mcmc {
    /// A strategy for a run of `steps` on a scene of `extent` (see [`crate::optim::scene_extent`]).
    pub fn new(config: McmcConfig, extent: f64, steps: usize) -> Self {
        Self { config, extent, steps, noise: Noise::default() }
    }

    /// Replaces dead Gaussians and adds new ones: for each new Gaussian, a living one is drawn with a probability
    /// proportional to its opacity and shares its opacity and size with all new ones at its position. (The paper draws for
    /// the dead first and then for the additional ones. One draw for both is equivalent.)
    fn refine(&self, scene: &mut Trained, rng: &mut dyn Rng) -> Refined {
        let plain = scene.gaussians.untracked();
        let (rows, opacities) = (plain.len(), plain.opacities());
        let usable = opacities.clone().greater_elem(0.0);
        let lives = usable.clone().bool_and(plain.logit_opacities().greater_elem(logit(self.config.dead_opacity)));
        if rows == 0 {
            return Ok(None);
        }
        let weights = weights(opacities.clone().mask_fill(lives.clone().bool_not(), 0.0));
        let total = weights.clone().narrow(0, rows - 1, 1);
        let [living] = counts([lives.clone()]);
        let total = read_back(total).iter::<i64>().next().map_or(0, |total| total as usize);
        // Without living Gaussians there is nothing to share.
        if total == 0 {
            return Ok(None);
        }
        // The cap ends growth and removes no living Gaussian.
        let draws = rounded_down(self.grown(rows).max(living)).saturating_sub(living);
        let drawn = drawn(weights, total, draws, rng);
        let shares = drawn.clone().greater_elem(0);
        let [sharing] = counts([shares.clone()]);

        let order = z_order(&plain.means(), &usable);
        let keep = picked(&order, &lives.bool_and(shares.clone().bool_not()), living - sharing);
        let edit = if sharing == 0 {
            RowEdit::new(keep, rows_on(&order.device(), &[]))
        } else {
            let new = repeated(drawn.clone() + ones(shares), draws + sharing);
            let together = (drawn.select(0, new.clone()) + 1).float().cast(opacities.dtype());
            let (each, factor) = share(opacities.select(0, new.clone()), together);
            let log_scales = plain.log_scales().select(0, new.clone()) + factor.log().unsqueeze_dim::<2>(1);
            let logits = each.clone().log() - each.neg().log1p();
            RowEdit::new(keep, new).with("log_scales", log_scales).with("logit_opacities", logits)
        };
        drop(plain);
        scene.edit(&edit)?;
        Ok(Some(RefineReport { cloned: draws, pruned: rows - living, ..RefineReport::default() }))
    }

    /// Number of Gaussians to reach from `count` in a refinement.
    fn grown(&self, count: usize) -> usize {
        ((count as f64 * self.config.growth) as usize).min(self.config.max_splats)
    }

    /// Adds noise to the centres: `λ Σ η σ(k (t − o))`, with `λ` the learning rate times [`McmcConfig::noise`], `Σ` the
    /// covariance, `η` normal, `o` the opacity and `t` the opacity of the dead (Kheradmand et al. 2024, eq. 8 and its
    /// code). Faint Gaussians move, mostly along their own extent, and visible ones do not.
    fn wander(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) {
        let means = scene.gaussians.means().inner();
        let normal = self.noise.draw(means.dims()[0], rng, &means.device());
        let by = self.config.noise * at.means_rate / (self.extent * self.extent);
        let device = means.device();
        scene.replace_means(apart(&device, || {
            let moved = means.clone() + self.displacements(&scene.gaussians, normal) * by;
            match at.verdict {
                None => moved,
                Some(verdict) => {
                    let held = verdict.clone().narrow(0, 0, 1).not_equal_elem(0).reshape([1, 1]).expand(means.shape());
                    moved.mask_where(held, means)
                }
            }
        }));
    }

    /// `Σ η σ(k (t − o))`, `[N, 3]`, for normal `η`, `[N, 3]`. Sizes are limited to the scene's. With `Σ = R S² Rᵀ`, `Rᵀ η`
    /// is as normal as `η`, so `normal` is used as `Rᵀ η`.
    fn displacements(&self, gaussians: &Gaussians, normal: Tensor<2>) -> Tensor<2> {
        let opacities = sigmoid(gaussians.logit_opacities().inner()).unsqueeze_dim::<2>(1);
        let faint = sigmoid((opacities.neg() + self.config.dead_opacity) * SUDDENNESS);
        let scales = gaussians.log_scales().inner().exp().clamp_max(self.extent);
        let (w, axis) = unit(gaussians.rotations().inner());
        rotated(normal * scales.square(), w, axis) * faint
    }
}

/// Running sums of opacities, `[N]`, as whole numbers below 2^31, which are the same on every device.
fn weights(opacities: Tensor<1>) -> Tensor<1, Int> {
    let rows_bits = opacities.dims()[0].next_power_of_two().ilog2();
    let levels = f64::from(1_u32 << (30 - rows_bits.clamp(10, 30)));
    running_sums((opacities * levels + 0.5).floor().int().cast(DType::I32))
}

/// How often each row is drawn in `draws` draws with probabilities in the proportion of the weights whose running sums are `sums`,
/// `[N]`, with the sum `total`: systematic resampling (Kitagawa 1996), which draws each row as often as expected, rounded up or down.
/// A sum is rounded once, so that every device draws the same rows.
fn drawn(sums: Tensor<1, Int>, total: usize, draws: usize, rng: &mut dyn Rng) -> Tensor<1, Int> {
    let [rows] = sums.dims();
    // Rows of no weight at the start are not drawn, and the last sum comes to all draws, in spite of rounding.
    let start = 0.999 * rng.random::<f64>() * total as f64 / draws.max(1) as f64;
    let per_weight = draws as f64 * (1.0 + 1e-6) / total as f64;
    let places = ((sums + start as i64).float() * per_weight).floor().int().cast(DType::I32).clamp_max(draws as i64);
    let first = Tensor::zeros([1], (&places.device(), DType::I32));
    let before = if rows == 1 { first } else { Tensor::cat(vec![first, places.clone().narrow(0, 0, rows - 1)], 0) };
    places - before
}

impl Strategy for Mcmc {
    fn start(&mut self, rows: &mut GaussianRows) {
        let opacity = self.config.start_opacity;
        rows.logit_opacities.fill((opacity / (1.0 - opacity)).ln() as f32);
        let log = self.config.start_scale.ln() as f32;
        rows.log_scales.as_flattened_mut().iter_mut().for_each(|scale| *scale += log);
    }

    fn penalty(&self, splats: &Splats, _step: usize) -> Option<Tensor<1>> {
        let opacity = regularise::opacity(splats.opacities.clone()) * self.config.opacity_weight;
        Some(opacity + regularise::scale(splats.scales.clone()) * (self.config.scale_weight / self.extent))
    }

    fn acts_at(&self, step: usize) -> bool {
        let is_due = step >= self.config.from && step.is_multiple_of(self.config.every.max(1));
        is_due && (step as f64) < self.config.until_share * self.steps as f64
    }

    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) -> Refined {
        let report = if self.acts_at(at.step) { self.refine(scene, rng)? } else { None };
        if report.is_some() {
            self.noise.forget();
        }
        if !scene.gaussians.is_empty() && self.config.noise > 0.0 {
            self.wander(scene, at, rng);
        }
        Ok(report)
    }

    fn set_steps(&mut self, steps: usize) {
        self.steps = steps;
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.noise.save(to)
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.noise.load(from, device)
    }
}

#[cfg(test)]
mod tests;
