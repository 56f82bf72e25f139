//! Reading of files with elements in any order and in any encoding of PLY.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{ElementDef, Header, PropertyType, ScalarType};

use super::row::{CHUNKS, HARMONICS, Levels, PACKED, RANGES, Ranges, Words};
use super::{CHUNK, DEGREE_MAX};
use crate::formats::{Format, FormatError};
use crate::gaussians::GaussianRows;
use crate::ply::{PlyReader, VERTEX, brief, origin, require, vertex};

/// Reads the rows, and the origin that their positions are relative to, of a file whose header has been read.
pub fn read(path: &Path, mut input: PlyReader, header: &Header) -> Result<(GaussianRows, DVec3), FormatError> {
    let origin = origin(path, header)?;
    let vertex = vertex(path, header)?;
    let harmonics = header.elements.get(HARMONICS);
    let sh_degree = check(path, header, vertex, harmonics)?;
    let is_ours = |element: &&ElementDef| [CHUNKS, VERTEX, HARMONICS].contains(&element.name.as_str());
    let last = header.elements.values().rfind(is_ours).map_or(VERTEX, |element| &element.name);
    input.check_size(header, last)?;

    let mut chunks: Vec<Ranges> = Vec::new();
    let mut words: Vec<Words> = Vec::new();
    let per_channel = (sh_degree + 1) * (sh_degree + 1) - 1;
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    for element in header.elements.values() {
        match element.name.as_str() {
            CHUNKS => input.each_row(element, header.encoding, |_, chunk| {
                chunks.push(chunk);
                Ok(())
            })?,
            VERTEX => input.each_row(element, header.encoding, |_, row| {
                words.push(row);
                Ok(())
            })?,
            HARMONICS => input.each_row(element, header.encoding, |_, levels: Levels| {
                rows.sh_rest.extend(levels.values(per_channel));
                Ok(())
            })?,
            _ => input.skip(element, header)?,
        }
        if element.name == last {
            break;
        }
    }
    for (chunk, words) in chunks.iter().zip(words.chunks(CHUNK)) {
        words.iter().for_each(|words| chunk.unpack_to(words, &mut rows));
    }
    Ok((rows, origin))
}

/// Refuses files that do not describe Gaussians, and returns the degree of the spherical harmonics.
fn check(
    path: &Path,
    header: &Header,
    vertex: &ElementDef,
    harmonics: Option<&ElementDef>,
) -> Result<usize, FormatError> {
    let broken = |detail: String| FormatError::broken(path, Format::CompressedPly, detail);
    let chunks = header
        .elements
        .get(CHUNKS)
        .ok_or_else(|| broken(format!("no element `{CHUNKS}`, expected a row for each {CHUNK} of `{VERTEX}`")))?;
    // Either all channels of the colours have ranges or none.
    let ranges = if RANGES[12..].iter().any(|name| chunks.properties.contains_key(*name)) { 18 } else { 12 };
    require(path, chunks, &RANGES[..ranges])?;
    require(path, vertex, &PACKED)?;
    of_type(vertex, |name| PACKED.contains(&name), &ScalarType::UInt, "uint").map_err(broken)?;
    let needed = vertex.count.div_ceil(CHUNK);
    if chunks.count < needed {
        return Err(broken(format!(
            "{} rows of `{CHUNKS}`, expected {needed} for {} Gaussians, one for each {CHUNK}",
            chunks.count, vertex.count
        )));
    }
    let Some(harmonics) = harmonics else { return Ok(0) };
    require(path, harmonics, &[])?;
    of_type(harmonics, |name| name.starts_with("f_rest_"), &ScalarType::UChar, "uchar").map_err(broken)?;
    if harmonics.count != vertex.count {
        let detail =
            format!("{} rows of `{HARMONICS}`, expected {}, as many as of `{VERTEX}`", harmonics.count, vertex.count);
        return Err(broken(detail));
    }
    let found = harmonics.properties.keys().filter(|name| name.starts_with("f_rest_")).count();
    let degree = (0..=DEGREE_MAX).find(|degree| 3 * ((degree + 1) * (degree + 1) - 1) == found);
    let degree = degree.ok_or_else(|| {
        broken(format!("{found} properties `f_rest_*` of `{HARMONICS}`, expected 9, 24 or 45 (degree 1 to 3)"))
    })?;
    let missing = (0..found).map(|i| format!("f_rest_{i}")).find(|name| !harmonics.properties.contains_key(name));
    match missing {
        Some(name) => Err(broken(format!("`{HARMONICS}` has {found} properties `f_rest_*`, but no `{name}`"))),
        None => Ok(degree),
    }
}

/// Refuses properties of another type.
fn of_type(element: &ElementDef, which: impl Fn(&str) -> bool, wanted: &ScalarType, name: &str) -> Result<(), String> {
    let wrong = |property: &&ply_rs_bw::ply::PropertyDef| match &property.data_type {
        PropertyType::Scalar(scalar) => which(&property.name) && scalar != wanted,
        PropertyType::List(..) => true,
    };
    match element.properties.values().find(wrong) {
        Some(property) => Err(format!(
            "`{}` of `{}` is not of the expected type `{name}`",
            brief(&property.name),
            brief(&element.name)
        )),
        None => Ok(()),
    }
}
