//! Adaptive density control (Kerbl et al. 2023, section 5.2) with later additions of the field: a hard cap, a limit on
//! needles, a threshold that rises at the cap, halves across the longest axis, and growth by small shares.

mod config;
mod division;

use burn::tensor::{Device, Tensor};
use rand::Rng;
use splat_op::tally::{self, Tally};

pub use self::config::{AdaptiveConfig, GRADUAL_OPACITY_WEIGHT};
pub use self::division::Division;
use self::division::{push_halves, push_parts};
use super::order::morton_order;
use super::rows::{RowEdit, Trained};
use super::strategy::{Observed, RefineReport, Signals, Strategy, StrategyContext};
use crate::gaussians::{self, GaussianRows, RowsError, values_of};
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
        let rows = scene.gaussians.to_rows();
        let gradients = self.mean_gradients(rows.len());
        let keep_largest = self.config.reset_every == 0 || step <= self.config.reset_every;
        let doomed: Vec<bool> = (0..rows.len()).map(|i| self.is_doomed(&rows, i, keep_largest)).collect();
        let wanted = |i: &usize| !doomed[*i] && f64::from(gradients[*i]) > self.config.grad_threshold;
        let wanted = self.focused((0..rows.len()).filter(wanted).collect(), (&rows, &doomed), &gradients, step);
        let (chosen, threshold) = self.choose(wanted, &gradients, &doomed, step);
        let split_above = (self.config.split_scale * self.extent) as f32;

        let mut report = RefineReport { threshold, ..Default::default() };
        let mut edit = RowEdit::default();
        edit.add.sh_degree = rows.sh_degree;
        edit.add.reserve_exact(2 * chosen.len());
        let mut replaced = doomed.clone();
        for &i in &chosen {
            let halves = self.config.division == Division::LongAxis;
            if !halves && largest_scale(&rows, i) <= split_above {
                report.cloned += 1;
                edit.add.push(&rows, i);
                continue;
            }
            replaced[i] = true;
            report.split += 1;
            if halves {
                push_halves(&mut edit.add, &rows, i);
            } else {
                push_parts(&mut edit.add, &rows, i, rng);
            }
        }
        edit.keep = morton_order(&rows.means).into_iter().filter(|&row| !replaced[row as usize]).collect();
        report.pruned = doomed.iter().filter(|&&gone| gone).count();
        drop(rows);
        scene.edit(&edit)?;
        self.limit_elongation(scene);
        self.seen = None;
        Ok(report)
    }

    /// Mean gradient of each Gaussian over the steps in which it was visible.
    fn mean_gradients(&mut self, count: usize) -> Vec<f32> {
        match self.seen.take() {
            Some(Tally { sums, counts }) => values_of(sums / counts.clamp_min(1.0)),
            None => vec![0.0; count],
        }
    }

    /// Whether a Gaussian is too faint, too large, or unusable. No optimiser step makes a non-finite value finite.
    fn is_doomed(&self, rows: &GaussianRows, i: usize, keep_largest: bool) -> bool {
        let opacity = gaussians::sigmoid(rows.logit_opacities[i]);
        let largest = f64::from(largest_scale(rows, i));
        let sound = opacity >= self.config.prune_opacity && rows.is_usable(i);
        !(sound && (keep_largest || largest <= self.config.prune_scale * self.extent))
    }

    /// The rows to copy or split of those that are wanted, in order: beyond the focus only as many as still fit into its share, those
    /// with the largest gradients.
    fn focused(
        &self,
        mut wanted: Vec<usize>,
        (rows, doomed): (&GaussianRows, &[bool]),
        gradients: &[f32],
        step: usize,
    ) -> Vec<usize> {
        let Some(focus) = self.config.focus else { return wanted };
        let surviving = (0..rows.len()).filter(|&i| !doomed[i] && focus.is_beyond(rows, i)).count();
        let most = (focus.beyond_share * self.config.max_splats as f64) as usize;
        let mut beyond: Vec<usize> = wanted.extract_if(.., |i| focus.is_beyond(rows, *i)).collect();
        let room = self.paced(most.saturating_sub(surviving), (surviving, beyond.len()), step);
        by_gradient(&mut beyond, gradients);
        wanted.extend(beyond.into_iter().take(room));
        wanted.sort_unstable();
        wanted
    }

    /// Selects the rows to copy or split of those that are wanted, in order, and returns the threshold of the selection.
    fn choose(&self, mut chosen: Vec<usize>, gradients: &[f32], doomed: &[bool], step: usize) -> (Vec<usize>, f64) {
        let surviving = doomed.iter().filter(|&&gone| !gone).count();
        let room = self.paced(self.config.max_splats.saturating_sub(surviving), (surviving, chosen.len()), step);
        if chosen.len() <= room {
            return (chosen, self.config.grad_threshold);
        }
        by_gradient(&mut chosen, gradients);
        let threshold = f64::from(gradients[chosen[room]]);
        chosen.truncate(room);
        chosen.sort_unstable();
        (chosen, threshold)
    }

    /// The part of the `room` left for more than `count` rows that the refinement at `step` may use, if so many are `wanted`. Copying
    /// and splitting add one row each.
    fn paced(&self, room: usize, (count, wanted): (usize, usize), step: usize) -> usize {
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
        let logs = scene.gaussians.log_scales.val().inner();
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
        let added = tally::add(self.seen.take(), &grad_mean2d, per_ndc);
        self.seen = Some(added.unwrap_or_else(|tally| tallied(tally, grad_mean2d, per_ndc)));
    }

    fn acts_at(&self, step: usize) -> bool {
        self.is_time_at(step) && (self.densifies_at(step) || self.resets_at(step))
    }

    fn act(
        &mut self,
        scene: &mut Trained,
        at: &StrategyContext,
        rng: &mut dyn Rng,
    ) -> Result<Option<RefineReport>, RowsError> {
        if !self.is_time_at(at.step) {
            return Ok(None);
        }
        let mut report = None;
        if self.densifies_at(at.step) {
            report = Some(self.densify(scene, at.step, rng)?);
        }
        if self.resets_at(at.step) {
            let ceiling = (RESET_OPACITY / (1.0 - RESET_OPACITY)).ln();
            let logits = scene.gaussians.logit_opacities.val().inner().clamp_max(ceiling);
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

/// [`tally::add`] in tensor code.
fn tallied(tally: Option<Tally>, grad: Tensor<2>, per_axis: [f32; 2]) -> Tally {
    let per_axis = Tensor::<1>::from_floats(per_axis, &grad.device());
    let squared = (grad * per_axis.unsqueeze()).square().sum_dim(1).squeeze_dim::<1>(1);
    let norms = squared.sqrt();
    let shown = norms.clone().greater_elem(0.0).float();
    match tally {
        Some(Tally { sums, counts }) => Tally { sums: sums + norms, counts: counts + shown },
        None => Tally { sums: norms, counts: shown },
    }
}

/// Sorts rows by falling gradient.
fn by_gradient(rows: &mut [usize], gradients: &[f32]) {
    rows.sort_by(|&a, &b| gradients[b].total_cmp(&gradients[a]).then(a.cmp(&b)));
}

fn largest_scale(rows: &GaussianRows, i: usize) -> f32 {
    rows.log_scales[i].iter().fold(f32::NEG_INFINITY, |largest, log| largest.max(*log)).exp()
}

#[cfg(test)]
mod tests;
