//! Scenes on the host, as in scene files.

use std::collections::HashSet;
use std::ops::Range;

use rayon::prelude::*;
use splat_op::activate;

use super::options::{BASE_GROUPS, GroupOptions, RowsError, check_name};

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
    /// Groups of further parameters, such as features.
    pub groups: Vec<GroupRows>,
}

/// The rows of a group of parameters, see [`Group`](super::Group).
#[derive(Clone, Debug, PartialEq)]
pub struct GroupRows {
    /// Name of the group.
    pub name: String,
    /// Numbers in a row.
    pub width: usize,
    /// `[N, width]`, row-major.
    pub values: Vec<f32>,
    /// How the group is trained. Scene files do not hold it.
    pub options: GroupOptions,
}

impl GroupRows {
    /// The same group without rows.
    fn like(other: &Self) -> Self {
        Self { name: other.name.clone(), width: other.width, values: Vec::new(), options: other.options }
    }
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
        self.groups.iter_mut().for_each(|group| group.values.reserve_exact(more * group.width));
    }

    /// Rows of the same degree and groups, none yet.
    pub fn like(other: &Self) -> Self {
        let groups = other.groups.iter().map(GroupRows::like).collect();
        Self { sh_degree: other.sh_degree, groups, ..Self::default() }
    }

    /// Whether there is a group of that name and width.
    pub fn has_group(&self, of: &GroupRows) -> bool {
        self.groups.iter().any(|group| group.name == of.name && group.width == of.width)
    }

    /// Appends row `i` of `from`, without the coefficients above the degree of these rows and without groups that these rows lack.
    ///
    /// # Panics
    /// If there is no such row, if the degree of `from` is below the degree of these rows, or if `from` lacks one of their groups.
    pub fn push(&mut self, from: &Self, i: usize) {
        let (rest, taken) = (from.rest_per_row(), self.rest_per_row());
        self.means.push(from.means[i]);
        self.rotations.push(from.rotations[i]);
        self.log_scales.push(from.log_scales[i]);
        self.logit_opacities.push(from.logit_opacities[i]);
        self.sh_dc.push(from.sh_dc[i]);
        self.sh_rest.extend_from_slice(&from.sh_rest[rest * i..rest * i + taken]);
        for (at, to) in self.groups.iter_mut().enumerate() {
            let same = |from: &&GroupRows| from.name == to.name && from.width == to.width;
            // Usually at the same place: a search through very many would take long.
            let group = from.groups.get(at).filter(same).or_else(|| from.groups.iter().find(same));
            let Range { start, end } = to.width * i..to.width * (i + 1);
            to.values.extend_from_slice(&group.expect("rows with the group").values[start..end]);
        }
    }

    /// Some of the rows.
    ///
    /// # Panics
    /// If they do not exist.
    pub fn part(&self, which: Range<usize>) -> Self {
        let mut part = Self::like(self);
        which.for_each(|row| part.push(self, row));
        part
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

    /// Appends coefficients from `sh`, `[n, (degree+1)², 3]` row-major.
    pub(super) fn set_sh(&mut self, sh: &[f32]) {
        for row in sh.chunks_exact(self.rest_per_row() + 3) {
            let (dc, rest) = row.split_at(3);
            self.sh_dc.push([dc[0], dc[1], dc[2]]);
            self.sh_rest.extend_from_slice(rest);
        }
    }

    /// Checks that all fields have the same number of rows, that the degree is at most 4, and that groups have names of their own.
    ///
    /// # Errors
    /// [`RowsError`], which names the field.
    pub fn check(&self) -> Result<(), RowsError> {
        let (count, sh_degree) = (self.len(), self.sh_degree);
        let of = |field: &str, found, expected| match found == expected {
            true => Ok(()),
            false => Err(RowsError::length(field, found, expected, count, sh_degree)),
        };
        of("sh_degree", self.sh_degree, self.sh_degree.min(splat_op::sh::SH_DEGREE_MAX))?;
        of("rotations", self.rotations.len(), count)?;
        of("log_scales", self.log_scales.len(), count)?;
        of("logit_opacities", self.logit_opacities.len(), count)?;
        of("sh_dc", self.sh_dc.len(), count)?;
        of("sh_rest", self.sh_rest.len(), count * self.rest_per_row())?;
        let mut names: HashSet<&str> = BASE_GROUPS.into();
        for group in &self.groups {
            check_name(&group.name)?;
            if !names.insert(&group.name) {
                return Err(RowsError::taken(&group.name));
            }
            if group.width == 0 {
                return Err(RowsError::empty(&group.name));
            }
            of(&group.name, group.values.len(), count * group.width)?;
        }
        Ok(())
    }
}

/// All coefficients of each Gaussian, in the memory of the higher ones.
pub(super) fn interleaved(dc: Vec<[f32; 3]>, rest: Vec<f32>) -> Vec<f32> {
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
