//! The scene: Gaussians with unconstrained parameters, as a Burn module.

use std::ops::Range;

use burn::module::{Module, Param};
use burn::tensor::kind::Basic;
use burn::tensor::{Device, Int, Tensor, TensorData, activation};
use rayon::prelude::*;
use splat_op::{Colour, RawSplats, Splats, activate, largest_tensor, read_back};
use thiserror::Error;

/// The rows of a scene on the host, as in scene files. Row `i` of every field belongs to Gaussian `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianRows {
    /// Centres, world frame, scene units.
    pub means: Vec<[f32; 3]>,
    /// Rotations, quaternions wxyz of any non-zero length.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithms of the standard deviations along the rotated axes.
    pub log_scales: Vec<[f32; 3]>,
    /// Logits of the opacities.
    pub logit_opacities: Vec<f32>,
    /// Degree-0 spherical-harmonics coefficient per colour channel.
    pub sh_dc: Vec<[f32; 3]>,
    /// Higher coefficients, `[N, (degree+1)² − 1, 3]` row-major: coefficient by coefficient, channels innermost.
    pub sh_rest: Vec<f32>,
    /// Degree of the spherical harmonics, 0 to 4.
    pub sh_degree: usize,
}

/// Fields of [`GaussianRows`] that do not fit together.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{field}` holds {found} numbers, expected {expected} for {count} Gaussians of degree {sh_degree}")]
pub struct RowsError {
    pub(crate) field: &'static str,
    pub(crate) found: usize,
    pub(crate) expected: usize,
    pub(crate) count: usize,
    pub(crate) sh_degree: usize,
}

impl GaussianRows {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Number of higher coefficients of one Gaussian, over all channels: `3 ((degree+1)² − 1)`.
    pub fn rest_per_row(&self) -> usize {
        3 * ((self.sh_degree + 1) * (self.sh_degree + 1) - 1)
    }

    /// Makes room for so many more rows and no others.
    pub fn reserve_exact(&mut self, more: usize) {
        self.means.reserve_exact(more);
        self.rotations.reserve_exact(more);
        self.log_scales.reserve_exact(more);
        self.logit_opacities.reserve_exact(more);
        self.sh_dc.reserve_exact(more);
        self.sh_rest.reserve_exact(more * self.rest_per_row());
    }

    /// Appends row `i` of `from`, without the coefficients above the degree of these rows.
    ///
    /// # Panics
    /// If there is no such row, or the degree of `from` is below the degree of these rows.
    pub fn push(&mut self, from: &Self, i: usize) {
        let (rest, taken) = (from.rest_per_row(), self.rest_per_row());
        self.means.push(from.means[i]);
        self.rotations.push(from.rotations[i]);
        self.log_scales.push(from.log_scales[i]);
        self.logit_opacities.push(from.logit_opacities[i]);
        self.sh_dc.push(from.sh_dc[i]);
        self.sh_rest.extend_from_slice(&from.sh_rest[rest * i..rest * i + taken]);
    }

    /// Some of the rows.
    ///
    /// # Panics
    /// If they do not exist.
    pub fn part(&self, which: Range<usize>) -> Self {
        let rest = self.rest_per_row();
        Self {
            means: self.means[which.clone()].to_vec(),
            rotations: self.rotations[which.clone()].to_vec(),
            log_scales: self.log_scales[which.clone()].to_vec(),
            logit_opacities: self.logit_opacities[which.clone()].to_vec(),
            sh_dc: self.sh_dc[which.clone()].to_vec(),
            sh_rest: self.sh_rest[rest * which.start..rest * which.end].to_vec(),
            sh_degree: self.sh_degree,
        }
    }

    /// Whether Gaussian `i` can be rendered: all its parameters are finite and within the range that f32 can compute with (see
    /// [`splat_op::activate`]). A Gaussian that cannot be rendered is masked wherever the scene is used.
    ///
    /// # Panics
    /// If there is no such Gaussian, or the rows do not fit together.
    pub fn is_usable(&self, i: usize) -> bool {
        let rest = self.rest_per_row();
        let sh = [&self.sh_dc[i][..], &self.sh_rest[rest * i..rest * (i + 1)]];
        activate::is_usable(&self.means[i], &self.rotations[i], &self.log_scales[i], self.logit_opacities[i], sh)
    }

    /// Number of Gaussians that cannot be rendered, see [`Self::is_usable`].
    pub fn unusable(&self) -> usize {
        (0..self.len()).into_par_iter().filter(|&i| !self.is_usable(i)).count()
    }

