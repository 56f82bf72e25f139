//! A scene in training, and the one edit of its rows: the only place that changes rows of parameters and of their moments.

mod edit;
mod gradients;
mod state;
mod step;

use burn::module::ParamId;
use burn::tensor::{Int, Tensor};
use splat_op::Splats;

pub use self::edit::RowEdit;
pub use self::gradients::{Gradients, GroupGradients};
pub use self::step::StepRates;
use self::step::replace;
use crate::gaussians::{BASE_GROUPS, Gaussians, Group, RowsError, SH, row_blocks};
use crate::optim::MomentBits;
use crate::optim::moments::{Moments, grown};

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
        edit.check(&self.gaussians)?;
        for (group, moments) in self.gaussians.groups.iter_mut().zip(&mut self.moments) {
            let width = group.width();
            edit.apply(group, moments, width);
        }
        Ok(())
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
        RowEdit::none(count, &device.inner()).apply(group, moments, wanted);
    }

    /// Replaces the opacities' logits, and resets the groups that have a value for it ([`GroupOptions::reset`]). The moments of both
    /// become zero.
    ///
    /// [`GroupOptions::reset`]: crate::gaussians::GroupOptions::reset
    pub fn reset_opacities(&mut self, logits: Tensor<1>) {
        let bits = self.moments[0][0].bits();
        let (opacities, count) = (BASE_GROUPS[3], logits.dims()[0]);
        if count == 0 {
            return;
        }
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
