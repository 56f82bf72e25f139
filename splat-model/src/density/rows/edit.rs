//! One edit of all rows of a scene.

use std::ops::Range;

use burn::module::Param;
use burn::tensor::{Device, Int, Tensor};

use super::step::{on, take};
use crate::density::pick::{all_rows, rows_on};
use crate::gaussians::{Gaussians, Group, NewRows, RowsError, row_blocks};
use crate::optim::moments::{Moments, Stored, followed, gathered, grown};

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

    /// Keeps all of so many rows.
    pub(super) fn none(count: usize, device: &Device) -> Self {
        Self::new(all_rows(count, device), rows_on(device, &[]))
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

    /// Refuses changes of groups that the scene does not have, or with other numbers of rows or of numbers.
    pub(super) fn check(&self, gaussians: &Gaussians) -> Result<(), RowsError> {
        let count = self.added();
        self.changes.iter().try_for_each(|(name, values)| {
            let width = gaussians.group(name).map_or(0, Group::width);
            let (found, expected) = (values.shape().num_elements(), count * width);
            match found == expected && width > 0 {
                true => Ok(()),
                false => Err(RowsError::length(name, found, expected, count, gaussians.sh_degree())),
            }
        })
    }

    /// The values of the new rows of a group, if they differ from those that they come from.
    fn change(&self, group: &Group) -> Option<Tensor<2>> {
        let named = self.changes.iter().rev().find(|(name, _)| *name == group.name());
        named.map(|(_, values)| values.clone()).or_else(|| match group.options().new_rows {
            NewRows::Filled(value) if self.added() > 0 => {
                let values = group.blocks[0].val().inner();
                Some(Tensor::full([self.added(), group.width()], value, (&values.device(), values.dtype())))
            }
            _ => None,
        })
    }

    /// Edits a group and its moments, whose rows have `width` numbers afterwards: new numbers are zero.
    pub(super) fn apply(&self, group: &mut Group, moments: &mut Vec<Moments<2>>, width: usize) {
        let device = group.blocks[0].val().device();
        let change = self.change(group);
        let blocks = row_blocks(group.name(), self.source.dims()[0], width, &device);
        let part = |rows: &Range<usize>| {
            let source = self.source.clone().slice([rows.clone()]);
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
                Some(new) => {
                    let new = new.clone().narrow(0, rows.start + kept - self.kept, rows.len() - kept);
                    followed(&old, &source, kept, new)
                }
            };
            Param::from_tensor(on(&device, grown(values, width)))
        };
        group.blocks = blocks.iter().map(of_block).collect();
    }
}
