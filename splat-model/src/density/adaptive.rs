//! Adaptive density control (Kerbl et al. 2023, section 5.2) with later additions of the field: a hard cap, a limit on
//! needles, a threshold that rises at the cap, halves across the longest axis, and growth by small shares.

mod config;
mod division;

use burn::tensor::{Bool, Device, Int, Tensor};
use rand::Rng;

pub use self::config::{AdaptiveConfig, GRADUAL_OPACITY_WEIGHT};
pub use self::division::Division;
use self::division::{Divided, parts};
use super::order::z_order;
use super::pick::{counts, largest, picked, rows_on, whole};
use super::rows::{RowEdit, Trained};
use super::strategy::{Observed, RefineReport, Refined, Signals, Strategy, StrategyContext};
use super::tally::{self, Tally};
use crate::gaussians::{Gaussians, RowsError, logit};
use crate::state::{State, StateError};

/// Largest multiple of [`AdaptiveConfig::growth`] that a refinement takes. A refinement that adds 28% raises the loss of the small demo
/// capture by 20%.
const HASTE: f64 = 2.0;

/// Opacity after a reset, as in the original.
const RESET_OPACITY: f64 = 0.01;

/// The strategy with its statistics since the last refinement.
#[derive(Debug)]
pub struct Adaptive {
    config: AdaptiveConfig,
    extent: f64,
    steps: usize,
    /// `[N]`: sums of gradient norms, and numbers of steps with a gradient. `None` right after an edit of rows.
    seen: Option<Tally>,
}

impl Adaptive {
    /// A strategy for a run of `steps` on a scene of `extent` (see [`crate::optim::scene_extent`]).
    pub fn new(config: AdaptiveConfig, extent: f64, steps: usize) -> Self {
        Self { config, extent, steps, seen: None }
    }

    /// Whether a refinement or a reset is due at `step`, counted from 1.
    fn is_time_at(&self, step: usize) -> bool {
        (step as f64) < self.config.until_share * self.steps as f64
    }

    fn densifies_at(&self, step: usize) -> bool {
        step >= self.config.from && step.is_multiple_of(self.config.every.max(1))
    }

    fn resets_at(&self, step: usize) -> bool {
        self.config.reset_every > 0 && step.is_multiple_of(self.config.reset_every)
    }

    fn densify(&mut self, scene: &mut Trained, step: usize, rng: &mut dyn Rng) -> Result<RefineReport, RowsError> {
        let plain = scene.gaussians.untracked();
        if plain.is_empty() {
            return Ok(RefineReport { threshold: self.config.grad_threshold, ..RefineReport::default() });
        }
        let gradients = self.mean_gradients(&plain);
        let usable = plain.opacities().greater_elem(0.0);
        let sound = self.sound(&plain, &usable, step);
        let wanted = gradients.clone().greater_elem(self.config.grad_threshold).bool_and(sound.clone());
        let Chosen { rows: chosen, count, threshold, surviving, spared } =
            self.choose(&plain, &sound, wanted, &gradients, step);
        let sound = if spared > 0 { self.spare(&plain, sound, spared) } else { sound };

        // Those that are split make place for their parts.
        let halves = self.config.division == Division::LongAxis;
        let (splits, split) = if halves {
            (chosen.clone(), count)
        } else {
            let above = (self.config.split_scale * self.extent).ln();
            let splits = chosen.clone().bool_and(largest_log_scale(&plain).greater_elem(above));
            (splits.clone(), if count == 0 { 0 } else { counts([splits])[0] })
        };
        let (kept, cloned) = (surviving - split, count - split);
        let order = z_order(&plain.means(), &usable);
        let keep = picked(&order, &sound.bool_and(splits.clone().bool_not()), kept);
        let rows = |mask: &Tensor<1, Bool>, count| picked(&order, mask, count);
        let edit = match (cloned, split) {
            (0, 0) => RowEdit::new(keep, rows_on(&order.device(), &[])),
            (_, 0) => RowEdit::new(keep, rows(&chosen, cloned)),
            _ => {
                let clones = (cloned > 0).then(|| rows(&chosen.bool_and(splits.clone().bool_not()), cloned));
                let splits = rows(&splits, split);
                let twice = Tensor::cat(vec![splits.clone(), splits.clone()], 0);
                let parts =
                    if halves { division::halves(&plain, &splits) } else { parts(&plain, &twice, rng.next_u64()) };
                with_parts(&plain, keep, clones, twice, parts)
            }
        };
        let pruned = plain.len() - surviving;
        drop(plain);
        scene.edit(&edit)?;
        self.limit_elongation(scene);
        self.seen = None;
        Ok(RefineReport { cloned, split, pruned, threshold })
    }

