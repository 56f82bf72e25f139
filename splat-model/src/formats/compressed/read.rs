//! Reading of files with elements in any order and in any encoding of PLY.

use std::path::Path;

use ply_rs_bw::ply::{ElementDef, Header, PropertyType, ScalarType};

use super::unpack::unpack_rest;
use super::{CHUNK, CHUNKS, DEGREE_MAX, HARMONICS, PACKED, RANGES, Ranges};
use crate::FileError;
use crate::formats::Format;
use crate::gaussians::GaussianRows;
use crate::ply::{PlyReader, VERTEX, WorldFrame, brief, degree_of_rest, require, rest_names, vertex, world_frame};

/// Reads a file whose header has been read, and its frame.
pub fn read(path: &Path, mut input: PlyReader, header: &Header) -> Result<(GaussianRows, WorldFrame), FileError> {
    let world = world_frame(path, header)?;
    let vertex = vertex(path, header)?;
    let harmonics = header.elements.get(HARMONICS);
    let (ranges, sh_degree) = check(path, header, vertex, harmonics)?;
    let is_ours = |element: &&ElementDef| [CHUNKS, VERTEX, HARMONICS].contains(&element.name.as_str());
    let last = header.elements.values().rfind(is_ours).map_or(VERTEX, |element| &element.name);
    input.check_size(header, last)?;

    let rest: Vec<String> = rest_names(rest_per_row(sh_degree)).collect();
    // The file was checked to be as long as its header says.
    let (mut chunks, mut words) = (Vec::new(), Vec::with_capacity(vertex.count));
    let mut levels = Vec::with_capacity(rest.len() * vertex.count);
    for element in header.elements.values() {
        match element.name.as_str() {
            CHUNKS => input.each_row(element, header.encoding, &RANGES.as_flattened()[..ranges], |_, values| {
                // Colours without ranges range from 0 to 1.
                let mut chunk = std::array::from_fn(|i| if i < 15 { 0.0 } else { 1.0 });
                chunk.iter_mut().zip(values).for_each(|(range, &value)| *range = value as f32);
                chunks.push(Ranges(chunk));
                Ok(())
            })?,
            VERTEX => input.each_row(element, header.encoding, &PACKED, |_, values| {
                words.push([0, 1, 2, 3].map(|i| values[i] as u32));
                Ok(())
            })?,
            HARMONICS => input.each_row(element, header.encoding, &rest, |_, values| {
                levels.extend(values.iter().map(|level| *level as u8));
                Ok(())
            })?,
            _ => input.skip(element, header)?,
        }
        if element.name == last {
            break;
        }
    }
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    for (i, word) in words.iter().enumerate() {
        chunks[i / CHUNK].unpack_to(word, &mut rows);
        rows.sh_rest.extend(unpack_rest(&levels[rest.len() * i..rest.len() * (i + 1)]));
    }
    Ok((rows, world))
}

/// Number of higher coefficients of a Gaussian over all channels.
fn rest_per_row(sh_degree: usize) -> usize {
    GaussianRows { sh_degree, ..GaussianRows::default() }.rest_per_row()
}

/// Refuses files that do not describe Gaussians, and returns the number of ranges of a chunk and the degree of the spherical harmonics.
fn check(
    path: &Path,
    header: &Header,
    vertex: &ElementDef,
    harmonics: Option<&ElementDef>,
) -> Result<(usize, usize), FileError> {
    let broken = |detail: String| FileError::broken(path, Format::CompressedPly, detail);
    let chunks = header
        .elements
        .get(CHUNKS)
        .ok_or_else(|| broken(format!("no element `{CHUNKS}`, expected a row for each {CHUNK} of `{VERTEX}`")))?;
    // Either all channels of the colours have ranges or none.
    let ranges = if RANGES[2].iter().any(|name| chunks.properties.contains_key(*name)) { 18 } else { 12 };
    require(path, chunks, &RANGES.as_flattened()[..ranges])?;
    require(path, vertex, &PACKED)?;
    of_type(vertex, |name| PACKED.contains(&name), &ScalarType::UInt, "uint").map_err(broken)?;
    let needed = vertex.count.div_ceil(CHUNK);
    if chunks.count < needed {
        return Err(broken(format!(
            "{} rows of `{CHUNKS}`, expected {needed} for {} Gaussians, one for each {CHUNK}",
            chunks.count, vertex.count
        )));
    }
    let Some(harmonics) = harmonics else { return Ok((ranges, 0)) };
    require(path, harmonics, &[])?;
    of_type(harmonics, |name| name.starts_with("f_rest_"), &ScalarType::UChar, "uchar").map_err(broken)?;
    if harmonics.count != vertex.count {
        let detail =
            format!("{} rows of `{HARMONICS}`, expected {}, as many as of `{VERTEX}`", harmonics.count, vertex.count);
        return Err(broken(detail));
    }
    let found = harmonics.properties.keys().filter(|name| name.starts_with("f_rest_")).count();
    let degree = degree_of_rest(found).filter(|&degree| degree <= DEGREE_MAX).ok_or_else(|| {
        broken(format!("{found} properties `f_rest_*` of `{HARMONICS}`, expected 9, 24 or 45 (degree 1 to 3)"))
    })?;
    match rest_names(found).find(|name| !harmonics.properties.contains_key(name)) {
        Some(name) => Err(broken(format!("`{HARMONICS}` has {found} properties `f_rest_*`, but no `{name}`"))),
        None => Ok((ranges, degree)),
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
