//! The scene: Gaussians with unconstrained parameters, as a Burn module of named groups.

mod group;
mod options;
mod rows;

use std::ops::Range;

use burn::module::{Module, Param, ParamId};
use burn::tensor::{Device, Gradients, Int, Tensor, activation};
use splat_op::{Colour, RawSplats, Splats, activate};

pub use self::group::{Group, values_of};
pub(crate) use self::group::{joined, row_blocks};
pub use self::options::{Activation, BASE_GROUPS, GroupOptions, NewRows, RowsError};
pub(crate) use self::options::{SH, check_name};
use self::rows::interleaved;
pub use self::rows::{GaussianRows, GroupRows};

/// The spherical harmonic of degree 0, `1 / (2 √π)`: a colour is `0.5 + DC sh_dc`.
pub const DC: f64 = 0.282_094_791_773_878_14;

/// A scene's parameters as tensors, unconstrained: any finite value is valid, so an optimiser may step freely.
///
/// They are groups with a row for each Gaussian. The first five are those of [`BASE_GROUPS`]; [`Self::with_group`] adds others, which
/// density control, Adam, checkpoints and scene files carry along.
#[derive(Module, Debug)]
pub struct Gaussians {
    pub(crate) groups: Vec<Group>,
}

/// Gaussians that are in the host's memory at a time where a scene is read, copied or written in parts: 15 MB at degree 3.
pub const ROWS_AT_ONCE: usize = 1 << 16;

impl Gaussians {
    /// Creates a scene from rows on `device`, trainable if the device is an autodiff device.
    ///
    /// # Errors
    /// If the rows' fields differ in length.
    pub fn from_rows(rows: &GaussianRows, device: &Device) -> Result<Self, RowsError> {
        Self::from_own_rows(rows.clone(), device)
    }

    /// As [`Self::from_rows`], in the memory of the rows where the device's is the host's: a scene need not be in memory twice.
    ///
    /// # Errors
    /// If the rows' fields differ in length.
    pub fn from_own_rows(rows: GaussianRows, device: &Device) -> Result<Self, RowsError> {
        rows.check()?;
        let (count, of_sh) = (rows.len(), rows.rest_per_row() + 3);
        let GaussianRows { means, rotations, log_scales, logit_opacities, sh_dc, sh_rest, groups, .. } = rows;
        let [of_means, of_rotations, of_scales, of_opacities, of_harmonics] = BASE_GROUPS;
        let group = |name, width, numbers| Group::of_numbers(name, count, width, numbers, device);
        let mut all = vec![
            group(of_means, 3, means.into_flattened()),
            group(of_rotations, 4, rotations.into_flattened()),
            group(of_scales, 3, log_scales.into_flattened()),
            group(of_opacities, 1, logit_opacities),
            group(of_harmonics, of_sh, interleaved(sh_dc, sh_rest)),
        ];
        for GroupRows { name, width, values, options } in groups {
            let mut group = Group::of_numbers(&name, count, width, values, device);
            group.set_options(options);
            all.push(group);
        }
        Ok(Self { groups: all })
    }

    /// Adds a group, tracked if the scene is.
    ///
    /// # Errors
    /// If there is a group of that name, if the number of rows, the device or the float type differs, or if the group exceeds the
    /// device's largest tensor ([`splat_op::largest_tensor`]).
    pub fn with_group(mut self, group: Group) -> Result<Self, RowsError> {
        let (count, sh_degree, width) = (self.len(), self.sh_degree(), group.width());
        if self.group(group.name()).is_some() {
            return Err(RowsError::taken(group.name()));
        }
        if group.rows() != count {
            let (found, expected) = (group.rows() * width, count * width);
            return Err(RowsError::length(group.name(), found, expected, count, sh_degree));
        }
        let (own, new) = (self.means(), group.raw());
        if own.device().inner() != new.device().inner() || own.dtype() != new.dtype() {
            let of = |values: &Tensor<2>| format!("on {:?} in {:?}", values.device(), values.dtype());
            let found = format!("the group `{}` is {}", group.name(), of(&new));
            return Err(RowsError(format!("{found}, expected {}", of(&own))));
        }
        let (bytes, most) = (4 * (count * width) as u64, splat_op::largest_tensor(&own.device()));
        if bytes > most {
            let found = format!("the group `{}` is {bytes} bytes large", group.name());
            return Err(RowsError(format!("{found}, expected at most {most} on this device")));
        }
        let values = match (own.is_autodiff(), new.is_autodiff()) {
            (true, false) => Tensor::from_inner(new),
            (false, true) => new.inner(),
            _ => new,
        };
        self.groups.push(Group::of_blocks(group.name(), vec![Param::from_tensor(values)], *group.options()));
        Ok(self)
    }