    /// `[N]`: mean gradient of each Gaussian over the steps in which it was visible.
    fn mean_gradients(&mut self, scene: &Gaussians) -> Tensor<1> {
        match self.seen.take() {
            Some(Tally { sums, counts }) => sums / counts.clamp_min(1.0),
            None => scene.logit_opacities().zeros_like(),
        }
    }

    /// `[N]`: whether each Gaussian is neither too faint nor too large nor unusable. No optimiser step makes a non-finite value finite.
    fn sound(&self, scene: &Gaussians, usable: &Tensor<1, Bool>, step: usize) -> Tensor<1, Bool> {
        let seen = scene.logit_opacities().greater_equal_elem(logit(self.config.prune_opacity));
        let sound = seen.bool_and(usable.clone());
        if self.config.reset_every == 0 || step <= self.config.reset_every {
            return sound;
        }
        let most = (self.config.prune_scale * self.extent).ln();
        sound.bool_and(largest_log_scale(scene).lower_equal_elem(most))
    }

    /// Selects the rows to copy or split of those that are `wanted`. The largest gradients are chosen where there is not room for all.
    fn choose(
        &self,
        scene: &Gaussians,
        sound: &Tensor<1, Bool>,
        mut wanted: Tensor<1, Bool>,
        gradients: &Tensor<1>,
        step: usize,
    ) -> Chosen {
        let (surviving, mut count);
        match self.config.focus {
            None => [surviving, count] = counts([sound.clone(), wanted.clone()]),
            Some(focus) => {
                let beyond = focus.beyond(&scene.means());
                let far = wanted.clone().bool_and(beyond.clone());
                let far_sound = sound.clone().bool_and(beyond);
                let [all, all_wanted, surviving_far, wanted_far] =
                    counts([sound.clone(), wanted.clone(), far_sound, far.clone()]);
                (surviving, count) = (all, all_wanted);
                // Beyond the focus only as many as still fit into its share.
                let most = (focus.beyond_share * self.config.max_splats as f64) as usize;
                let room = self.paced(most.saturating_sub(surviving_far), surviving_far, wanted_far, step);
                if room < wanted_far {
                    let admitted = largest(gradients, &far, room).0;
                    wanted = wanted.bool_and(far.bool_not().bool_or(admitted));
                    count -= wanted_far - room;
                }
            }
        }
        let room = self.paced(self.config.max_splats.saturating_sub(surviving), surviving, count, step);
        let (most, spared) = whole(surviving, count.min(room), gradients.dims()[0] - surviving);
        let (rows, threshold) = if most == count {
            (wanted, self.config.grad_threshold)
        } else {
            let (rows, next) = largest(gradients, &wanted, most);
            (rows, next.unwrap_or(self.config.grad_threshold))
        };
        Chosen { rows, count: most, threshold, surviving: surviving + spared, spared }
    }

    /// `sound` and the most opaque `count` of the other rows.
    fn spare(&self, scene: &Gaussians, sound: Tensor<1, Bool>, count: usize) -> Tensor<1, Bool> {
        // Opacities are zero where a row is unusable, and those come last.
        largest(&scene.opacities(), &sound.clone().bool_not(), count).0.bool_or(sound)
    }

    /// The part of the `room` left for more than `count` rows that the refinement at `step` may use, if so many are `wanted`. Copying
    /// and splitting add one row each.
    fn paced(&self, room: usize, count: usize, wanted: usize, step: usize) -> usize {
        let Some(growth) = self.config.growth else { return room };
        let every = self.config.every.max(1);
        let end = (self.config.until_share * self.steps as f64).ceil() as usize;
        let refinements = (end.saturating_sub(1) / every + 1).saturating_sub(step / every).max(1);
        let excess = wanted as f64 / count.max(1) as f64 - self.config.waiting;
        let share = excess.min(HASTE * growth).max(growth);
        room.div_ceil(refinements).min((share * count as f64).ceil() as usize)
    }

