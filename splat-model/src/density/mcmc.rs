//! 3D Gaussian splatting as Markov chain Monte Carlo (Kheradmand et al. 2024): Gaussians are samples with noise on their
//! positions, faded ones are moved to the positions of others, and their number grows to a cap by a schedule instead of a
//! threshold.

mod relocate;

use burn::tensor::{Device, Tensor, activation::sigmoid};
use rand::Rng;
use rand::distr::Distribution;
use rand::distr::weighted::WeightedIndex;
use serde::{Deserialize, Serialize};
use splat_op::Splats;

use self::relocate::share;
use super::noise::Noise;
use super::order::morton_order;
use super::rows::{RowEdit, Trained};
use super::strategy::{RefineReport, Strategy, StrategyContext};
use crate::gaussians::{self, GaussianRows, Gaussians, RowsError};
use crate::loss::regularise;
use crate::state::{State, StateError};

/// Options of MCMC density control. Defaults are those of the paper and its code.
///
/// That code assumes scenes some units across and uses their unit directly. Here lengths are in units of the scene extent
/// (see [`crate::optim::scene_extent`]), so that training does not depend on the unit of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct McmcConfig {
    /// Steps between refinements: 100.
    pub every: usize,
    /// First step of refinement: 500.
    pub from: usize,
    /// Share of the run after which Gaussians are neither moved nor added: 5/6. The noise continues to the end.
    pub until_share: f64,
    /// Growth factor of the number of Gaussians at each refinement: 1.05.
    pub growth: f64,
    /// Largest number of Gaussians.
    pub max_splats: usize,
    /// Largest opacity of a dead Gaussian, which is moved: 0.005.
    pub dead_opacity: f64,
    /// Scale of the noise on positions, in multiples of the centres' learning rate: 5e5.
    pub noise: f64,
    /// Weight of the mean opacity in the loss: 0.01.
    pub opacity_weight: f64,
    /// Weight of the mean standard deviation, as a share of the extent, in the loss: 0.01.
    pub scale_weight: f64,
    /// Initial opacity of the Gaussians: 0.5.
    pub start_opacity: f64,
    /// Factor on the initial standard deviations, relative to those without a strategy: 0.1.
    pub start_scale: f64,
}

