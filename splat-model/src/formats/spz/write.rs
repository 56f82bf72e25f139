//! Writing of versions 3 and 4.

use std::io::{self, Write};
use std::path::Path;

use flate2::{Compression, GzBuilder};
use rayon::prelude::*;

use super::pack::{farthest, fraction, pack};
use super::{ANTIALIASED, HEADER, MAGIC};
use crate::FileError;
use crate::gaussians::GaussianRows;
use crate::replace::{WRITE, replace};

/// Level of zstd. The time of higher levels is better spent on another format: `docs/FORMATS.md` has the sizes and times.
const LEVEL: i32 = 12;

/// The version that is written. Both hold the same bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// One gzip stream, for programs that were made before version 4.
    Three,
    /// A zstd stream per quantity.
    #[default]
    Four,
}

/// The choices that SPZ leaves to its writer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpzOptions {
    /// The version.
    pub version: SpzVersion,
    /// Bits of the harmonics of degree 1 and above it, each 1 to 8. More bits make a larger file: the format stores eight and leaves it to
    /// the compression to find those that are not used.
    pub sh_bits: [u8; 2],
}

impl Default for SpzOptions {
    /// Version 4, with 5 and 4 bits, as the format's reference has it.
    fn default() -> Self {
        Self { version: SpzVersion::Four, sh_bits: [5, 4] }
    }
}

/// Writes rows that fit the format.
pub fn write(path: &Path, rows: &GaussianRows, antialiased: bool, options: SpzOptions) -> Result<(), FileError> {
    replace(path, |out| write_to(out, rows, antialiased, options)).map_err(FileError::io(path, WRITE))
}

fn write_to(out: &mut impl Write, rows: &GaussianRows, antialiased: bool, options: SpzOptions) -> io::Result<()> {
    let fraction = fraction(farthest(&rows.means));
    let sections = pack(rows, fraction, options.sh_bits.map(|bits| bits.clamp(1, 8)));
    let count = u32::try_from(rows.len()).map_err(|_| io::Error::other("more Gaussians than the format can count"))?;
    let flags = if antialiased { ANTIALIASED } else { 0 };
    let header = |version: u32, streams: u8| {
        let last = [rows.sh_degree as u8, fraction as u8, flags, streams];
        [MAGIC, version.to_le_bytes(), count.to_le_bytes(), last].concat()
    };
    match options.version {
        SpzVersion::Three => {
            // The stream has no timestamp, so that the same scene gives the same file.
            let mut stream = GzBuilder::new().write(out, Compression::default());
            stream.write_all(&header(3, 0))?;
            for section in sections {
                stream.write_all(&section)?;
            }
            stream.finish().map(drop)
        }
        SpzVersion::Four => {
            let sections: Vec<Vec<u8>> = sections.into_iter().filter(|section| !section.is_empty()).collect();
            let streams: Vec<Vec<u8>> =
                sections.par_iter().map(|section| compress(section)).collect::<io::Result<_>>()?;
            let mut head = header(4, streams.len() as u8);
            head.extend((HEADER as u32).to_le_bytes());
            head.resize(HEADER, 0);
            for (stream, section) in streams.iter().zip(&sections) {
                head.extend([stream.len(), section.len()].map(|bytes| (bytes as u64).to_le_bytes()).concat());
            }
            out.write_all(&head)?;
            streams.iter().try_for_each(|stream| out.write_all(stream))
        }
    }
}

/// Compresses a section on two threads. The number of threads that there are does not change the bytes.
fn compress(section: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = zstd::bulk::Compressor::new(LEVEL)?;
    encoder.multithread(2)?;
    encoder.compress(section)
}
