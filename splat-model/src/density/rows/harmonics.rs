//! The coefficients of a scene in training, in as many tensors as its device makes necessary.

use std::ops::Range;

use burn::module::Param;
use burn::tensor::{Device, Int, Tensor};

use super::{GaussianMoments, Trained, edit_rows, indices, on, put_parameter, replace, take_parameter, untracked};
use crate::gaussians::{Gaussians, joined, parameter, sh_blocks};
use crate::optim::MomentBits;
use crate::optim::moments::{Moments, grown};
use crate::state::{State, StateError};

impl Trained {
    /// Keeps, reorders and adds rows of the coefficients. `kept` are the indices `keep` as a tensor.
    pub(super) fn edit_sh(&mut self, keep: &[u32], kept: &Tensor<1, Int>, added: &Gaussians) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let [_, coefficients, _] = g.sh.val().dims();
        if g.sh_more.is_empty() && sh_blocks(keep.len() + added.len(), coefficients, &kept.device()).len() == 1 {
            return edit_rows(&mut g.sh, &mut m.sh, kept, &added.sh);
        }
        let end = g.sh_params().map(|block| block.val().dims()[0]).sum::<usize>() as u32;
        let rows: Vec<u32> = keep.iter().copied().chain(end..end + added.len() as u32).collect();
        let added: Vec<_> = added.sh_params().map(|block| untracked(block.val())).collect();
        self.rebuild_sh(&rows, &added, coefficients);
    }

    /// Extends the spherical harmonics to `degree`. New coefficients and their moments are zero, as if they had been there
    /// from the start with zero gradients.
    pub fn grow_sh(&mut self, degree: usize) {
        let wanted = (degree + 1) * (degree + 1);
        let values = self.gaussians.sh.val().inner();
        if wanted <= values.dims()[1] {
            return;
        }
        let count = self.gaussians.len();
        if self.gaussians.sh_more.is_empty() && sh_blocks(count, wanted, &values.device()).len() == 1 {
            self.moments.sh.grow(wanted, values.dims()[2]);
            replace(&mut self.gaussians.sh, grown(values, wanted));
        } else {
            self.rebuild_sh(&(0..count as u32).collect::<Vec<_>>(), &[], wanted);
        }
    }

    /// Rebuilds the blocks of coefficients and of their moments: from the rows `rows` of the present ones followed by `added`,
    /// whose moments are zero, with zeros up to `coefficients` coefficients.
    fn rebuild_sh(&mut self, rows: &[u32], added: &[Tensor<3>], coefficients: usize) {
        let (g, m) = (&mut self.gaussians, &mut self.moments);
        let device = g.sh.val().device();
        let blocks = sh_blocks(rows.len(), coefficients, &device);
        let mut all: Vec<_> = g.sh_params().map(|block| block.val().inner()).collect();
        all.extend_from_slice(added);
        let mut all_moments: Vec<_> = m.sh_blocks().cloned().collect();
        all_moments.extend(added.iter().map(|block| m.sh.anew(block)));
        let parts: Vec<_> = blocks.into_iter().map(|block| Selected::of(&all, &rows[block])).collect();
        let moments = parts.iter().map(|part| {
            let mut moments = part.moments(&all_moments);
            moments.grow(coefficients, 3);
            moments
        });
        let values = parts.iter().map(|part| parameter(on(&device, grown(part.values(&all), coefficients))));
        (g.sh, g.sh_more) = first_and_more(values.collect());
        (m.sh, m.sh_more) = first_and_more(moments.collect());
    }
}

/// The first block, and the others.
pub(super) fn first_and_more<T>(mut blocks: Vec<T>) -> (T, Vec<T>) {
    (blocks.remove(0), blocks)
}

/// Some of the rows of several blocks, which are counted through all blocks.
struct Selected {
    /// The blocks that have such rows, and the rows within each.
    own: Vec<(usize, Tensor<1, Int>)>,
    /// The place of each row among those of `own`.
    places: Tensor<1, Int>,
}

impl Selected {
    fn of(blocks: &[Tensor<3>], rows: &[u32]) -> Self {
        let (mut found, mut place_of_row, mut first, mut count) = (Vec::new(), vec![0; rows.len()], 0, 0);
        for (i, block) in blocks.iter().enumerate() {
            let end = first + block.dims()[0] as u32;
            let mut own = Vec::new();
            for (row, place) in rows.iter().zip(&mut place_of_row).filter(|(row, _)| (first..end).contains(*row)) {
                *place = count;
                count += 1;
                own.push(row - first);
            }
            if !own.is_empty() || found.is_empty() {
                found.push((i, indices(&own, &block.device())));
            }
            first = end;
        }
        Self { own: found, places: indices(&place_of_row, &blocks[0].device()) }
    }

    fn values(&self, blocks: &[Tensor<3>]) -> Tensor<3> {
        let own = self.own.iter().map(|(block, rows)| blocks[*block].clone().select(0, rows.clone()));
        joined(own.collect()).select(0, self.places.clone())
    }

    fn moments(&self, blocks: &[Moments<3>]) -> Moments<3> {
        let own = self.own.iter().map(|(block, rows)| {
            let mut moments = blocks[*block].clone();
            moments.edit(rows, 0);
            moments
        });
        let mut all = Moments::join(own.collect());
        all.edit(&self.places, 0);
        all
    }
}

/// Saves coefficients and moments as one array each, which a host can hold.
pub(super) fn put_harmonics(state: &mut State, g: &Gaussians, m: &GaussianMoments) {
    if g.sh_more.is_empty() {
        return put_parameter(state, "sh", &g.sh, &m.sh);
    }
    let host = Device::flex();
    let values = g.sh_params().map(|block| untracked(block.val()).to_device(&host)).collect();
    let moments = m.sh_blocks().zip(g.sh_params()).map(|(block, of)| block.rows(0, of.val().dims()[0], &host));
    put_parameter(state, "sh", &parameter(joined(values)), &Moments::join(moments.collect()));
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
