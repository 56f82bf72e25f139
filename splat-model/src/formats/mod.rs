//! Scenes in files of all supported formats, and the precision that each loses.
//!
//! | [`Format`] | names | holds |
//! |---|---|---|
//! | [`Ply`](Format::Ply) | `.ply` | everything, in f32: the layout of the original implementation, see [`crate::ply`] |
//! | [`CompressedPly`](Format::CompressedPly) | `.compressed.ply` | 16 bytes per Gaussian and one per higher coefficient, to degree 3: SuperSplat's |
//! | [`Spz`](Format::Spz) | `.spz` | 20 bytes per Gaussian and one per higher coefficient, then gzip: Niantic's |
//!
//! Reading identifies the format by a file's first bytes, not by its name. The private modules and `docs/FORMATS.md` document
//! bits, ranges and frames.
//!
//! Compressed formats hold only Gaussians that can be rendered: they cannot represent NaN, and such a Gaussian would be drawn.
//! When read, they have no opacity of exactly 0 or 1, because the logits would not be finite: the first and last level count as
//! a quarter of a level inside the range.
//!
//! ```
//! use glam::DVec3;
//! use splat_model::capture::PointCloud;
//! use splat_model::formats::{self, Format, QuantisationError, SceneFile};
//! use splat_model::init;
//!
//! let points = PointCloud { positions: vec![[0.1, 0.2, 0.3], [1.0, -1.0, 2.0]], colours: vec![[255, 0, 0], [0, 90, 255]] };
//! let scene = SceneFile { rows: init::from_points(&points), origin: DVec3::ZERO, antialiased: false };
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("scene.spz");
//! let written = formats::write(&file, &scene, Format::Spz)?;
//! let (read, format) = formats::read(&file)?;
//! assert_eq!(format, Format::Spz);
//! assert!(QuantisationError::between(&written.rows, &read.rows).position.largest < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod compressed;
mod loss;
mod opacity;
mod quaternion;
mod spz;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use glam::DVec3;
use thiserror::Error;

pub use loss::{Deviation, QuantisationError};

use crate::gaussians::GaussianRows;
use crate::ply::{self, PlyError};
use crate::replace::Refused;

/// The spherical harmonic of degree 0, `1 / (2 √π)`.
const DC: f64 = 0.282_094_791_773_878_14;

/// A format of scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// The layout of the original implementation.
    Ply,
    /// SuperSplat's compressed PLY.
    CompressedPly,
    /// Niantic's SPZ; written as version 3, read from version 1 to 4.
    Spz,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 3] = [Self::Ply, Self::CompressedPly, Self::Spz];

    /// The format that a file name indicates.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        // A name that consists of the extension alone does not count.
        let ends = |extension: &str| name.len() > extension.len() && name.ends_with(extension);
        [Self::CompressedPly, Self::Ply, Self::Spz].into_iter().find(|format| ends(format.extension()))
    }

    /// The extension of its file names.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => ".ply",
            Self::CompressedPly => ".compressed.ply",
            Self::Spz => ".spz",
        }
    }

    /// The highest degree of the spherical harmonics that the format supports.
    pub fn sh_degree_max(self) -> usize {
        match self {
            Self::CompressedPly => compressed::DEGREE_MAX,
            Self::Ply | Self::Spz => splat_op::sh::SH_DEGREE_MAX,
        }
    }

    /// Whether the format holds the origin that positions are relative to.
    pub fn holds_origin(self) -> bool {
        self != Self::Spz
    }

    /// Whether the format records training with antialiasing.
    pub fn holds_antialiasing(self) -> bool {
        self == Self::Spz
    }

    /// Whether the format holds every number without loss.
    pub fn is_exact(self) -> bool {
        self == Self::Ply
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Spz => "SPZ",
        })
    }
}

/// The content of a scene file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneFile {
    /// The Gaussians.
    pub rows: GaussianRows,
    /// The origin that positions are relative to: `position_world = position + origin`, world frame, scene units.
    pub origin: DVec3,
    /// Whether the file states that the scene was trained with antialiasing (Mip-Splatting's filter), and so should be rendered
    /// with it. Only SPZ records this.
    pub antialiased: bool,
}

/// The part of a scene that was written.
#[derive(Clone, Debug)]
pub struct Written<'a> {
    /// The rows of the file before rounding, in its order and of its degree.
    pub rows: Cow<'a, GaussianRows>,
    /// Number of Gaussians that were left out, because they cannot be rendered and the format cannot represent them.
    pub left_out: usize,
    /// Number of invisible Gaussians that were added, so that no chunk of a compressed PLY holds both ordinary Gaussians and outliers.
    pub added: usize,
    /// Number of Gaussians that were moved nearer and shrunk accordingly, because they are beyond the reach of SPZ's grid.
    pub moved: usize,
}

/// A scene file that cannot be read or written. Each message names the file, what was found and what to do.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum FormatError {
    /// A PLY file, compressed or not, that breaks the format; or rows that do not belong together.
    #[error(transparent)]
    Ply(#[from] PlyError),
    /// The operating system reported an error.
    #[error("{path}: could not {action}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The attempted action, with the remedy if there is one.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The file does not begin like a scene of any supported format.
    #[error(
        "{path}: not a scene: it begins with `{found}`, expected a PLY file (original layout or SuperSplat's compressed one) or \
         SPZ (version 1 to 4); export it as one of these",
        path = path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
        /// Its first bytes, made printable.
        found: String,
    },
    /// The file begins like the format, but the rest does not match it.
    #[error("{path}: broken {format} file: {detail}; copy or export it again", path = path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// The format that the file begins like.
        format: Format,
        /// What was found and what was expected.
        detail: String,
    },
}