    /// Copies the rows of the scene to the host.
    pub fn to_rows(&self) -> GaussianRows {
        let (mut rows, count) = (self.no_rows(), self.len());
        rows.reserve_exact(count);
        for first in (0..count).step_by(ROWS_AT_ONCE) {
            self.copy_rows(first..count.min(first + ROWS_AT_ONCE), &mut rows);
        }
        rows
    }

    /// Copies some rows of the scene to the host.
    ///
    /// # Panics
    /// If there are no such rows.
    pub fn rows_in(&self, which: Range<usize>) -> GaussianRows {
        let mut rows = self.no_rows();
        self.copy_rows(which, &mut rows);
        rows
    }

    /// No rows, of the scene's degree and groups.
    pub(crate) fn no_rows(&self) -> GaussianRows {
        let groups = self.groups[BASE_GROUPS.len()..].iter().map(Group::about).collect();
        GaussianRows { sh_degree: self.sh_degree(), groups, ..GaussianRows::default() }
    }

    /// Appends some rows of the scene.
    fn copy_rows(&self, which: Range<usize>, to: &mut GaussianRows) {
        let (own, further) = self.groups.split_at(BASE_GROUPS.len());
        let numbers = |group: &Group| {
            let mut numbers = Vec::new();
            group.copy(&which, &mut numbers);
            numbers
        };
        to.means.extend(numbers(&own[0]).as_chunks().0);
        to.rotations.extend(numbers(&own[1]).as_chunks().0);
        to.log_scales.extend(numbers(&own[2]).as_chunks().0);
        to.logit_opacities.extend(numbers(&own[3]));
        to.set_sh(&numbers(&own[SH]));
        further.iter().zip(&mut to.groups).for_each(|(group, to)| group.copy(&which, &mut to.values));
    }

    /// All groups, those of [`BASE_GROUPS`] first.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// The group of that name.
    pub fn group(&self, name: &str) -> Option<&Group> {
        self.groups.iter().find(|group| group.name() == name)
    }

    /// `[N, width]`: the gradient of the group of that name, which stays in `gradients`. `None` if the loss does not depend on it.
    pub fn gradient(&self, name: &str, gradients: &Gradients) -> Option<Tensor<2>> {
        let blocks = self.group(name)?.blocks.iter().map(|block| block.val().grad(gradients));
        Some(joined(blocks.collect::<Option<_>>()?))
    }

    /// `[N, 3]`: centres, world frame, scene units.
    pub fn means(&self) -> Tensor<2> {
        self.groups[0].raw()
    }

    /// `[N, 4]`: quaternions wxyz, world-from-Gaussian; normalised where they are used.
    pub fn rotations(&self) -> Tensor<2> {
        self.groups[1].raw()
    }

    /// `[N, 3]`: natural logarithms of the standard deviations.
    pub fn log_scales(&self) -> Tensor<2> {
        self.groups[2].raw()
    }

    /// `[N]`: logits of the opacities. Their gradient is that of the group: [`Self::gradient`].
    pub fn logit_opacities(&self) -> Tensor<1> {
        self.groups[3].raw().reshape([self.len()])
    }

    /// Coefficients of the spherical harmonics, `[n, (degree+1)², 3]`, degree 0 first, of consecutive Gaussians. There is one block
    /// unless the coefficients exceed [`splat_op::largest_tensor`]. Coefficients of a degree that is not yet in use are not stored,
    /// because their gradients, moments and values would all be zero.
    pub fn sh_blocks(&self) -> Vec<Tensor<3>> {
        let coefficients = self.groups[SH].width() / 3;
        let block = |block: &Param<Tensor<2>>| {
            let values = block.val();
            let rows = values.dims()[0];
            values.reshape([rows, coefficients, 3])
        };
        self.groups[SH].blocks.iter().map(block).collect()
    }

