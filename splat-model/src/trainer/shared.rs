//! The batch of a step, shared by the ranks of a run.
//!
//! All ranks draw the same views and random numbers. Each differentiates its share of the views and tells the others how that
//! went. Then everything that the step needs goes from one rank to all: the sum of the scene's gradients, and for each view its
//! loss, the gradients of the parameters of effects and of the loss, and the signals for density control.

use burn::tensor::{Gradients as Remaining, Tensor, TensorData};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use splat_op::Extras;

use super::differentiate::{Batch, Passed};
use super::ranks::{self, Fact, RankError, gather_all, share_of};
use super::{Result, TrainError, Trainer};
use crate::density::Observed;
use crate::density::rows::{Gradients, GroupGradients};
use crate::effects::{Effect, EffectContext, Leaf, RenderInput, stand_in};
use crate::gaussians::values_of;
use crate::state::State;

/// A rank's account of its part of a step.
#[derive(Serialize, Deserialize)]
enum Account {
    /// Every view is differentiated.
    Views(Vec<ViewAccount>),
    /// A loss or gradient is not finite.
    NonFinite { view: String, what: String, stage: String },
    /// Something else went wrong.
    Failed(String),
}

/// What a rank has of a view. Numbers follow in other messages.
#[derive(Serialize, Deserialize)]
struct ViewAccount {
    loss_bits: u32,
    /// Which blocks of the scene's groups have a gradient, in the order of [`Gradients`].
    scene: Vec<bool>,
    /// Which parameters of effects and of the loss have a gradient, in the order of [`Trainer::leaves`].
    leaves: Vec<bool>,
    /// Which signals density control gets, in the order of [`Observed`], and the size of the picture. `None` without any.
    signals: Option<([bool; 2], (usize, usize))>,
}

impl Trainer {
    /// Differentiates the rank's views of a step, which the guard checks one by one, and completes them to the batch. Losses and
    /// gradients are sums.
    pub(super) fn differentiate_shared(&mut self) -> Result<Batch> {
        let ranks = self.ranks.clone();
        if self.loss.joins_views() {
            let reason =
                "the loss compares the views of a step, each of which one process renders; run it in one process";
            return Err(RankError { rank: ranks.rank(), reason: reason.into() }.into());
        }
        let batch = self.config.batch;
        let views: Vec<_> = (0..batch).map(|_| (self.draw_view(), self.effects.draw(&mut self.rng))).collect();
        let shares: Vec<_> = (0..ranks.count()).map(|rank| share_of(rank, ranks.count(), batch)).collect();
        let share = shares[ranks.rank()].clone();
        let later =
            self.queue.iter().rev().enumerate().filter(|(i, _)| share.contains(&(i % batch))).map(|(_, view)| *view);
        self.views.expect(views[share.clone()].iter().map(|(view, _)| *view).chain(later));

        if share.is_empty() {
            self.follow_scene(views[0].0);
        }
        let own = views[share].chunks(1).map(|view| self.differentiate(view)).collect();
        let (mut own, accounts) = self.settle(own)?;
        let losses = accounts.iter().map(|account| f32::from_bits(account.loss_bits));
        let plain = self.device.clone();
        let loss =
            losses.map(|loss| Tensor::from_floats([loss], &plain)).reduce(|a, b| a + b).expect("a batch has a view");
        let parts = own.iter_mut().map(|one| std::mem::take(&mut one.gradients)).collect();
        let gradients = self.summed(parts, &accounts, &shares)?;
        let mut seen = Vec::new();
        let mut lefts = own.into_iter().map(|mut one| (one.left, one.seen.pop())).collect::<Vec<_>>().into_iter();
        let mut passes = Vec::new();
        for (i, (&(view, _), account)) in views.iter().zip(&accounts).enumerate() {
            let owner = shares.iter().position(|share| share.contains(&i)).expect("shares cover the batch");
            let (left, own_seen) = if owner == ranks.rank() { lefts.next() } else { None }.unzip();
            if let Some((signals, size)) = account.signals {
                seen.push(self.observed(owner, own_seen.flatten(), signals, size)?);
            }
            passes.push((vec![view], self.gradients_of_leaves(owner, view, left, &account.leaves)?));
        }
        seen.into_iter().for_each(|seen| self.density.observe(seen));
        Ok(Batch { loss, gradients, passes, held: None })
    }

