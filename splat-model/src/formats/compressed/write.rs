//! Writing as binary little endian, with the elements in SuperSplat's order.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use ply_rs_bw::ply::{DefaultElement, ScalarType};
use ply_rs_bw::writer::Writer;

use super::pack::pack_rest;
use super::{CHUNK, CHUNKS, HARMONICS, PACKED, RANGES, Ranges};
use crate::FileError;
use crate::gaussians::GaussianRows;
use crate::ply::{VERTEX, WorldFrame, element, file_header, rest_names};
use crate::replace::{WRITE, replace};

/// Writes rows that fit the format ([`crate::formats::fit`]).
pub fn write(path: &Path, rows: &GaussianRows, world: WorldFrame) -> Result<(), FileError> {
    let of_chunk = |i: usize| CHUNK * i..rows.len().min(CHUNK * (i + 1));
    let ranges: Vec<Ranges> = (0..rows.len().div_ceil(CHUNK)).map(|i| Ranges::around(rows, of_chunk(i))).collect();
    let words: Vec<[u32; 4]> = (0..rows.len()).map(|row| ranges[row / CHUNK].pack(rows, row)).collect();
    let (count, rest) = (rows.len(), rows.rest_per_row());
    let levels: Vec<u8> = rows.sh_rest.chunks_exact(rest.max(1)).flat_map(pack_rest).collect();
    let to_file = |out: &mut BufWriter<File>| -> io::Result<()> {
        let mut elements = vec![
            element(CHUNKS, ranges.len(), ScalarType::Float, RANGES.as_flattened().iter().copied()),
            element(VERTEX, count, ScalarType::UInt, PACKED),
        ];
        if rest > 0 {
            elements.push(element(HARMONICS, count, ScalarType::UChar, rest_names(rest)));
        }
        Writer::<DefaultElement>::new().write_header(out, &file_header(world, elements))?;
        for value in ranges.iter().flat_map(|ranges| ranges.0) {
            out.write_all(&value.to_le_bytes())?;
        }
        for word in words.as_flattened() {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&levels)
    };
    replace(path, to_file).map_err(FileError::io(path, WRITE))
}
