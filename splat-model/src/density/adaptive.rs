//! Adaptive density control (Kerbl et al. 2023, section 5.2) with later additions of the field: a hard cap, a limit on
//! needles, a threshold that rises at the cap, halves across the longest axis, and growth by small shares.

mod division;

use burn::tensor::{Device, Tensor};
use rand::Rng;
use serde::{Deserialize, Serialize};
use splat_op::tally::{self, Tally};

pub use self::division::Division;
use self::division::{push_halves, push_parts};
use super::consistency::{Agreement, ConsistencyConfig};
use super::focus::Focus;
use super::order::morton_order;
use super::outlook;
use super::rows::{RowEdit, Trained};
use super::strategy::{Observed, RefineReport, Signals, Strategy, StrategyContext};
use crate::gaussians::{self, GaussianRows, RowsError, values_of};
use crate::state::{State, StateError};

/// Options of adaptive density control. Defaults are those of the original implementation unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdaptiveConfig {
    /// Steps between refinements.
    pub every: usize,
    /// First step of refinement.
    pub from: usize,
    /// Share of the run after which the number of Gaussians is fixed: 0.5.
    pub until_share: f64,
    /// Gaussians whose mean gradient at the projected centre, per unit of normalised device coordinates, exceeds this
    /// threshold are copied or split: 2e-4, and 8e-4 for absolute gradients.
    pub grad_threshold: f64,
    /// Whether the gradient is AbsGS's (Ye et al. 2024): the sum of absolute values over the pixels, so that the gradients
    /// of the two edges of a Gaussian that blurs smaller detail do not cancel.
    pub absolute: bool,
    /// Whether Gaussians are copied, split and kept only where several views agree, and by how much: off.
    pub consistency: Option<ConsistencyConfig>,
    /// Largest size of a Gaussian that is copied instead of split, as a share of the scene extent: 0.01.
    pub split_scale: f64,
    /// Opacity below which Gaussians are removed: 0.005.
    pub prune_opacity: f64,
    /// Size above which Gaussians are removed after the first opacity reset, as a share of the scene extent: 0.1.
    pub prune_scale: f64,
    /// Steps between opacity resets, which remove floaters in front of the cameras: 3,000; 0 for never.
    pub reset_every: usize,
    /// Largest number of Gaussians. At the cap only those with the largest gradients are copied or split.
    pub max_splats: usize,
    /// How one Gaussian becomes two: as in the original.
    pub division: Division,
    /// Largest share of the Gaussians that one refinement copies or splits: none. Those with the largest gradients are chosen.
    /// With a share, the rows that are left up to `max_splats` are divided evenly among the refinements to come. Without one,
    /// a refinement may reach the cap at once.
    pub growth: Option<f64>,
    /// Share of the Gaussians that may exceed the threshold and still wait for a later refinement, with [`Self::growth`]: all. Where more
    /// of them do, as in a capture with few points, a refinement takes up to twice its share.
    pub waiting: f64,
    /// Largest ratio of a Gaussian's largest standard deviation to its middle one: 30. Needles far longer than wide show as
    /// streaks in views outside the training set. (Not in the original.)
    pub max_elongation: f64,
    /// The part of the scene that Gaussians are added to: all of it.
    pub focus: Option<Focus>,
}

impl Default for AdaptiveConfig {
    fn default() -> Self {
        Self {
            every: 100,
            from: 500,
            until_share: 0.5,
            grad_threshold: 2e-4,
            absolute: false,
            consistency: None,
            split_scale: 0.01,
            prune_opacity: 0.005,
            prune_scale: 0.1,
            reset_every: 3_000,
            max_splats: 1_000_000,
            division: Division::CloneOrSplit,
            growth: None,
            waiting: 1.0,
            max_elongation: 30.0,
            focus: None,
        }
    }
}

impl AdaptiveConfig {
    /// AbsGS: absolute gradients with the threshold that is common for them, in the same unit.
    pub fn absgrad() -> Self {
        Self { absolute: true, grad_threshold: 8e-4, ..Self::default() }
    }

    /// Growth by small shares from early on: every chosen Gaussian becomes two halves, which hardly change the picture. Opacities are not reset. Instead, a weight on the mean opacity in the loss ([`GRADUAL_OPACITY_WEIGHT`]) lets
    /// Gaussians fade that no photograph needs. Without it, a capture without points may end behind one that is opaque.
    pub fn gradual() -> Self {
        Self {
            every: 50,
            from: 100,
            grad_threshold: 3e-4,
            reset_every: 0,
            division: Division::LongAxis,
            growth: Some(0.1),
            waiting: 0.15,
            ..Self::default()
        }
    }

    /// The same options for a capture without points. With [`Self::growth`], the threshold is half of [`Self::gradual`]'s: Gaussians
    /// begin at random places, and most of those that remain have to become many.
    pub fn without_points(self) -> Self {
        match self.growth {
            Some(_) => Self { grad_threshold: 0.5 * Self::gradual().grad_threshold, ..self },
            None => self,
        }
    }

    /// Densification and pruning by the agreement of several views.
    pub fn consistent() -> Self {
        Self { consistency: Some(ConsistencyConfig::default()), ..Self::default() }
    }
}

/// Largest multiple of [`AdaptiveConfig::growth`] that a refinement takes. A refinement that adds 28% raises the loss of the small demo
/// capture by 20%.
const HASTE: f64 = 2.0;

/// Opacity after a reset, as in the original.
const RESET_OPACITY: f64 = 0.01;