    /// Has effects follow the scene on a rank that renders no view of a step, as they do before every render.
    fn follow_scene(&mut self, view: usize) {
        let (splats, camera) = (self.scene.splats(), self.views.camera(view).clone());
        let background = Some(self.background.clone());
        let extras = Extras::default().with_background(background);
        let mut input = RenderInput { splats, camera, extras, options: self.options, edits: Vec::new() };
        let at = self.at(view);
        self.effects.before(&mut input, &self.scene.gaussians, at);
    }

    /// Tells the other ranks how the own views went. Returns the own views, and the accounts of all views. If a view of
    /// any rank failed, the error of the first on every rank.
    fn settle(&mut self, own: Result<Vec<Passed>>) -> Result<(Vec<Passed>, Vec<ViewAccount>)> {
        let account = match &own {
            Ok(own) => Account::Views(own.iter().map(|one| self.account_of(one)).collect()),
            Err(TrainError::NonFinite { view, what, stage, .. }) => {
                Account::NonFinite { view: view.clone(), what: what.clone(), stage: stage.clone() }
            }
            Err(error) => Account::Failed(error.to_string()),
        };
        let mut all = Vec::new();
        for (rank, account) in gather_all(&*self.ranks, &account)?.into_iter().enumerate() {
            let failed = match account {
                Account::Views(views) => {
                    all.extend(views);
                    continue;
                }
                Account::NonFinite { view, what, stage } => {
                    TrainError::NonFinite { step: self.step, view, what, stage }
                }
                Account::Failed(message) => TrainError::OtherRank { rank, message },
            };
            return Err(if rank == self.ranks.rank() { own.err().unwrap_or(failed) } else { failed });
        }
        Ok((own?, all))
    }

    fn account_of(&mut self, one: &Passed) -> ViewAccount {
        let leaves = self.leaves(one.views[0]);
        let signals = one.seen.first().map(|seen| ([seen.gradient.is_some(), seen.abs_gradient.is_some()], seen.size));
        ViewAccount {
            loss_bits: one.loss.clone().into_scalar::<f32>().to_bits(),
            scene: one.gradients.blocks().map(|(_, gradient)| gradient.is_some()).collect(),
            leaves: leaves.iter().map(|leaf| leaf.gradient(&one.left).is_some()).collect(),
            signals,
        }
    }

    /// The parameters of effects and of the loss at a view.
    fn leaves(&mut self, view: usize) -> Vec<Leaf> {
        let mut leaves = self.effects.leaves(self.at(view));
        leaves.extend(self.loss.leaves());
        leaves
    }

