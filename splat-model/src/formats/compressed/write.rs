//! Writing as binary little endian, with the elements in SuperSplat's order.

use std::io::{self, Write};
use std::path::Path;

use ply_rs_bw::ply::{DefaultElement, ScalarType};
use ply_rs_bw::writer::Writer;

use super::CHUNK;
use super::pack::pack_rest;
use super::row::{CHUNKS, HARMONICS, PACKED, RANGES, Ranges};
use crate::formats::FormatError;
use crate::gaussians::GaussianRows;
use crate::ply::{VERTEX, WorldFrame, element, file_header, rest_names};
use crate::replace::replace;

/// Writes rows that fit the format ([`crate::formats::fit`]).
pub fn write(path: &Path, rows: &GaussianRows, world: WorldFrame) -> Result<(), FormatError> {
    replace(path, |out| write_to(out, rows, world)).map_err(|refused| FormatError::refused(path, refused))
}

fn write_to(out: &mut impl Write, rows: &GaussianRows, world: WorldFrame) -> io::Result<()> {
    let (chunks, rest) = (rows.len().div_ceil(CHUNK), rows.rest_per_row());
    let mut elements =
        vec![element(CHUNKS, chunks, ScalarType::Float, RANGES), element(VERTEX, rows.len(), ScalarType::UInt, PACKED)];
    if rest > 0 {
        elements.push(element(HARMONICS, rows.len(), ScalarType::UChar, rest_names(rest)));
    }
    Writer::<DefaultElement>::new().write_header(out, &file_header(world, elements))?;
    let of_chunk = |i: usize| CHUNK * i..rows.len().min(CHUNK * (i + 1));
    let ranges: Vec<Ranges> = (0..chunks).map(|i| Ranges::around(rows, of_chunk(i))).collect();
    for value in ranges.iter().flat_map(|ranges| ranges.0) {
        out.write_all(&value.to_le_bytes())?;
    }
    for word in (0..rows.len()).flat_map(|i| ranges[i / CHUNK].pack(rows, i)) {
        out.write_all(&word.to_le_bytes())?;
    }
    for row in rows.sh_rest.chunks_exact(rest.max(1)) {
        out.write_all(&pack_rest(row).collect::<Vec<u8>>())?;
    }
    Ok(())
}
