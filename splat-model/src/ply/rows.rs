//! Reading of Gaussians.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{ElementDef, Header};

use super::WorldFrame;
use super::frame::world_frame;
use super::read::{PlyReader, missing_property, require, vertex};
use super::row::{REQUIRED, degree_of_rest, further_groups, group_names, push_row, rest_names};
use crate::FileError;
use crate::gaussians::GaussianRows;

/// Reads a scene, and the origin that its positions are relative to (zero if the file names none).
///
/// Values of other numeric types are converted to the nearest f32; whether they are finite is not checked. Logits of opacities 0 and 1 and
/// logarithms of a thickness of 0, which are infinite, become finite numbers with the same effect. Further properties of the vertices
/// become groups: `name_0`, `name_1` and so on one group, others one each.
///
/// # Errors
/// A [`FileError`] for every file that is not a complete scene in the layout of [this module](super). Memory is bounded
/// by a small multiple of the file's true size, whatever its header claims.
pub fn read(path: &Path) -> Result<(GaussianRows, DVec3), FileError> {
    let (input, header) = PlyReader::open(path)?;
    let (rows, world) = read_rows(input, &header)?;
    Ok((rows, world.origin))
}

/// Reads the Gaussians of a file whose header has been read, and its frame. Refuses a header that does not describe Gaussians, or more of
/// them than the file can hold.
pub(crate) fn read_rows(mut input: PlyReader, header: &Header) -> Result<(GaussianRows, WorldFrame), FileError> {
    let world = world_frame(input.path, header)?;
    let vertex = vertex(input.path, header)?;
    let (sh_degree, mut properties) = check_properties(input.path, vertex)?;
    let groups = further_groups(vertex.properties.keys());
    properties.extend(group_names(&groups));
    input.begin(header)?;
    // The header was checked: the file can hold so many rows.
    let mut rows = GaussianRows { sh_degree, groups, ..GaussianRows::default() };
    rows.reserve_exact(vertex.count);
    input.each_row(vertex, header.encoding, &properties, |_, values| {
        push_row(&mut rows, values);
        Ok(())
    })?;
    Ok((rows, world))
}

/// Checks that the properties describe a Gaussian, and returns the degree of its spherical harmonics and the names of the
/// properties of every scene of that degree.
fn check_properties(path: &Path, vertex: &ElementDef) -> Result<(usize, Vec<String>), FileError> {
    require(path, vertex, &REQUIRED)?;
    let rest = || vertex.properties.keys().filter(|name| name.starts_with("f_rest_"));
    let count = rest().count();
    let degree = degree_of_rest(count).ok_or_else(|| {
        let detail = format!(
            "{count} properties `f_rest_*`, expected 0, 9, 24, 45 or 72 (degree 0 to 4); export all coefficients of the \
             scene or none"
        );
        FileError::new(path, detail)
    })?;
    let names: Vec<String> = REQUIRED.iter().map(|name| name.to_string()).chain(rest_names(count)).collect();
    match names.iter().find(|name| !vertex.properties.contains_key(*name)) {
        Some(property) => Err(missing_property(path, property, rest())),
        None => Ok((degree, names)),
    }
}