    /// All coefficients of some Gaussians, `[N, (degree+1)², 3]` row-major.
    fn sh(&self, which: Range<usize>) -> Vec<f32> {
        let rest = self.rest_per_row();
        let mut values = Vec::with_capacity(which.len() * (3 + rest));
        for i in which {
            values.extend_from_slice(&self.sh_dc[i]);
            values.extend_from_slice(&self.sh_rest[rest * i..rest * (i + 1)]);
        }
        values
    }

    /// Appends coefficients from `sh`, all coefficients in the layout of [`Self::sh`].
    fn set_sh(&mut self, sh: &[f32]) {
        for row in sh.chunks_exact(self.rest_per_row() + 3) {
            let (dc, rest) = row.split_at(3);
            self.sh_dc.push([dc[0], dc[1], dc[2]]);
            self.sh_rest.extend_from_slice(rest);
        }
    }

    /// Checks that all fields have the same number of rows, and that the degree is at most 4.
    ///
    /// # Errors
    /// [`RowsError`], which names the field.
    pub fn check(&self) -> Result<(), RowsError> {
        let count = self.len();
        let of = |field, found, expected| match found == expected {
            true => Ok(()),
            false => Err(RowsError { field, found, expected, count, sh_degree: self.sh_degree }),
        };
        of("sh_degree", self.sh_degree, self.sh_degree.min(splat_op::sh::SH_DEGREE_MAX))?;
        of("rotations", self.rotations.len(), count)?;
        of("log_scales", self.log_scales.len(), count)?;
        of("logit_opacities", self.logit_opacities.len(), count)?;
        of("sh_dc", self.sh_dc.len(), count)?;
        of("sh_rest", self.sh_rest.len(), count * self.rest_per_row())
    }
}

/// A scene's parameters as tensors, unconstrained: any finite value is valid, so an optimiser may step freely.
#[derive(Module, Debug)]
pub struct Gaussians {
    /// `[N, 3]`: centres, world frame, scene units.
    pub means: Param<Tensor<2>>,
    /// `[N, 4]`: quaternions wxyz, world-from-Gaussian; normalised where they are used.
    pub rotations: Param<Tensor<2>>,
    /// `[N, 3]`: natural logarithms of the standard deviations.
    pub log_scales: Param<Tensor<2>>,
    /// `[N]`: logits of the opacities.
    pub logit_opacities: Param<Tensor<1>>,
    /// `[N, (degree+1)², 3]`: coefficients of the spherical harmonics, degree 0 first. Coefficients of a degree that is not yet
    /// in use are not stored, because their gradients, moments and values would all be zero.
    ///
    /// If a tensor with the rows of all Gaussians were larger than [`splat_op::largest_tensor`] (on wgpu above 11 million
    /// Gaussians of degree 3), this one has the first rows.
    pub sh: Param<Tensor<3>>,
    /// The rows after those of `sh`, block by block; none as long as one tensor suffices.
    pub sh_more: Vec<Param<Tensor<3>>>,
}

/// A parameter, tracked on an autodiff device and plain elsewhere.
pub(crate) fn parameter<const D: usize>(values: Tensor<D>) -> Param<Tensor<D>> {
    Param::from_tensor(values)
}

/// Divides the rows of `coefficients` f32 coefficients for three channels into blocks that a device can hold; at least one.
pub(crate) fn sh_blocks(count: usize, coefficients: usize, device: &Device) -> Vec<Range<usize>> {
    let room = largest_tensor(device) / (size_of::<f32>() * 3 * coefficients) as u64;
    let rows = usize::try_from(room).unwrap_or(usize::MAX).max(1);
    (0..count.max(1)).step_by(rows).map(|first| first..first.saturating_add(rows).min(count)).collect()
}

/// Gaussians that are in the host's memory at a time where a scene is read, copied or written in parts: 15 MB at degree 3.
pub const ROWS_AT_ONCE: usize = 1 << 16;

/// Joins tensors of consecutive rows.
pub(crate) fn joined<const D: usize, K: Basic>(mut blocks: Vec<Tensor<D, K>>) -> Tensor<D, K> {
    if blocks.len() == 1 { blocks.swap_remove(0) } else { Tensor::cat(blocks, 0) }
}