/// The weight of the mean opacity in the loss for [`AdaptiveConfig::gradual`], that of MCMC (Kheradmand et al. 2024).
pub const GRADUAL_OPACITY_WEIGHT: f64 = 0.01;

/// The strategy with its statistics since the last refinement.
#[derive(Debug)]
pub struct Adaptive {
    config: AdaptiveConfig,
    extent: f64,
    steps: usize,
    /// `[N]`: sums of gradient norms, and numbers of steps with a gradient. `None` right after an edit of rows.
    seen: Option<Tally>,
    /// Statistics of the views that were evaluated since the last edit.
    agreement: Option<Agreement>,
}

impl Adaptive {
    /// A strategy for a run of `steps` on a scene of `extent` (see [`crate::optim::scene_extent`]).
    pub fn new(config: AdaptiveConfig, extent: f64, steps: usize) -> Self {
        Self { config, extent, steps, seen: None, agreement: None }
    }

    /// Whether a refinement or a reset is due at `step`, counted from 1.
    fn is_time_at(&self, step: usize) -> bool {
        (step as f64) < self.config.until_share * self.steps as f64
    }

    fn densifies_at(&self, step: usize) -> bool {
        step >= self.config.from && step.is_multiple_of(self.config.every.max(1))
    }

    fn refines_at(&self, step: usize) -> bool {
        self.is_time_at(step) && self.densifies_at(step)
    }

    /// Growth of a refinement by the statistics so far, as a share of the Gaussians, where those below `fading` times the
    /// opacity of pruning are removed. `None` before the first statistics, and without Gaussians.
    fn growth_now(&self, scene: &Trained, fading: f64) -> Option<f64> {
        let Tally { sums, counts } = self.seen.as_ref().filter(|_| !scene.gaussians.is_empty())?;
        let opacity = fading * self.config.prune_opacity;
        let logits = scene.gaussians.logit_opacities.val().inner();
        let fading = logits.lower_elem((opacity / (1.0 - opacity)).ln());
        let chosen =
            sums.clone().greater(counts.clone() * self.config.grad_threshold).bool_and(fading.clone().bool_not());
        let added = (chosen.int() - fading.int()).float().mean();
        Some(added.into_scalar::<f64>()).filter(|growth| growth.is_finite())
    }

    fn resets_at(&self, step: usize) -> bool {
        self.config.reset_every > 0 && step.is_multiple_of(self.config.reset_every)
    }

    fn densify(&mut self, scene: &mut Trained, step: usize, rng: &mut dyn Rng) -> Result<RefineReport, RowsError> {
        let rows = scene.gaussians.to_rows();
        let gradients = self.mean_gradients(rows.len());
        let keep_largest = self.config.reset_every == 0 || step <= self.config.reset_every;
        let agreement = self.config.consistency.zip(self.agreement.take());
        let agreed = agreement.map(|(config, agreement)| agreement.read(&config));
        let hardly_shows = |i: usize| agreed.as_ref().is_some_and(|agreed| agreed[i].hardly_shows);
        let doomed: Vec<bool> =
            (0..rows.len()).map(|i| self.is_doomed(&rows, i, keep_largest) || hardly_shows(i)).collect();
        let is_wrong = |i: usize| agreed.as_ref().is_none_or(|agreed| agreed[i].is_wrong);
        let wanted = |i: &usize| !doomed[*i] && f64::from(gradients[*i]) > self.config.grad_threshold && is_wrong(*i);
        let wanted = self.focused((0..rows.len()).filter(wanted).collect(), (&rows, &doomed), &gradients, step);
        let (chosen, threshold) = self.choose(wanted, &gradients, &doomed, step);
        let split_above = (self.config.split_scale * self.extent) as f32;

        let mut report = RefineReport { threshold, ..Default::default() };
        let mut edit = RowEdit::default();
        edit.add.sh_degree = rows.sh_degree;
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
        let asks = self.config.consistency.is_some_and(|config| config.asks_at(step, self.config.every));
        Signals { gradient: listens && !absolute, abs_gradient: listens && absolute, covered: listens && asks }
    }

    fn observe(&mut self, seen: Observed) {
        if let Some(covered) = seen.covered {
            self.agreement = Some(Agreement::with(self.agreement.take(), covered));
        }
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

    fn outlook(&self, scene: &Trained, step: usize) -> Option<Vec<(usize, usize)>> {
        let (config, count) = (&self.config, scene.gaussians.len());
        let refined = (1..=step).filter(|&step| self.refines_at(step)).count();
        // Right after a refinement, the statistics are of a few views, whose largest gradients are not averaged yet.
        if refined > 0 && step % config.every.max(1) < config.every / 2 {
            return None;
        }
        let growth = self.growth_now(scene, if refined == 0 { outlook::FADING } else { 1.0 })?;
        let later = (step + 1..=self.steps).filter(|&step| self.refines_at(step));
        Some(match config.growth {
            None => outlook::expected(later, refined, count, growth, config.max_splats),
            Some(largest) => outlook::expected_by_shares(
                &later.collect::<Vec<_>>(),
                refined,
                count,
                growth.min((growth - config.waiting).min(HASTE * largest).max(largest)),
                config.max_splats,
            ),
        })
    }

    fn set_steps(&mut self, steps: usize) {
        self.steps = steps;
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        if let Some(Tally { sums, counts }) = &self.seen {
            to.put("gradient_sum", sums.clone());
            to.put("seen_count", counts.clone());
        }
        if let Some(agreement) = &self.agreement {
            to.put_part("agreement", agreement.save());
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
        self.agreement = None;
        if from.has("agreement") {
            self.agreement = Some(from.load_part("agreement", |part| Agreement::load(part, device))?);
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
