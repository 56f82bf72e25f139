//! A scene in training, and the one edit of its rows: the only place that changes rows of parameters and of their moments.

mod gradients;
mod state;
mod step;

use std::ops::Range;

use burn::module::ParamId;
use burn::tensor::{Int, Tensor};
use splat_op::Splats;

pub use self::gradients::{Gradients, GroupGradients};
pub use self::step::StepRates;
use self::step::{on, replace, take};
use super::pick::all_rows;
use crate::gaussians::{BASE_GROUPS, Gaussians, Group, NewRows, RowsError, SH, parameter, row_blocks};
use crate::optim::MomentBits;
use crate::optim::moments::{Moments, Stored, followed, gathered, grown};

/// A scene in training: parameters and moments, always with the same rows.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The parameters.
    pub gaussians: Gaussians,
    /// The moments of each block of each group.
    pub(crate) moments: Vec<Vec<Moments<2>>>,
    /// The mark of the last step on a GPU (see [`splat_op::adam`]), and the coefficients that it holds for.
    mark: Option<(ParamId, Tensor<1, Int>)>,
}

/// One edit of all rows of a scene, on its device: where each row comes from, which rows are new, and what is different in them.
/// Every group follows it, whatever groups there are.
#[derive(Clone, Debug)]
pub struct RowEdit {
    /// `[M]`: the row that each row comes from. A row may come from one that others come from too.
    source: Tensor<1, Int>,
    /// Number of rows that stay, with their moments. The rows after them are new: their moments are zero.
    kept: usize,
    /// Values of the new rows that differ from those that they come from, `[new rows, numbers per row]`, by group.
    changes: Vec<(&'static str, Tensor<2>)>,
}

impl RowEdit {
    /// Keeps the rows `keep`, `[K]`, in this order, and appends a new row for each of `copied`, `[F]`, with the same values,
    /// or those of [`NewRows`].
    pub fn new(keep: Tensor<1, Int>, copied: Tensor<1, Int>) -> Self {
        let kept = keep.dims()[0];
        let source = if copied.dims()[0] == 0 { keep } else { Tensor::cat(vec![keep, copied], 0) };
        Self { source, kept, changes: Vec::new() }
    }

    /// Gives the new rows other values of the group of that name, `[F, …]`.
    pub fn with<const D: usize>(mut self, group: &'static str, values: Tensor<D>) -> Self {
        let rows = values.dims()[0];
        let numbers = values.shape().num_elements();
        self.changes.push((group, values.reshape([rows, numbers.checked_div(rows).unwrap_or(0)])));
        self
    }

    fn added(&self) -> usize {
        self.source.dims()[0] - self.kept
    }

    /// The values of the new rows of a group, if they differ from those that they come from.
    fn change(&self, group: &Group) -> Option<Tensor<2>> {
        let named = self.changes.iter().rev().find(|(name, _)| *name == group.name());
        named.map(|(_, values)| values.clone()).or_else(|| match group.options().new_rows {
            NewRows::Copied => None,
            NewRows::Filled(value) => {
                let values = group.blocks[0].val().inner();
                Some(Tensor::full([self.added(), group.width()], value, (&values.device(), values.dtype())))
            }
        })
    }

    /// Edits a group and its moments, whose rows have `width` numbers afterwards: new numbers are zero.
    fn apply(&self, group: &mut Group, moments: &mut Vec<Moments<2>>, width: usize) {
        let device = group.blocks[0].val().device();
        let change = self.change(group);
        let blocks = row_blocks(group.name(), self.source.dims()[0], width, &device);
        let part = |rows: &Range<usize>| {
            let source = match rows.is_empty() || rows.len() == self.source.dims()[0] {
                true => self.source.clone(),
                false => self.source.clone().narrow(0, rows.start, rows.len()),
            };
            (source, self.kept.clamp(rows.start, rows.end) - rows.start)
        };
        // One after the other, so that no more than one of them is in memory twice.
        let old: Vec<Stored<2>> = moments.iter_mut().map(Moments::take).collect();
        let of_block = |rows: &Range<usize>| {
            let (source, kept) = part(rows);
            let mut moments = Moments::gathered(&old, &source, kept);
            moments.grow(width);
            moments
        };
        *moments = blocks.iter().map(of_block).collect();
        drop(old);
        let old: Vec<_> = group.blocks.iter_mut().map(take).collect();
        let of_block = |rows: &Range<usize>| {
            let (source, kept) = part(rows);
            let values = match change.as_ref().filter(|_| kept < rows.len()) {
                None => gathered(&old, &source),
                Some(new) if rows.len() == self.source.dims()[0] => followed(&old, &source, kept, new.clone()),
                Some(new) => {
                    let first = rows.start + kept - self.kept;
                    followed(&old, &source, kept, new.clone().narrow(0, first, rows.len() - kept))
                }
            };
            parameter(on(&device, grown(values, width)))
        };
        group.blocks = blocks.iter().map(of_block).collect();
    }
}

impl Trained {
    /// A scene with zero moments.
    pub fn new(gaussians: Gaussians) -> Self {
        Self::with_bits(gaussians, MomentBits::ThirtyTwo)
    }

