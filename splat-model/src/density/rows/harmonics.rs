//! The coefficients of a scene in training, in as many tensors as its device makes necessary.

use std::ops::Range;

use burn::module::Param;
use burn::tensor::{Device, Int, Tensor};

use super::{GaussianMoments, Trained, edit_rows, indices, on, put_parameter, replace, take_parameter, untracked};
use crate::gaussians::{Gaussians, joined, parameter, sh_blocks};
use crate::optim::Moments;
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
            self.moments.sh.m.inplace(|m| grown(m, wanted));
            self.moments.sh.v.inplace(|v| grown(v, wanted));
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
        let zeros: Vec<_> = added.iter().map(Tensor::zeros_like).collect();
        let rebuilt = |old: Vec<Tensor<3>>, added: &[Tensor<3>]| {
            let all = [&old[..], added].concat();
            blocks.iter().map(|block| grown(selected(&all, &rows[block.clone()]), coefficients)).collect::<Vec<_>>()
        };
        let values = rebuilt(g.sh_params().map(|block| block.val().inner()).collect(), added);
        let of_m = rebuilt(m.sh_blocks().map(|block| block.m.clone()).collect(), &zeros);
        let of_v = rebuilt(m.sh_blocks().map(|block| block.v.clone()).collect(), &zeros);
        let moments = of_m.into_iter().zip(of_v).map(|(m, v)| Moments { m, v });
        let values = values.into_iter().map(|values| parameter(on(&device, values)));
        (g.sh, g.sh_more) = first_and_more(values.collect());
        (m.sh, m.sh_more) = first_and_more(moments.collect());
    }
}

/// The first block, and the others.
pub(super) fn first_and_more<T>(mut blocks: Vec<T>) -> (T, Vec<T>) {
    (blocks.remove(0), blocks)
}

/// The rows `rows` of the rows of several blocks, which are counted through all blocks.
fn selected(blocks: &[Tensor<3>], rows: &[u32]) -> Tensor<3> {
    let (mut found, mut place_of_row, mut first) = (Vec::new(), vec![0; rows.len()], 0);
    let mut count = 0;
    for block in blocks {
        let end = first + block.dims()[0] as u32;
        let mut own = Vec::new();
        for (row, place) in rows.iter().zip(&mut place_of_row).filter(|(row, _)| (first..end).contains(*row)) {
            *place = count;
            count += 1;
            own.push(row - first);
        }
        if !own.is_empty() || found.is_empty() {
            found.push(block.clone().select(0, indices(&own, &block.device())));
        }
        first = end;
    }
    let places = indices(&place_of_row, &found[0].device());
    joined(found).select(0, places)
}

/// Coefficients with zeros up to a number per Gaussian.
fn grown(values: Tensor<3>, coefficients: usize) -> Tensor<3> {
    let [count, have, channels] = values.dims();
    if have == coefficients {
        return values;
    }
    let zeros = Tensor::zeros([count, coefficients - have, channels], (&values.device(), values.dtype()));
    Tensor::cat(vec![values, zeros], 1)
}

/// Saves coefficients and moments as one array each, which a host can hold.
pub(super) fn put_harmonics(state: &mut State, g: &Gaussians, m: &GaussianMoments) {
    if g.sh_more.is_empty() {
        return put_parameter(state, "sh", &g.sh, &m.sh);
    }
    let on_host =
        |blocks: Vec<Tensor<3>>| joined(blocks.into_iter().map(|block| block.to_device(&Device::flex())).collect());
    let values = on_host(g.sh_params().map(|block| untracked(block.val())).collect());
    let of_m = on_host(m.sh_blocks().map(|block| block.m.clone()).collect());
    let of_v = on_host(m.sh_blocks().map(|block| block.v.clone()).collect());
    put_parameter(state, "sh", &parameter(values), &Moments { m: of_m, v: of_v });
}

/// Blocks of coefficients, and their moments.
type Blocks = (Vec<Param<Tensor<3>>>, Vec<Moments<3>>);

/// Loads coefficients and moments in blocks for a device. Returns an error if `fits` rejects their shape.
pub(super) fn take_harmonics(
    from: &mut State,
    device: &Device,
    fits: impl Fn(&[usize; 3]) -> bool,
) -> Result<Blocks, StateError> {
    // One array may be too large for the device.
    let (sh, moments) = take_parameter::<3>(from, "sh", &Device::flex(), fits)?;
    let sh = sh.into_value();
    let [count, coefficients, _] = sh.dims();
    let block = |rows: Range<usize>| {
        let of = |all: &Tensor<3>| {
            let part = if rows.len() == count { all.clone() } else { all.clone().narrow(0, rows.start, rows.len()) };
            part.to_device(&device.clone().inner())
        };
        (parameter(on(device, of(&sh))), Moments { m: of(&moments.m), v: of(&moments.v) })
    };
    Ok(sh_blocks(count, coefficients, device).into_iter().map(block).unzip())
}
