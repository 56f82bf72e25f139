//! Reading of Gaussians, all of a file or some at a time.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{ElementDef, Header};

use super::frame::world_frame;
use super::read::{PlyReader, layout_error, missing_property, require, vertex};
use super::row::{REQUIRED, degree_of_rest, push_row, rest_names, rest_per_channel};
use super::{PlyError, WorldFrame};
use crate::gaussians::GaussianRows;

/// Reads a scene, and the origin that its positions are relative to (zero if the file names none).
///
/// Values of other numeric types are converted to the nearest f32; whether they are finite is not checked. Logits of opacities 0 and 1 and
/// logarithms of a thickness of 0, which are infinite, become finite numbers with the same effect.
///
/// # Errors
///
/// A [`PlyError`] for every file that is not a complete scene in the layout of [this module](super). Memory is bounded
/// by a small multiple of the file's true size, whatever its header claims.
pub fn read(path: &Path) -> Result<(GaussianRows, DVec3), PlyError> {
    let (input, header) = PlyReader::open(path)?;
    let mut input = PlyRows::new(input, header)?;
    Ok((input.next_rows(usize::MAX)?, input.world.origin))
}

/// The Gaussians of a file, some at a time.
pub(crate) struct PlyRows<'a> {
    input: PlyReader<'a>,
    header: Header,
    properties: Vec<String>,
    pub world: WorldFrame,
    pub sh_degree: usize,
    /// Number of Gaussians, which the file was checked to hold.
    pub count: usize,
    next: usize,
}

impl<'a> PlyRows<'a> {
    /// Refuses a header that does not describe Gaussians, or more of them than the file can hold.
    pub fn new(mut input: PlyReader<'a>, header: Header) -> Result<Self, PlyError> {
        let world = world_frame(input.path, &header)?;
        let vertex = vertex(input.path, &header)?;
        let (sh_degree, properties) = check_properties(input.path, vertex)?;
        let count = vertex.count;
        input.begin(&header)?;
        Ok(Self { input, header, properties, world, sh_degree, count, next: 0 })
    }

    /// The next Gaussians, at most so many; none at the end.
    pub fn next_rows(&mut self, most: usize) -> Result<GaussianRows, PlyError> {
        let which = self.next..self.count.min(self.next.saturating_add(most));
        self.next = which.end;
        let mut rows = empty_rows(which.len(), self.sh_degree);
        let vertex = vertex(self.input.path, &self.header)?;
        self.input.rows(vertex, self.header.encoding, &self.properties, which, |_, values| {
            push_row(&mut rows, values);
            Ok(())
        })?;
        Ok(rows)
    }
}

/// Checks that the properties describe a Gaussian, and returns the degree of its spherical harmonics and the names of all
/// properties that [`push_row`] takes.
fn check_properties(path: &Path, vertex: &ElementDef) -> Result<(usize, Vec<String>), PlyError> {
    require(path, vertex, &REQUIRED)?;
    let rest = || vertex.properties.keys().filter(|name| name.starts_with("f_rest_"));
    let count = rest().count();
    let degree = degree_of_rest(count).ok_or_else(|| {
        let detail = format!(
            "{count} properties `f_rest_*`, expected 0, 9, 24, 45 or 72 (degree 0 to 4); export all coefficients of the \
             scene or none"
        );
        layout_error(path, detail)
    })?;
    let names: Vec<String> = REQUIRED.iter().map(|name| name.to_string()).chain(rest_names(count)).collect();
    match names.iter().find(|name| !vertex.properties.contains_key(*name)) {
        Some(property) => Err(missing_property(path, property, rest())),
        None => Ok((degree, names)),
    }
}

/// An empty scene with room for `count` rows, which the file was checked to hold.
fn empty_rows(count: usize, sh_degree: usize) -> GaussianRows {
    GaussianRows {
        means: Vec::with_capacity(count),
        rotations: Vec::with_capacity(count),
        log_scales: Vec::with_capacity(count),
        logit_opacities: Vec::with_capacity(count),
        sh_dc: Vec::with_capacity(count),
        sh_rest: Vec::with_capacity(3 * rest_per_channel(sh_degree) * count),
        sh_degree,
    }
}
