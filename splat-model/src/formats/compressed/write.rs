//! Writing as binary little endian, with the elements in SuperSplat's order.

use std::io::{self, Write};
use std::path::Path;

use ply_rs_bw::ply::{DefaultElement, ScalarType};
use ply_rs_bw::writer::Writer;

use super::CHUNK;
use super::groups::HIDDEN_LOGIT;
use super::pack::pack_rest;
use super::row::{CHUNKS, HARMONICS, PACKED, RANGES, Ranges};
use crate::formats::{FormatError, opacity};
use crate::gaussians::GaussianRows;
use crate::ply::{VERTEX, WorldFrame, element, file_header, rest_names};
use crate::replace::{WRITE, replace};

/// Writes rows that fit the format ([`crate::formats::fit`]).
pub fn write(path: &Path, rows: &GaussianRows, world: WorldFrame) -> Result<(), FormatError> {
    let of_chunk = |i: usize| CHUNK * i..rows.len().min(CHUNK * (i + 1));
    let ranges = (0..rows.len().div_ceil(CHUNK)).map(|i| Ranges::around(rows, of_chunk(i))).collect();
    let mut packed = PackedFile::new(ranges, rows.len(), rows.sh_degree);
    (0..rows.len()).for_each(|row| packed.put(row, rows, row));
    packed.write(path, world)
}

/// The content of a file.
pub(in crate::formats) struct PackedFile {
    ranges: Vec<Ranges>,
    words: Vec<[u32; 4]>,
    /// Number of higher coefficients of a Gaussian over all channels.
    rest: usize,
    levels: Vec<u8>,
}

impl PackedFile {
    /// A file for Gaussians at these places ([`super::arranged`]), of which centres, scales and colours are in `geometry`.
    pub fn of(places: &[Option<u32>], geometry: &GaussianRows, sh_degree: usize) -> Self {
        let ranges = places.chunks(CHUNK).map(|chunk| {
            let rows = || chunk.iter().flatten().map(|&row| row as usize);
            let own = GaussianRows {
                means: rows().map(|row| geometry.means[row]).collect(),
                log_scales: rows().map(|row| geometry.log_scales[row]).collect(),
                sh_dc: rows().map(|row| geometry.sh_dc[row]).collect(),
                ..GaussianRows::default()
            };
            Ranges::around(&own, 0..own.len())
        });
        Self::new(ranges.collect(), places.len(), sh_degree)
    }

    fn new(ranges: Vec<Ranges>, count: usize, sh_degree: usize) -> Self {
        let rest = GaussianRows { sh_degree, ..GaussianRows::default() }.rest_per_row();
        Self { ranges, words: vec![[0; 4]; count], rest, levels: vec![0; count * rest] }
    }

    /// Packs row `i` of some rows at a place.
    pub fn put(&mut self, place: usize, rows: &GaussianRows, i: usize) {
        self.words[place] = self.ranges[place / CHUNK].pack(rows, i);
        let of = |row: usize| self.rest * row..self.rest * (row + 1);
        let levels = pack_rest(&rows.sh_rest[of(i)]);
        self.levels[of(place)].iter_mut().zip(levels).for_each(|(to, level)| *to = level);
    }

    /// Fills a place with a copy of the Gaussian before it, of opacity 0.
    pub fn put_hidden(&mut self, place: usize) {
        let [position, rotation, scale, colours] = self.words[place - 1];
        let hidden = u32::from(opacity::level(HIDDEN_LOGIT));
        self.words[place] = [position, rotation, scale, colours & !0xff | hidden];
        self.levels.copy_within(self.rest * (place - 1)..self.rest * place, self.rest * place);
    }

    /// Writes the file.
    ///
    /// # Errors
    /// If the system refuses it.
    pub fn write(&self, path: &Path, world: WorldFrame) -> Result<(), FormatError> {
        replace(path, |out| self.write_to(out, world)).map_err(FormatError::io(path, WRITE))
    }

    fn write_to(&self, out: &mut impl Write, world: WorldFrame) -> io::Result<()> {
        let count = self.words.len();
        let mut elements = vec![
            element(CHUNKS, self.ranges.len(), ScalarType::Float, RANGES),
            element(VERTEX, count, ScalarType::UInt, PACKED),
        ];
        if self.rest > 0 {
            elements.push(element(HARMONICS, count, ScalarType::UChar, rest_names(self.rest)));
        }
        Writer::<DefaultElement>::new().write_header(out, &file_header(world, elements))?;
        for value in self.ranges.iter().flat_map(|ranges| ranges.0) {
            out.write_all(&value.to_le_bytes())?;
        }
        for word in self.words.as_flattened() {
            out.write_all(&word.to_le_bytes())?;
        }
        out.write_all(&self.levels)
    }
}