    /// Limits each Gaussian's largest standard deviation to `max_elongation` times its middle one.
    fn limit_elongation(&self, scene: &mut Trained) {
        let logs = scene.gaussians.log_scales().inner();
        let (smallest, largest) = (logs.clone().min_dim(1), logs.clone().max_dim(1));
        let middle = logs.clone().sum_dim(1) - smallest - largest;
        let ceiling = middle + self.config.max_elongation.ln();
        let ceiling = ceiling.expand(logs.shape());
        let limited = logs.clone().mask_where(logs.clone().greater(ceiling.clone()), ceiling);
        scene.replace_log_scales(limited);
    }
}

impl Strategy for Adaptive {
    fn listens_at(&self, step: usize) -> Signals {
        let listens = self.is_time_at(step);
        let absolute = self.config.absolute;
        Signals { gradient: listens && !absolute, abs_gradient: listens && absolute }
    }

    fn observe(&mut self, seen: Observed) {
        let Some(grad_mean2d) = seen.gradient.or(seen.abs_gradient) else { return };
        // Half the picture size: normalised device coordinates run from -1 to 1.
        let per_ndc = [seen.size.0 as f32 / 2.0, seen.size.1 as f32 / 2.0];
        self.seen = Some(tally::add(self.seen.take(), grad_mean2d, per_ndc));
    }

    fn acts_at(&self, step: usize) -> bool {
        self.is_time_at(step) && (self.densifies_at(step) || self.resets_at(step))
    }

    fn act(&mut self, scene: &mut Trained, at: &StrategyContext, rng: &mut dyn Rng) -> Refined {
        if !self.is_time_at(at.step) {
            return Ok(None);
        }
        let mut report = None;
        if self.densifies_at(at.step) {
            report = Some(self.densify(scene, at.step, rng)?);
        }
        if self.resets_at(at.step) {
            let ceiling = (RESET_OPACITY / (1.0 - RESET_OPACITY)).ln();
            let logits = scene.gaussians.logit_opacities().inner().clamp_max(ceiling);
            scene.reset_opacities(logits);
        }
        Ok(report)
    }

    fn set_steps(&mut self, steps: usize) {
        self.steps = steps;
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        if let Some(Tally { sums, counts }) = &self.seen {
            to.put("gradient_sum", sums.clone());
            to.put("seen_count", counts.clone());
        }
        Ok(())
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.seen = None;
        if from.has("gradient_sum") {
            let sums: Tensor<1> = from.take("gradient_sum", device)?;
            let counts = from.take_shaped("seen_count", sums.dims(), device)?;
            self.seen = Some(Tally { sums, counts });
        }
        Ok(())
    }
}

/// The rows to copy or split.
struct Chosen {
    /// `[N]`.
    rows: Tensor<1, Bool>,
    count: usize,
    /// Gradient above which rows are chosen.
    threshold: f64,
    /// Number of rows that are not removed, with those of `spared`.
    surviving: usize,
    /// Number of rows that stay although they are not sound, for the sake of their number.
    spared: usize,
}

/// The edit that copies `clones` and replaces others by their parts, whose rows come from `whole`.
fn with_parts(
    scene: &Gaussians,
    keep: Tensor<1, Int>,
    clones: Option<Tensor<1, Int>>,
    whole: Tensor<1, Int>,
    parts: Divided,
) -> RowEdit {
    let Divided { means, log_scales, logit_opacities } = parts;
    let Some(clones) = clones else {
        let edit = RowEdit::new(keep, whole).with("means", means).with("log_scales", log_scales);
        return edit.with("logit_opacities", logit_opacities);
    };
    let after = |values: Tensor<2>, parts| Tensor::cat(vec![values.select(0, clones.clone()), parts], 0);
    let edit = RowEdit::new(keep, Tensor::cat(vec![clones.clone(), whole], 0));
    let logits = scene.logit_opacities().select(0, clones.clone());
    edit.with("means", after(scene.means(), means))
        .with("log_scales", after(scene.log_scales(), log_scales))
        .with("logit_opacities", Tensor::cat(vec![logits, logit_opacities], 0))
}

/// `[N]`: logarithm of each Gaussian's largest standard deviation.
fn largest_log_scale(scene: &Gaussians) -> Tensor<1> {
    scene.log_scales().max_dim(1).squeeze_dim(1)
}

#[cfg(test)]
mod tests;