    /// A scene with zero moments of so many bits.
    pub fn with_bits(gaussians: Gaussians, bits: MomentBits) -> Self {
        let moments = gaussians.groups().iter().map(|group| without_history(group, bits)).collect();
        Self { gaussians, moments, mark: None }
    }

    /// Adds a group, with zero moments.
    ///
    /// # Errors
    /// If there is a group of that name, or if the number of rows differs.
    pub fn with_group(self, group: Group) -> Result<Self, RowsError> {
        let Self { gaussians, mut moments, mark } = self;
        moments.push(without_history(&group, moments[0][0].bits()));
        Ok(Self { gaussians: gaussians.with_group(group)?, moments, mark })
    }

    /// The Gaussians with activated parameters, see [`Gaussians::splats`].
    pub fn splats(&self) -> Splats {
        // Whatever replaces coefficients gives them another identity.
        let mark = self.mark.as_ref().filter(|(id, _)| *id == self.gaussians.sh_id());
        self.gaussians.splats_with(mark.map(|(_, mark)| mark))
    }

    /// Has all coefficients looked at again, after code that may have changed them.
    pub(crate) fn forget_mark(&mut self) {
        self.mark = None;
    }

    /// Keeps, reorders and adds rows. The rows that the edit names must exist, which nobody checks, because they are on the device.
    ///
    /// # Errors
    /// If a change is of no group, or has another number of rows or of numbers. Nothing changes then.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowsError> {
        edit.changes.iter().try_for_each(|(name, values)| self.check(name, values, edit.added()))?;
        for (group, moments) in self.gaussians.groups.iter_mut().zip(&mut self.moments) {
            let width = group.width();
            edit.apply(group, moments, width);
        }
        Ok(())
    }

    fn check(&self, name: &str, values: &Tensor<2>, count: usize) -> Result<(), RowsError> {
        let width = self.gaussians.group(name).map_or(0, Group::width);
        let (found, expected) = (values.shape().num_elements(), count * width);
        match found == expected && width > 0 {
            true => Ok(()),
            false => Err(RowsError::length(name, found, expected, count, self.gaussians.sh_degree())),
        }
    }

    /// Extends the spherical harmonics to `degree`. New coefficients and their moments are zero, as if they had been there
    /// from the start with zero gradients.
    pub fn grow_sh(&mut self, degree: usize) {
        let (wanted, count) = (3 * (degree + 1) * (degree + 1), self.gaussians.len());
        let (group, moments) = (&mut self.gaussians.groups[SH], &mut self.moments[SH]);
        if wanted <= group.width() {
            return;
        }
        let device = group.blocks[0].val().device();
        if let ([block], [moments]) = (&mut group.blocks[..], &mut moments[..])
            && row_blocks(BASE_GROUPS[SH], count, wanted, &device).len() == 1
        {
            moments.grow(wanted);
            let values = block.val().inner();
            return replace(block, grown(values, wanted));
        }
        let rows = all_rows(count, &device.inner());
        RowEdit { source: rows, kept: count, changes: Vec::new() }.apply(group, moments, wanted);
    }

    /// Replaces the opacities' logits, and resets the groups that have a value for it ([`GroupOptions::reset`]). The moments of both
    /// become zero.
    ///
    /// [`GroupOptions::reset`]: crate::gaussians::GroupOptions::reset
    pub fn reset_opacities(&mut self, logits: Tensor<1>) {
        let bits = self.moments[0][0].bits();
        let (opacities, count) = (BASE_GROUPS[3], logits.dims()[0]);
        for (group, moments) in self.gaussians.groups.iter_mut().zip(&mut self.moments) {
            let shape = [count, group.width()];
            let values = match group.options().reset {
                _ if group.name() == opacities => logits.clone().reshape(shape),
                Some(value) if !BASE_GROUPS.contains(&group.name()) => {
                    Tensor::full(shape, value, (&logits.device(), logits.dtype()))
                }
                _ => continue,
            };
            replace(&mut group.blocks[0], values);
            *moments = without_history(group, bits);
        }
    }

    /// Replaces the centres and keeps their moments.
    pub fn replace_means(&mut self, means: Tensor<2>) {
        replace(&mut self.gaussians.groups[0].blocks[0], means);
    }

    /// Replaces the logarithms of the standard deviations and keeps their moments.
    pub fn replace_log_scales(&mut self, log_scales: Tensor<2>) {
        replace(&mut self.gaussians.groups[2].blocks[0], log_scales);
    }
}

/// Moments without history, of so many bits.
fn without_history(group: &Group, bits: MomentBits) -> Vec<Moments<2>> {
    group.blocks.iter().map(|block| Moments::with_bits(&block.val(), bits)).collect()
}

#[cfg(test)]
mod tests;