impl FormatError {
    fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_path_buf(), action, source }
    }

    fn broken(path: &Path, format: Format, detail: impl Into<String>) -> Self {
        Self::Broken { path: path.to_path_buf(), format, detail: detail.into() }
    }

    fn refused(path: &Path, Refused { action, source }: Refused) -> Self {
        Self::Io { path: path.to_path_buf(), action, source }
    }
}

/// Detects the format of a file by its first bytes and, for PLY, by its header. The name has no influence.
///
/// # Errors
/// If the file cannot be opened or is not a scene.
pub fn detect(path: &Path) -> Result<Format, FormatError> {
    if begins_as_spz(path)? {
        return Ok(Format::Spz);
    }
    let (_, header) = ply::PlyReader::open(path)?;
    Ok(if compressed::is_compressed(&header) { Format::CompressedPly } else { Format::Ply })
}

/// Reads a scene of any format.
///
/// The function does not check whether the values are finite.
///
/// # Errors
/// A [`FormatError`] for every file that is not a complete scene of one of the formats. Memory is bounded by a multiple of the
/// file's size, whatever the header claims: a small multiple for PLY, and the limit of its compression (1,032) for SPZ.
pub fn read(path: &Path) -> Result<(SceneFile, Format), FormatError> {
    if begins_as_spz(path)? {
        return Ok((spz::read(path)?, Format::Spz));
    }
    let (input, header) = ply::PlyReader::open(path)?;
    let (format, (rows, origin)) = match compressed::is_compressed(&header) {
        true => (Format::CompressedPly, compressed::read(path, input, &header)?),
        false => (Format::Ply, ply::read_from(input, &header)?),
    };
    Ok((SceneFile { rows, origin, antialiased: false }, format))
}

/// Writes the part of a scene that the format can hold ([`fit`]).
///
/// The file appears under its name only when it is complete; a file that was there before is replaced.
///
/// # Errors
/// If the rows' fields differ in length, the degree is above 4, the origin is not finite, or the file cannot be written. No
/// temporary file is left behind.
pub fn write<'a>(path: &Path, scene: &'a SceneFile, format: Format) -> Result<Written<'a>, FormatError> {
    ply::check(path, &scene.rows, scene.origin)?;
    let written = fitted(&scene.rows, format);
    match format {
        Format::Ply => ply::write(path, &written.rows, scene.origin)?,
        Format::CompressedPly => compressed::write(path, &written.rows, scene.origin)?,
        Format::Spz => spz::write(path, &written.rows, scene.antialiased, SPZ_SH_BITS)?,
    }
    Ok(written)
}

/// Bits of SPZ's harmonics at degree 1 and above it in the format's reference, and in [`write`](fn@write).
pub const SPZ_SH_BITS: [u8; 2] = [5, 4];

/// Writes SPZ as [`write`](fn@write) does, with other numbers of bits for the harmonics of degree 1 and above it, each 1 to 8. More
/// bits make a larger file: the format stores eight and leaves it to gzip to find those that are not used.
///
/// # Errors
/// As [`write`](fn@write).
pub fn write_spz<'a>(path: &Path, scene: &'a SceneFile, sh_bits: [u8; 2]) -> Result<Written<'a>, FormatError> {
    ply::check(path, &scene.rows, scene.origin)?;
    let written = fitted(&scene.rows, Format::Spz);
    spz::write(path, &written.rows, scene.antialiased, sh_bits.map(|bits| bits.clamp(1, 8)))?;
    Ok(written)
}

/// The rows that a file of the format holds before rounding: the Gaussians that can be rendered ([`GaussianRows::is_usable`]),
/// with harmonics up to the format's degree. In compressed PLY they are in an order in which neighbours share the box of a chunk and
/// outliers do not; in SPZ those beyond the grid's reach are moved to its border. [`Written`] counts the differences. PLY holds all
/// rows unchanged.
///
/// # Panics
/// If the rows do not fit together ([`GaussianRows::check`]).
pub fn fit(rows: &GaussianRows, format: Format) -> Cow<'_, GaussianRows> {
    fitted(rows, format).rows
}

fn fitted(rows: &GaussianRows, format: Format) -> Written<'_> {
    if format.is_exact() {
        return Written { rows: Cow::Borrowed(rows), left_out: 0, added: 0, moved: 0 };
    }
    let usable: Vec<u32> = (0..rows.len() as u32).filter(|&row| rows.is_usable(row as usize)).collect();
    let count = usable.len();
    let mut fitted = GaussianRows { sh_degree: rows.sh_degree.min(format.sh_degree_max()), ..GaussianRows::default() };
    let mut moved = 0;
    if format == Format::CompressedPly {
        compressed::fill_chunks(&mut fitted, rows, usable);
    } else {
        usable.into_iter().for_each(|row| fitted.push(rows, row as usize));
        moved = spz::bring_within_reach(&mut fitted);
    }
    let (left_out, added) = (rows.len() - count, fitted.len() - count);
    Written { rows: Cow::Owned(fitted), left_out, added, moved }
}

/// Whether a file begins like SPZ; if not, it begins like PLY.
fn begins_as_spz(path: &Path) -> Result<bool, FormatError> {
    let mut first = Vec::new();
    File::open(path)
        .map_err(FormatError::io(path, "open the scene (is the path right?)"))?
        .take(16)
        .read_to_end(&mut first)
        .map_err(FormatError::io(path, "read the scene (is the path right?)"))?;
    let line = first.split(|byte| *byte == b'\n').next().unwrap_or_default().trim_ascii();
    match spz::is_spz(&first) {
        false if line != b"ply" => {
            let found = String::from_utf8_lossy(line).escape_debug().to_string();
            Err(FormatError::Unknown { path: path.to_path_buf(), found })
        }
        is_spz => Ok(is_spz),
    }
}
