//! Writing of version 3.

use std::io::{self, Write};
use std::path::Path;

use flate2::{Compression, GzBuilder};

use super::pack::{farthest, fraction, pack};
use super::{ANTIALIASED, MAGIC};
use crate::formats::FormatError;
use crate::gaussians::GaussianRows;
use crate::replace::replace;

/// Writes rows that fit the format ([`crate::formats::fit`]), with harmonics of the given bits at degree 1 and above it.
pub fn write(path: &Path, rows: &GaussianRows, antialiased: bool, sh_bits: [u8; 2]) -> Result<(), FormatError> {
    replace(path, |out| write_to(out, rows, antialiased, sh_bits))
        .map_err(|refused| FormatError::refused(path, refused))
}

fn write_to(out: &mut impl Write, rows: &GaussianRows, antialiased: bool, sh_bits: [u8; 2]) -> io::Result<()> {
    let count = u32::try_from(rows.len()).map_err(|_| io::Error::other("more Gaussians than the format can count"))?;
    let fraction = fraction(farthest(&rows.means));
    // The stream has no timestamp, so that the same scene gives the same file.
    let mut stream = GzBuilder::new().write(out, Compression::default());
    stream.write_all(&MAGIC)?;
    stream.write_all(&3_u32.to_le_bytes())?;
    stream.write_all(&count.to_le_bytes())?;
    let flags = if antialiased { ANTIALIASED } else { 0 };
    stream.write_all(&[rows.sh_degree as u8, fraction as u8, flags, 0])?;
    for section in pack(rows, fraction, sh_bits) {
        stream.write_all(&section)?;
    }
    stream.finish().map(drop)
}