impl Default for McmcConfig {
    fn default() -> Self {
        Self {
            every: 100,
            from: 500,
            until_share: 5.0 / 6.0,
            growth: 1.05,
            max_splats: 1_000_000,
            dead_opacity: 0.005,
            noise: 5e5,
            opacity_weight: 0.01,
            scale_weight: 0.01,
            start_opacity: 0.5,
            start_scale: 0.1,
        }
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
    fn refine(&self, scene: &mut Trained, rng: &mut dyn Rng) -> Result<Option<RefineReport>, RowsError> {
        let rows = scene.gaussians.to_rows();
        let opacities: Vec<f64> = (0..rows.len()).map(|i| self.opacity_of_living(&rows, i)).collect();
        let living = opacities.iter().filter(|opacity| **opacity > 0.0).count();
        // Without living Gaussians there is nothing to share.
        let Ok(by_opacity) = WeightedIndex::new(&opacities) else { return Ok(None) };
        // The cap ends growth and removes no living Gaussian.
        let wanted = self.grown(rows.len()).max(living);
        let mut drawn = vec![0_usize; rows.len()];
        (living..wanted).for_each(|_| drawn[by_opacity.sample(rng)] += 1);

        let mut edit = RowEdit::default();
        edit.add.sh_degree = rows.sh_degree;
        edit.add.reserve_exact(drawn.iter().filter(|more| **more > 0).map(|more| more + 1).sum());
        for (i, &more) in drawn.iter().enumerate().filter(|(_, more)| **more > 0) {
            let (opacity, factor) = share(opacities[i], more + 1);
            let add = &mut edit.add;
            for _ in 0..=more {
                add.push(&rows, i);
                let last = add.len() - 1;
                add.logit_opacities[last] = (opacity / (1.0 - opacity)).ln() as f32;
                add.log_scales[last] = rows.log_scales[i].map(|log| log + factor.ln() as f32);
            }
        }
        let stays = |row: &u32| opacities[*row as usize] > 0.0 && drawn[*row as usize] == 0;
        edit.keep = morton_order(&rows.means).into_iter().filter(stays).collect();
        let (cloned, pruned) = (wanted - living, rows.len() - living);
        drop(rows);
        scene.edit(&edit)?;
        Ok(Some(RefineReport { cloned, pruned, ..RefineReport::default() }))
    }

    /// Number of Gaussians to reach from `count` in a refinement.
    fn grown(&self, count: usize) -> usize {
        ((count as f64 * self.config.growth) as usize).min(self.config.max_splats)
    }

    /// The opacity of a living Gaussian. 0 for a dead or unusable one.
    fn opacity_of_living(&self, rows: &GaussianRows, i: usize) -> f64 {
        let opacity = gaussians::sigmoid(rows.logit_opacities[i]);
        if rows.is_usable(i) && opacity > self.config.dead_opacity { opacity } else { 0.0 }
    }

    /// Adds noise to the centres: `λ Σ η σ(k (t − o))`, with `λ` the learning rate times [`McmcConfig::noise`], `Σ` the
    /// covariance, `η` normal, `o` the opacity and `t` the opacity of the dead (Kheradmand et al. 2024, eq. 8 and its
    /// code). Faint Gaussians move, mostly along their own extent, and visible ones do not.
    fn wander(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) {
        let means = scene.gaussians.means.val().inner();
        let normal = self.noise.draw(means.dims()[0], rng, &means.device());
        let by = self.config.noise * at.means_rate / (self.extent * self.extent);
        let moved = means.clone() + self.displacements(&scene.gaussians, normal) * by;
        scene.replace_means(match at.verdict {
            None => moved,
            Some(verdict) => {
                let held = verdict.clone().narrow(0, 0, 1).not_equal_elem(0).reshape([1, 1]).expand(means.shape());
                moved.mask_where(held, means)
            }
        });
    }

    /// `Σ η σ(k (t − o))`, `[N, 3]`, for normal `η`, `[N, 3]`. Sizes are limited to the scene's. With `Σ = R S² Rᵀ`, `Rᵀ η`
    /// is as normal as `η`, so `normal` is used as `Rᵀ η`.
    fn displacements(&self, gaussians: &Gaussians, normal: Tensor<2>) -> Tensor<2> {
        let opacities = sigmoid(gaussians.logit_opacities.val().inner()).unsqueeze_dim::<2>(1);
        let faint = sigmoid((opacities.neg() + self.config.dead_opacity) * SUDDENNESS);
        let scales = gaussians.log_scales.val().inner().exp().clamp_max(self.extent);
        let (w, axis) = unit(gaussians.rotations.val().inner());
        rotated(normal * scales.square(), w, axis) * faint
    }
}

/// Real part, `[N, 1]`, and imaginary parts, `[N, 3]`, of the normalised quaternions `[N, 4]`, wxyz.
fn unit(quaternions: Tensor<2>) -> (Tensor<2>, Tensor<2>) {
    // Divided by the largest component first, because its square may overflow or underflow in f32.
    let largest = quaternions.clone().abs().max_dim(1);
    let sized = quaternions / largest;
    let length = sized.clone().square().sum_dim(1).sqrt();
    let unit = sized / length;
    (unit.clone().narrow(1, 0, 1), unit.narrow(1, 1, 3))
}

/// Rotates `v` by unit quaternions: `v + 2 w (u × v) + 2 u × (u × v)`.
fn rotated(v: Tensor<2>, w: Tensor<2>, u: Tensor<2>) -> Tensor<2> {
    let twice = u.clone().cross(v.clone(), 1) * 2.0;
    v + twice.clone() * w + u.cross(twice, 1)
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

    fn act(
        &mut self,
        scene: &mut Trained,
        at: &StrategyContext,
        rng: &mut dyn Rng,
    ) -> Result<Option<RefineReport>, RowsError> {
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
