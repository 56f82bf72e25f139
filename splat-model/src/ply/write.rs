//! Writing as binary little endian, first under a temporary name.

use std::borrow::Borrow;
use std::collections::HashSet;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{Addable, DefaultElement, ElementDef, Encoding, Header, PropertyDef, PropertyType, ScalarType};
use ply_rs_bw::writer::Writer;

use super::frame::{ORIGIN_COMMENT, SCALE_COMMENT, TRAINED_COMMENT, TrainedAs};
use super::row::{MAX_DEGREE, group_names, names, values_of_row};
use super::{VERTEX, WorldFrame};
use crate::FileError;
use crate::capture::scale::is_scale;
use crate::gaussians::{GaussianRows, GroupRows};
use crate::replace::{WRITE, replace};

/// Writes a scene whose positions are in the frame `world`: an origin alone (world frame, scene units; zero without one), or a
/// [`WorldFrame`].
///
/// The file appears under its name only when it is complete; a file that was there before is replaced.
///
/// # Errors
/// If the fields differ in length, the degree is above 4, the origin is not finite or the size of a unit not positive, no Gaussian can be
/// rendered, or the file cannot be written. No temporary file is left behind.
pub fn write(path: &Path, rows: &GaussianRows, world: impl Into<WorldFrame>) -> Result<(), FileError> {
    let world = world.into();
    check(path, rows, world)?;
    write_parts(path, rows.len(), rows.sh_degree, [rows], world)
}

/// Writes a scene of `count` Gaussians of degree `sh_degree` that come in parts, as [`write()`] writes it whole.
///
/// # Errors
/// Those of [`write()`]; and if a part does not fit together or has another degree, or if all parts have more or fewer Gaussians.
pub fn write_parts<R: Borrow<GaussianRows>>(
    path: &Path,
    count: usize,
    sh_degree: usize,
    parts: impl IntoIterator<Item = R>,
    world: impl Into<WorldFrame>,
) -> Result<(), FileError> {
    let world = world.into();
    check(path, &GaussianRows { sh_degree, ..GaussianRows::default() }, world)?;
    let mut empty = Ok(());
    let to_file = |out: &mut BufWriter<File>| {
        let mut parts = parts.into_iter().peekable();
        let groups: Vec<GroupRows> = parts.peek().map_or(Vec::new(), |part| GaussianRows::like(part.borrow()).groups);
        if let Some(name) = twice(&groups) {
            return Err(io::Error::other(format!("groups give two properties the name `{name}`, expected one each")));
        }
        write_header(out, count, sh_degree, &groups, world)?;
        let (mut left, mut usable) = (count, 0);
        for part in parts {
            let part = part.borrow();
            part.check().map_err(io::Error::other)?;
            if part.sh_degree != sh_degree || part.len() > left {
                let found = format!("a part has {} Gaussians of degree {}", part.len(), part.sh_degree);
                return Err(io::Error::other(format!("{found}, expected at most {left} of degree {sh_degree}")));
            }
            if GaussianRows::like(part).groups != groups {
                return Err(io::Error::other("parts have different groups, expected those of the first part in all"));
            }
            write_rows(out, part)?;
            left -= part.len();
            usable += part.len() - part.unusable();
        }
        if left > 0 {
            return Err(io::Error::other(format!("the parts have {} Gaussians, expected {count}", count - left)));
        }
        empty = check_left(path, usable, count);
        empty.as_ref().map_err(|_| io::ErrorKind::InvalidData.into()).copied()
    };
    let written = replace(path, to_file);
    empty?;
    written.map_err(FileError::io(path, WRITE))
}

/// Refuses a scene of which no Gaussian can be rendered: it must not replace a file.
pub(crate) fn check_left(path: &Path, usable: usize, of: usize) -> Result<(), FileError> {
    if usable > 0 {
        return Ok(());
    }
    let detail = format!(
        "not written: no splat is left, {of} of {of} cannot be rendered; a file of that name stays as it was. Write a scene that has splats \
         (`splat inspect` describes one)"
    );
    Err(FileError::new(path, detail))
}