impl Gaussians {
    /// Creates a scene from rows on `device`, trainable if the device is an autodiff device.
    ///
    /// # Errors
    /// If the rows' fields differ in length.
    pub fn from_rows(rows: &GaussianRows, device: &Device) -> Result<Self, RowsError> {
        rows.check()?;
        let (count, coefficients) = (rows.len(), rows.rest_per_row() / 3 + 1);
        // One copy of the coefficients, most of a scene, besides the rows.
        let block = |which: Range<usize>| {
            let count = which.len();
            parameter(tensor(rows.sh(which), [count, coefficients, 3], device))
        };
        let mut blocks = sh_blocks(count, coefficients, device).into_iter();
        Ok(Self {
            means: parameter(tensor(rows.means.as_flattened().to_vec(), [count, 3], device)),
            rotations: parameter(tensor(rows.rotations.as_flattened().to_vec(), [count, 4], device)),
            log_scales: parameter(tensor(rows.log_scales.as_flattened().to_vec(), [count, 3], device)),
            logit_opacities: parameter(tensor(rows.logit_opacities.clone(), [count], device)),
            sh: block(blocks.next().unwrap_or(0..count)),
            sh_more: blocks.map(block).collect(),
        })
    }

    /// As [`Self::from_rows`], in the memory of the rows where the device's is the host's: a scene need not be in memory twice.
    ///
    /// # Errors
    /// If the rows' fields differ in length.
    pub fn from_own_rows(rows: GaussianRows, device: &Device) -> Result<Self, RowsError> {
        rows.check()?;
        let (count, coefficients) = (rows.len(), rows.rest_per_row() / 3 + 1);
        if sh_blocks(count, coefficients, device).len() > 1 {
            return Self::from_rows(&rows, device);
        }
        let GaussianRows { means, rotations, log_scales, logit_opacities, sh_dc, sh_rest, .. } = rows;
        let sh = interleaved(sh_dc, sh_rest);
        Ok(Self {
            means: parameter(tensor(means.into_flattened(), [count, 3], device)),
            rotations: parameter(tensor(rotations.into_flattened(), [count, 4], device)),
            log_scales: parameter(tensor(log_scales.into_flattened(), [count, 3], device)),
            logit_opacities: parameter(tensor(logit_opacities, [count], device)),
            sh: parameter(tensor(sh, [count, coefficients, 3], device)),
            sh_more: Vec::new(),
        })
    }

    /// Copies the rows of the scene to the host.
    pub fn to_rows(&self) -> GaussianRows {
        let mut rows = GaussianRows { sh_degree: self.sh_degree(), ..GaussianRows::default() };
        let count = self.len();
        rows.means.reserve_exact(count);
        rows.rotations.reserve_exact(count);
        rows.log_scales.reserve_exact(count);
        rows.logit_opacities.reserve_exact(count);
        rows.sh_dc.reserve_exact(count);
        rows.sh_rest.reserve_exact(count * rows.rest_per_row());
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
        let mut rows = GaussianRows { sh_degree: self.sh_degree(), ..GaussianRows::default() };
        self.copy_rows(which, &mut rows);
        rows
    }

    /// Appends some rows of the scene.
    fn copy_rows(&self, which: Range<usize>, to: &mut GaussianRows) {
        let part = |values: Tensor<2>| values.narrow(0, which.start, which.len());
        to.means.extend(rows_of::<3>(part(self.means.val())));
        to.rotations.extend(rows_of::<4>(part(self.rotations.val())));
        to.log_scales.extend(rows_of::<3>(part(self.log_scales.val())));
        to.logit_opacities.extend(values_of(self.logit_opacities.val().narrow(0, which.start, which.len())));
        let mut first = 0;
        for block in self.sh_params() {
            let block = block.val();
            let end = first + block.dims()[0];
            let (from, to_row) = (which.start.max(first), which.end.min(end));
            if from < to_row {
                to.set_sh(&values_of(block.narrow(0, from - first, to_row - from)));
            }
            first = end;
        }
    }

    /// All blocks of coefficients.
    pub fn sh_params(&self) -> impl Iterator<Item = &Param<Tensor<3>>> {
        std::iter::once(&self.sh).chain(&self.sh_more)
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.val().dims()[0]
    }

    /// Whether there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Degree of the spherical harmonics that are stored.
    pub fn sh_degree(&self) -> usize {
        self.sh.val().dims()[1].isqrt() - 1
    }

    /// `[N, 3]`: standard deviations, scene units; 0 where a logarithm is unusable.
    pub fn scales(&self) -> Tensor<2> {
        let log_scales = self.log_scales.val();
        // The renderer refuses fields of undocumented shapes by name.
        activate::scales(&log_scales).unwrap_or_else(|_| log_scales.exp())
    }

    /// `[N]`: opacities, 0 to 1; exactly 0, without gradients, for Gaussians that are unusable in any parameter (see
    /// [`splat_op::activate`]), so that they do not affect other Gaussians.
    pub fn opacities(&self) -> Tensor<1> {
        let opacities: Result<_, _> = self.raw().iter().map(activate::opacities).collect();
        // As in `scales`.
        opacities.map(joined).unwrap_or_else(|_| activation::sigmoid(self.logit_opacities.val()))
    }