    /// Identity of the first block of coefficients: whatever replaces coefficients gives them another one.
    pub(crate) fn sh_id(&self) -> ParamId {
        self.groups[SH].blocks[0].id
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.groups[0].blocks[0].val().dims()[0]
    }

    /// Whether there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Degree of the spherical harmonics that are stored.
    pub fn sh_degree(&self) -> usize {
        (self.groups[SH].width() / 3).isqrt() - 1
    }

    /// `[N, 3]`: standard deviations, scene units; 0 where a logarithm is unusable.
    pub fn scales(&self) -> Tensor<2> {
        self.activated(None).0
    }

    /// `[N]`: opacities, 0 to 1; exactly 0, without gradients, for Gaussians that are unusable in any parameter (see
    /// [`splat_op::activate`]), so that they do not affect other Gaussians.
    pub fn opacities(&self) -> Tensor<1> {
        self.activated(None).1
    }

    fn activated(&self, mark: Option<&Tensor<1, Int>>) -> (Tensor<2>, Tensor<1>) {
        let raw = self.raw();
        let blocks = raw.iter().enumerate().map(|(block, raw)| activate::activated(raw, mark.filter(|_| block == 0)));
        let activated: Result<(Vec<_>, Vec<_>), _> = blocks.collect();
        match activated {
            Ok((scales, opacities)) => (joined(scales), joined(opacities)),
            // The renderer refuses fields of undocumented shapes by name.
            Err(_) => (self.log_scales().exp(), activation::sigmoid(self.logit_opacities())),
        }
    }

    /// The parameters of the Gaussians of each block of coefficients.
    fn raw(&self) -> Vec<RawSplats> {
        let (blocks, mut first) = (self.sh_blocks(), 0);
        let several = blocks.len() > 1;
        let (means, rotations, log_scales) = (self.means(), self.rotations(), self.log_scales());
        let logit_opacities = self.logit_opacities();
        let block = |sh: Tensor<3>| {
            let rows = first..first + sh.dims()[0];
            first = rows.end;
            RawSplats {
                means: part(&means, &rows, several),
                rotations: part(&rotations, &rows, several),
                log_scales: part(&log_scales, &rows, several),
                logit_opacities: part(&logit_opacities, &rows, several),
                sh,
            }
        };
        blocks.into_iter().map(block).collect()
    }

    /// The Gaussians with activated parameters, tracked like the parameters. Unusable Gaussians are masked, see [`Self::opacities`].
    pub fn splats(&self) -> Splats {
        self.splats_with(None)
    }

    /// [`Self::splats`], with the mark that the last step left, `[1]`, if the coefficients in `sh` are its result; see [`splat_op::adam`].
    pub(crate) fn splats_with(&self, mark: Option<&Tensor<1, Int>>) -> Splats {
        let (scales, opacities) = self.activated(mark);
        let mut blocks = self.sh_blocks();
        let colour = match blocks.len() {
            1 => Colour::SphericalHarmonics(blocks.remove(0)),
            _ => Colour::SphericalHarmonicsBlocks(blocks),
        };
        Splats { means: self.means(), rotations: self.rotations(), scales, opacities, colour }
    }

    /// The scene without autodiff, for evaluation, where a tracked forward pass would store its state needlessly.
    pub fn untracked(&self) -> Self {
        if !self.groups[0].raw().device().is_autodiff() {
            return self.clone();
        }
        Self { groups: self.groups.iter().map(Group::untracked).collect() }
    }
}

/// The rows of a block, if there are several blocks and enough rows.
fn part<const D: usize>(all: &Tensor<D>, rows: &Range<usize>, several: bool) -> Tensor<D> {
    let has_rows = several && !rows.is_empty() && rows.end <= all.dims()[0];
    if has_rows { all.clone().narrow(0, rows.start, rows.len()) } else { all.clone() }
}

/// The logit of an opacity: −∞ for 0.
pub(crate) fn logit(opacity: f64) -> f64 {
    (opacity / (1.0 - opacity)).ln()
}

/// The logistic function in f64: the opacity of a logit.
pub(crate) fn sigmoid(logit: f32) -> f64 {
    (1.0 + (-f64::from(logit)).exp()).recip()
}

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
