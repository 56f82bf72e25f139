//! A scene in training, and the one edit of its rows: the only place that changes rows of parameters and of their moments.

mod gradients;
mod harmonics;
mod state;
mod step;

use burn::module::{Param, ParamId};
use burn::tensor::{Int, Tensor};
use splat_op::Splats;

pub use self::gradients::Gradients;
pub(crate) use self::step::GaussianMoments;
pub use self::step::StepRates;
use self::step::{on, replace, take};
use crate::gaussians::{Gaussians, RowsError, parameter};
use crate::optim::MomentBits;
use crate::optim::moments::{Moments, followed, gathered};

/// A scene in training: parameters and moments, always with the same rows.
#[derive(Clone, Debug)]
pub struct Trained {
    /// The parameters.
    pub gaussians: Gaussians,
    pub(crate) moments: GaussianMoments,
    /// The mark of the last step on a GPU (see [`splat_op::adam`]), and the coefficients that it holds for.
    mark: Option<(ParamId, Tensor<1, Int>)>,
}

/// One edit of all rows of a scene, on its device: where each row comes from, which rows are new, and what is different in them.
/// Every parameter follows it, whatever parameters there are.
#[derive(Clone, Debug)]
pub struct RowEdit {
    /// `[M]`: the row that each row comes from. A row may come from one that others come from too.
    source: Tensor<1, Int>,
    /// Number of rows that stay, with their moments. The rows after them are new: their moments are zero.
    kept: usize,
    /// Values of the new rows that differ from those that they come from, `[new rows, numbers per row]`, by parameter.
    changes: Vec<(&'static str, Tensor<2>)>,
}

impl RowEdit {
    /// Keeps the rows `keep`, `[K]`, in this order, and appends a new row for each of `copied`, `[F]`, with the same values.
    pub fn new(keep: Tensor<1, Int>, copied: Tensor<1, Int>) -> Self {
        let kept = keep.dims()[0];
        let source = if copied.dims()[0] == 0 { keep } else { Tensor::cat(vec![keep, copied], 0) };
        Self { source, kept, changes: Vec::new() }
    }

    /// Gives the new rows other values of the parameter of that name (a field of [`Gaussians`]), `[F, …]`.
    pub fn with<const D: usize>(mut self, parameter: &'static str, values: Tensor<D>) -> Self {
        let rows = values.dims()[0];
        let numbers = values.shape().num_elements();
        self.changes.push((parameter, values.reshape([rows, numbers.checked_div(rows).unwrap_or(0)])));
        self
    }

    fn added(&self) -> usize {
        self.source.dims()[0] - self.kept
    }

    fn change(&self, parameter: &str) -> Option<&Tensor<2>> {
        self.changes.iter().rev().find(|(name, _)| *name == parameter).map(|(_, values)| values)
    }

    /// Edits a parameter and its moments.
    fn apply<const D: usize>(&self, name: &str, param: &mut Param<Tensor<D>>, moments: &mut Moments<D>) {
        let device = param.val().device();
        *moments = Moments::gathered(&[moments.take()], &self.source, self.kept);
        let old = [take(param)];
        let values = match self.change(name) {
            None => gathered(&old, &self.source),
            Some(new) => {
                let mut shape = old[0].dims();
                shape[0] = self.added();
                followed(&old, &self.source, self.kept, new.clone().reshape(shape))
            }
        };
        *param = parameter(on(&device, values));
    }
}

impl Trained {
    /// A scene with zero moments.
    pub fn new(gaussians: Gaussians) -> Self {
        Self::with_bits(gaussians, MomentBits::ThirtyTwo)
    }

    /// A scene with zero moments of so many bits.
    pub fn with_bits(gaussians: Gaussians, bits: MomentBits) -> Self {
        let moments = GaussianMoments::new(&gaussians, bits);
        Self { gaussians, moments, mark: None }
    }

    /// The Gaussians with activated parameters, see [`Gaussians::splats`].
    pub(crate) fn splats(&self) -> Splats {
        // Whatever replaces coefficients gives them another identity.
        let mark = self.mark.as_ref().filter(|(id, _)| *id == self.gaussians.sh.id);
        self.gaussians.splats_with(mark.map(|(_, mark)| mark))
    }

    /// Has all coefficients looked at again, after code that may have changed them.
    pub(crate) fn forget_mark(&mut self) {
        self.mark = None;
    }

    /// Keeps, reorders and adds rows. The rows that the edit names must exist, which nobody checks, because they are on the device.
    ///
    /// # Errors
    /// If a change is of no parameter, or has another number of rows or of numbers. Nothing changes then.
    pub fn edit(&mut self, edit: &RowEdit) -> Result<(), RowsError> {
        edit.changes.iter().try_for_each(|(name, values)| self.check(name, values, edit.added()))?;
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        edit.apply("means", &mut g.means, &mut m.means);
        edit.apply("rotations", &mut g.rotations, &mut m.rotations);
        edit.apply("log_scales", &mut g.log_scales, &mut m.log_scales);
        edit.apply("logit_opacities", &mut g.logit_opacities, &mut m.logit_opacities);
        self.edit_sh(edit);
        Ok(())
    }

    fn check(&self, field: &'static str, values: &Tensor<2>, added: usize) -> Result<(), RowsError> {
        let sh_degree = self.gaussians.sh_degree();
        let width = match field {
            "means" | "log_scales" => 3,
            "rotations" => 4,
            "logit_opacities" => 1,
            "sh" => 3 * (sh_degree + 1) * (sh_degree + 1),
            _ => 0,
        };
        let (found, expected) = (values.shape().num_elements(), added * width);
        match found == expected && width > 0 {
            true => Ok(()),
            false => Err(RowsError { field, found, expected, count: added, sh_degree }),
        }
    }

    /// Replaces the opacities' logits and sets their moments to zero.
    pub fn reset_opacities(&mut self, logits: Tensor<1>) {
        self.moments.logit_opacities = self.moments.logit_opacities.anew(&logits);
        replace(&mut self.gaussians.logit_opacities, logits);
    }

    /// Replaces the centres and keeps their moments.
    pub fn replace_means(&mut self, means: Tensor<2>) {
        replace(&mut self.gaussians.means, means);
    }

    /// Replaces the logarithms of the standard deviations and keeps their moments.
    pub fn replace_log_scales(&mut self, log_scales: Tensor<2>) {
        replace(&mut self.gaussians.log_scales, log_scales);
    }
}

#[cfg(test)]
mod tests;