    /// The parameters of the Gaussians of each block of coefficients.
    fn raw(&self) -> Vec<RawSplats> {
        /// The rows of a block, if there are several blocks and enough rows.
        fn of<const D: usize>(param: &Param<Tensor<D>>, rows: &Range<usize>, several: bool) -> Tensor<D> {
            let all = param.val();
            if several && !rows.is_empty() && rows.end <= all.dims()[0] {
                all.narrow(0, rows.start, rows.len())
            } else {
                all
            }
        }
        let (several, mut first) = (!self.sh_more.is_empty(), 0);
        let block = |sh: &Param<Tensor<3>>| {
            let sh = sh.val();
            let rows = first..first + sh.dims()[0];
            first = rows.end;
            RawSplats {
                means: of(&self.means, &rows, several),
                rotations: of(&self.rotations, &rows, several),
                log_scales: of(&self.log_scales, &rows, several),
                logit_opacities: of(&self.logit_opacities, &rows, several),
                sh,
            }
        };
        self.sh_params().map(block).collect()
    }

    /// The Gaussians with activated parameters, tracked like the parameters. Unusable Gaussians are masked, see
    /// [`Self::opacities`].
    pub fn splats(&self) -> Splats {
        self.splats_with(None)
    }

    /// [`Self::splats`], with the mark that the last step left, `[1]`, if the coefficients in `sh` are its result; see
    /// [`splat_op::adam`].
    pub(crate) fn splats_with(&self, mark: Option<&Tensor<1, Int>>) -> Splats {
        let raw = self.raw();
        let blocks = raw.iter().enumerate().map(|(block, raw)| activate::activated(raw, mark.filter(|_| block == 0)));
        let activated: Result<(Vec<_>, Vec<_>), _> = blocks.collect();
        // As in `scales`.
        let (scales, opacities) = activated
            .map(|(scales, opacities)| (joined(scales), joined(opacities)))
            .unwrap_or_else(|_| (self.scales(), self.opacities()));
        let colour = match self.sh_more.is_empty() {
            true => Colour::SphericalHarmonics(self.sh.val()),
            false => Colour::SphericalHarmonicsBlocks(self.sh_params().map(Param::val).collect()),
        };
        Splats { means: self.means.val(), rotations: self.rotations.val(), scales, opacities, colour }
    }

    /// The scene without autodiff, for evaluation, where a tracked forward pass would store its state needlessly.
    pub fn untracked(&self) -> Self {
        fn plain<const D: usize>(param: &Param<Tensor<D>>) -> Param<Tensor<D>> {
            Param::from_tensor(param.val().inner())
        }
        if !self.means.val().device().is_autodiff() {
            return self.clone();
        }
        Self {
            means: plain(&self.means),
            rotations: plain(&self.rotations),
            log_scales: plain(&self.log_scales),
            logit_opacities: plain(&self.logit_opacities),
            sh: plain(&self.sh),
            sh_more: self.sh_more.iter().map(plain).collect(),
        }
    }
}

/// All coefficients of each Gaussian, in the memory of the higher ones.
fn interleaved(dc: Vec<[f32; 3]>, rest: Vec<f32>) -> Vec<f32> {
    let per_row = rest.len().checked_div(dc.len()).unwrap_or(0);
    if per_row == 0 {
        return dc.into_flattened();
    }
    let mut all = rest;
    all.reserve_exact(3 * dc.len());
    all.resize(all.len() + 3 * dc.len(), 0.0);
    // From the last on, because every row moves up.
    for (row, dc) in dc.iter().enumerate().rev() {
        let to = (3 + per_row) * row;
        all.copy_within(per_row * row..per_row * (row + 1), to + 3);
        all[to..to + 3].copy_from_slice(dc);
    }
    all
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// All elements of a tensor, row-major.
pub fn values_of<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    let data = read_back(tensor).convert::<f32>();
    data.try_into_vec().expect("converted to f32 in the line above")
}

/// The logit of an opacity: −∞ for 0.
pub(crate) fn logit(opacity: f64) -> f64 {
    (opacity / (1.0 - opacity)).ln()
}

/// The logistic function in f64: the opacity of a logit.
pub(crate) fn sigmoid(logit: f32) -> f64 {
    (1.0 + (-f64::from(logit)).exp()).recip()
}

fn rows_of<const W: usize>(tensor: Tensor<2>) -> Vec<[f32; W]> {
    values_of(tensor).as_chunks::<W>().0.to_vec()
}

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