/// Refuses rows that do not fit together, and a frame that has no meaning.
pub(crate) fn check(path: &Path, rows: &GaussianRows, world: WorldFrame) -> Result<(), FileError> {
    let unfit =
        |what: &str| FileError::new(path, format!("not written: {what}; make all fields describe the same Gaussians"));
    let refuse = |field: &str, found: String, expected: String| {
        Err(unfit(&format!("`{field}` is {found}, expected {expected}")))
    };
    if rows.sh_degree > MAX_DEGREE {
        return refuse("sh_degree", rows.sh_degree.to_string(), format!("0 to {MAX_DEGREE}"));
    }
    if !world.origin.is_finite() {
        return refuse("origin", world.origin.to_string(), "three finite numbers".into());
    }
    if let Some(metres) = world.metres_per_unit.filter(|&metres| !is_scale(metres)) {
        return refuse("metres_per_unit", metres.to_string(), "a positive number".into());
    }
    if world.trained.background.iter().any(|value| !value.is_finite()) {
        return refuse("trained.background", format!("{:?}", world.trained.background), "three finite numbers".into());
    }
    rows.check().map_err(|error| unfit(&error.to_string()))?;
    match twice(&rows.groups) {
        Some(name) => {
            refuse("groups", format!("two properties `{name}`"), "names that give every property one name".into())
        }
        None => Ok(()),
    }
}

/// The first property that would be there twice.
fn twice(groups: &[GroupRows]) -> Option<String> {
    let mut seen = HashSet::new();
    names(MAX_DEGREE).into_iter().chain(group_names(groups)).find(|name| !seen.insert(name.clone()))
}

/// Writes the bytes of a file of [`write()`] to `out`. The rows must fit together ([`GaussianRows::check`]).
///
/// # Errors
/// If `out` cannot be written to.
pub fn write_to(out: &mut impl Write, rows: &GaussianRows, world: impl Into<WorldFrame>) -> io::Result<()> {
    write_header(out, rows.len(), rows.sh_degree, &rows.groups, world.into())?;
    write_rows(out, rows)
}

pub(super) fn write_header(
    out: &mut impl Write,
    count: usize,
    sh_degree: usize,
    groups: &[GroupRows],
    world: WorldFrame,
) -> io::Result<()> {
    let mut header = header_of(world);
    let mut vertex = ElementDef::new(VERTEX.into());
    vertex.count = count;
    for name in names(sh_degree).into_iter().chain(group_names(groups)) {
        vertex.properties.add(PropertyDef::new(name, PropertyType::Scalar(ScalarType::Float)));
    }
    header.elements.add(vertex);
    Writer::<DefaultElement>::new().write_header(out, &header).map(drop)
}

/// Writes Gaussians after a header, or after others of the same degree.
fn write_rows(out: &mut impl Write, rows: &GaussianRows) -> io::Result<()> {
    let mut values = Vec::new();
    for i in 0..rows.len() {
        values.clear();
        values_of_row(rows, i, &mut values);
        for value in &values {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

/// The header of a binary file without its elements, with comments for an origin that is not zero, a known size, and training other than the usual one.
fn header_of(world: WorldFrame) -> Header {
    let mut header = Header::new();
    header.encoding = Encoding::BinaryLittleEndian;
    header.comments.push(concat!("Generated by splat ", env!("CARGO_PKG_VERSION")).into());
    // `{:?}` of an f64 is the shortest text that reads back as the same number.
    if world.origin != DVec3::ZERO {
        let [x, y, z] = world.origin.to_array();
        header.comments.push(format!("{ORIGIN_COMMENT}{x:?} {y:?} {z:?}"));
    }
    if let Some(metres) = world.metres_per_unit {
        header.comments.push(format!("{SCALE_COMMENT}{metres:?}"));
    }
    // JSON has no numbers that are not finite: `check` has refused them.
    if let Some(text) = serde_json::to_string(&world.trained).ok().filter(|_| world.trained != TrainedAs::default()) {
        header.comments.push(format!("{TRAINED_COMMENT}{text}"));
    }
    header
}
