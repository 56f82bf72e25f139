//! The coefficients of a scene in training, in as many tensors as its device makes necessary.

use std::ops::Range;

use burn::module::Param;
use burn::tensor::{DType, Device, Int, Tensor};

use super::state::{put_parameter, take_parameter, untracked};
use super::step::{on, replace};
use super::{GaussianMoments, RowEdit, Trained};
use crate::gaussians::{Gaussians, joined, parameter, sh_blocks};
use crate::optim::MomentBits;
use crate::optim::moments::{Moments, Stored, followed, gathered, grown};
use crate::state::{State, StateError};

impl Trained {
    /// Keeps, reorders and adds rows of the coefficients.
    pub(super) fn edit_sh(&mut self, edit: &RowEdit) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let [_, coefficients, _] = g.sh.val().dims();
        if g.sh_more.is_empty() && sh_blocks(edit.source.dims()[0], coefficients, &edit.source.device()).len() == 1 {
            return edit.apply("sh", &mut g.sh, &mut m.sh);
        }
        self.rebuild_sh(edit, coefficients);
    }

    /// Extends the spherical harmonics to `degree`. New coefficients and their moments are zero, as if they had been there
    /// from the start with zero gradients.
    pub fn grow_sh(&mut self, degree: usize) {
        let wanted = (degree + 1) * (degree + 1);
        let values = self.gaussians.sh.val().inner();
        if wanted <= values.dims()[1] {
            return;
        }
        let (count, device) = (self.gaussians.len(), values.device());
        if self.gaussians.sh_more.is_empty() && sh_blocks(count, wanted, &device).len() == 1 {
            self.moments.sh.grow(wanted, values.dims()[2]);
            replace(&mut self.gaussians.sh, grown(values, wanted));
        } else {
            let none = Tensor::empty([0], (&device, DType::I32));
            self.rebuild_sh(&RowEdit::new(all_rows(count, &device), none), wanted);
        }
    }

    /// Rebuilds the blocks of coefficients and of their moments by an edit, with zeros up to `coefficients` coefficients.
    fn rebuild_sh(&mut self, edit: &RowEdit, coefficients: usize) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let device = g.sh.val().device();
        let old: Vec<_> = g.sh_params().map(|block| block.val().inner()).collect();
        let old_moments: Vec<Stored<3>> = m.sh_blocks().map(|block| block.stored().clone()).collect();
        let parts = sh_blocks(edit.source.dims()[0], coefficients, &device).into_iter().map(|rows| {
            let all = edit.source.clone();
            let source = if rows.is_empty() { all } else { all.narrow(0, rows.start, rows.len()) };
            let kept = edit.kept.clamp(rows.start, rows.end) - rows.start;
            let values = match edit.change("sh").filter(|_| kept < rows.len()) {
                None => gathered(&old, &source),
                Some(new) => {
                    let mut shape = old[0].dims();
                    shape[0] = rows.len() - kept;
                    let new = new.clone().narrow(0, rows.start + kept - edit.kept, shape[0]).reshape(shape);
                    followed(&old, &source, kept, new)
                }
            };
            let mut moments = Moments::gathered(&old_moments, &source, kept);
            moments.grow(coefficients, 3);
            (parameter(on(&device, grown(values, coefficients))), moments)
        });
        let (values, moments) = parts.unzip();
        (g.sh, g.sh_more) = first_and_more(values);
        (m.sh, m.sh_more) = first_and_more(moments);
    }
}

fn all_rows(count: usize, device: &Device) -> Tensor<1, Int> {
    Tensor::arange(0..count as i64, (device, DType::I32))
}

/// The first block, and the others.
pub(super) fn first_and_more<T>(mut blocks: Vec<T>) -> (T, Vec<T>) {
    (blocks.remove(0), blocks)
}

/// Saves coefficients and moments as one array each, which a host can hold.
pub(super) fn put_harmonics(state: &mut State, g: &Gaussians, m: &GaussianMoments) {
    if g.sh_more.is_empty() {
        return put_parameter(state, "sh", &g.sh, &m.sh);
    }
    let host = Device::flex();
    let values = g.sh_params().map(|block| untracked(block.val()).to_device(&host)).collect();
    let moments = m.sh_blocks().zip(g.sh_params()).map(|(block, of)| block.rows(0, of.val().dims()[0], &host).take());
    let moments = Moments::gathered(&moments.collect::<Vec<_>>(), &all_rows(g.len(), &host), g.len());
    put_parameter(state, "sh", &parameter(joined(values)), &moments);
}

/// Blocks of coefficients, and their moments.
type Blocks = (Vec<Param<Tensor<3>>>, Vec<Moments<3>>);

/// Loads coefficients and moments in blocks for a device. Returns an error if `fits` rejects their shape.
pub(super) fn take_harmonics(
    from: &mut State,
    (bits, device): (MomentBits, &Device),
    fits: impl Fn(&[usize; 3]) -> bool,
) -> Result<Blocks, StateError> {
    // One array may be too large for the device.
    let (sh, moments) = take_parameter::<3>(from, "sh", (bits, &Device::flex()), fits)?;
    let sh = sh.into_value();
    let [count, coefficients, _] = sh.dims();
    let block = |rows: Range<usize>| {
        let plain = device.clone().inner();
        let part = if rows.len() == count { sh.clone() } else { sh.clone().narrow(0, rows.start, rows.len()) };
        (parameter(on(device, part.to_device(&plain))), moments.rows(rows.start, rows.len(), &plain))
    };
    Ok(sh_blocks(count, coefficients, device).into_iter().map(block).unzip())
}