    fn at(&self, view: usize) -> EffectContext<'static> {
        EffectContext { view, step: self.step, steps: self.config.steps, verdict: None }
    }

    /// Sums the gradients of all views, of which `parts` are the own ones.
    fn summed(
        &self,
        mut parts: Vec<Gradients>,
        accounts: &[ViewAccount],
        shares: &[std::ops::Range<usize>],
    ) -> Result<Gradients> {
        let mut place = 0;
        let mut summed = Gradients::default();
        for (i, group) in self.scene.gaussians.groups().iter().enumerate() {
            let mut blocks = Vec::new();
            for (j, block) in group.blocks.iter().enumerate() {
                let has = |view: &&ViewAccount| view.scene.get(place).copied().unwrap_or(false);
                let parts_of: Vec<usize> =
                    shares.iter().map(|share| accounts[share.clone()].iter().filter(has).count()).collect();
                let own = parts.iter_mut().filter_map(|part| part.0[i].blocks[j].take()).collect();
                blocks.push(self.sum(own, &parts_of, block.val().dims())?);
                place += 1;
            }
            summed.0.push(GroupGradients { name: group.name().to_owned(), blocks });
        }
        Ok(summed)
    }

    fn sum<const D: usize>(
        &self,
        parts: Vec<Tensor<D>>,
        parts_of: &[usize],
        shape: [usize; D],
    ) -> Result<Option<Tensor<D>>> {
        if parts_of.iter().all(|count| *count == 0) {
            return Ok(None);
        }
        let parts = parts.into_iter().map(values_of).collect();
        let sum = self.ranks.sum(parts, parts_of, shape.iter().product())?;
        Ok(Some(Tensor::from_data(TensorData::new(sum, shape), &self.device)))
    }

    /// The signals of a view for density control, from its rank.
    fn observed(
        &self,
        owner: usize,
        own: Option<Observed>,
        signals: [bool; 2],
        size: (usize, usize),
    ) -> Result<Observed> {
        let shape = [self.scene.gaussians.len(), 2];
        let Observed { gradient, abs_gradient, .. } = own.unwrap_or_default();
        let mut found = [gradient, abs_gradient];
        for (signal, is_there) in found.iter_mut().zip(signals) {
            if is_there {
                let mut values = signal.take().map_or_else(|| vec![0.0; 2 * shape[0]], values_of);
                self.ranks.copy(owner, &mut values)?;
                *signal = Some(Tensor::from_data(TensorData::new(values, shape), &self.device));
            }
        }
        let [gradient, abs_gradient] = found;
        Ok(Observed { gradient, abs_gradient, size })
    }

    /// The gradients of the parameters of effects and of the loss at a view: `left` on its rank, and stand-ins on the others.
    fn gradients_of_leaves(
        &mut self,
        owner: usize,
        view: usize,
        left: Option<Remaining>,
        present: &[bool],
    ) -> Result<Remaining> {
        let leaves = self.leaves(view);
        if leaves.len() != present.len() {
            let reason = format!(
                "its `Effect::leaves` and `Loss::leaves` list {} parameters, and rank {owner} has {}",
                leaves.len(),
                present.len()
            );
            return Err(RankError { rank: self.ranks.rank(), reason }.into());
        }
        let leaves: Vec<_> =
            leaves.iter().zip(present).filter(|(_, present)| **present).map(|(leaf, _)| leaf).collect();
        let mut values: Vec<f32> = match &left {
            Some(left) => leaves.iter().filter_map(|leaf| leaf.gradient(left)).flatten().collect(),
            None => vec![0.0; leaves.iter().map(|leaf| leaf.count()).sum()],
        };
        if !values.is_empty() {
            self.ranks.copy(owner, &mut values)?;
        }
        if let Some(left) = left {
            return Ok(left);
        }
        let mut rest = &values[..];
        let of_leaves = leaves.into_iter().map(|leaf| {
            let (own, others) = rest.split_at(leaf.count());
            rest = others;
            (leaf, own)
        });
        Ok(stand_in(of_leaves).unwrap_or_else(|| {
            // The loss depends on no parameter of an effect.
            Tensor::<1>::zeros([1], &self.device.clone().autodiff()).require_grad().backward()
        }))
    }

    /// Checks that all ranks begin from the same run.
    pub(super) fn agree(&mut self) -> Result<()> {
        let mut facts: Vec<Fact> = vec![("the version".into(), env!("CARGO_PKG_VERSION").into())];
        let mut state = self.save()?;
        let config: serde_json::Map<String, serde_json::Value> = state.told("config")?;
        facts.extend(config.into_iter().map(|(name, value)| (format!("the option `{name}`"), value.to_string())));
        for view in 0..self.views.len() {
            let (name, [width, height]) = (self.views.name(view), self.views.full_size(view));
            facts.push((format!("photograph {}", view + 1), format!("{name} ({width} x {height})")));
        }
        let cameras = (0..self.views.len())
            .map(|view| format!("{:?}", (self.views.camera(view).intrinsics, self.views.pose(view))));
        facts.push(("the checksum of the cameras".into(), checksum([cameras.collect::<String>().as_bytes()])));
        facts.extend(checksums(&state));
        ranks::agree(&*self.ranks, &facts)
    }

    /// Checks that all ranks have come to the same after a step: the state of effects, of the loss and of density control, random numbers,
    /// and the centres of the Gaussians.
    pub(super) fn check_together(&mut self) -> Result<()> {
        let mut state = State::default();
        state.tell("random numbers", &self.rng.get_word_pos().to_string())?;
        state.put("means", self.scene.gaussians.means().inner());
        state.in_part("density", |part| self.density.save(part))?;
        state.in_part("effects", |part| self.effects.save(part))?;
        state.in_part("loss", |part| self.loss.save(part))?;
        match ranks::first_difference(&*self.ranks, &checksums(&state))? {
            None => Ok(()),
            Some((rank, what, ..)) => Err(TrainError::Apart { step: self.step, rank, what }),
        }
    }
}

/// The entries of a state as facts.
fn checksums(state: &State) -> Vec<Fact> {
    let of = |data: &TensorData| format!("{:?} {}", data.shape().to_vec(), checksum([data.as_bytes()]));
    state.entries.iter().map(|(name, data)| (format!("`{name}`"), of(data))).collect()
}

/// The first 16 hexadecimal digits of the SHA-256.
fn checksum<'a>(bytes: impl IntoIterator<Item = &'a [u8]>) -> String {
    let mut hash = Sha256::new();
    bytes.into_iter().for_each(|bytes| hash.update(bytes));
    format!("{:.16x}", hash.finalize())
}
