//! Scenes in files of all supported formats, and the precision that each loses.
//!
//! | [`Format`] | names | holds |
//! |---|---|---|
//! | [`Ply`](Format::Ply) | `.ply` | everything, in f32: the layout of the original implementation, see [`crate::ply`] |
//! | [`CompressedPly`](Format::CompressedPly) | `.compressed.ply` | 16 bytes per Gaussian and one per higher coefficient, to degree 3: SuperSplat's; read, not written |
//! | [`Spz`](Format::Spz) | `.spz` | 20 bytes per Gaussian and one per higher coefficient, then zstd: Niantic's |
//! | [`Glb`](Format::Glb) | `.glb` | 60 bytes per Gaussian and 12 per higher coefficient, in f32, to degree 3: glTF with `KHR_gaussian_splatting`; written, not read |
//! | [`Sog`](Format::Sog) | `.sog` | 8-bit pictures in WebP and a palette of harmonics, to degree 3: PlayCanvas' |
//!
//! Reading identifies the format by a file's first bytes, not by its name. The private modules and `docs/FORMATS.md` document
//! bits, ranges and frames.
//!
//! Compressed formats hold only Gaussians that can be rendered: they cannot represent NaN, and such a Gaussian would be drawn.
//! When read, they have no opacity of exactly 0 or 1, because the logits would not be finite: the first and last level count as
//! a quarter of a level inside the range. Infinite logits, and logarithms of a thickness of 0, become finite in every format.
//!
//! ```
//! use splat_model::capture::PointCloud;
//! use splat_model::formats::{self, Format, QuantisationError, SceneFile};
//! use splat_model::init;
//!
//! let points = PointCloud { positions: vec![[0.1, 0.2, 0.3], [1.0, -1.0, 2.0]], colours: vec![[255, 0, 0], [0, 90, 255]] };
//! let scene = SceneFile { rows: init::from_points(&points), ..SceneFile::default() };
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("scene.spz");
//! let written = formats::write(&file, &scene, Format::Spz)?;
//! let (read, format) = formats::read(&file)?;
//! assert_eq!(format, Format::Spz);
//! assert!(QuantisationError::between(&written.rows, &read.rows).position.largest < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod beginning;
mod compressed;
mod extras;
mod frame;
mod gltf;
pub(crate) mod limits;
mod loss;
mod opacity;
mod quaternion;
mod sog;
mod spz;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::fmt;
use std::path::Path;

use glam::DVec3;

use beginning::Beginning;
pub use gltf::mesh::write_mesh;
pub use loss::{Deviation, QuantisationError};
pub use sog::SogOptions;
pub use spz::{SpzOptions, SpzVersion};

use crate::FileError;
use crate::density::morton_order;
use crate::gaussians::GaussianRows;
use crate::ply::{self, PlyReader, TrainedAs, WorldFrame};

named! {
    /// A format of scene files.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum Format {
        /// The layout of the original implementation.
        Ply = "PLY",
        /// SuperSplat's compressed PLY.
        CompressedPly = "compressed PLY",
        /// Niantic's SPZ; written as version 4 or 3, read from version 1 to 4.
        Spz = "SPZ",
        /// glTF with `KHR_gaussian_splatting`, in its binary container.
        Glb = "glTF",
        /// PlayCanvas' SOG.
        Sog = "SOG",
    }
}

impl Format {
    /// The formats that are read.
    pub const READ: [Self; 4] = [Self::Ply, Self::CompressedPly, Self::Spz, Self::Sog];

    /// The formats that are written.
    pub const WRITTEN: [Self; 4] = [Self::Ply, Self::Spz, Self::Glb, Self::Sog];

    /// The format that a file name indicates.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        // A name that consists of the extension alone does not count.
        let ends = |extension: &str| name.len() > extension.len() && name.ends_with(extension);
        // The longest extension that fits: compressed PLY's ends like PLY's.
        Self::ALL.into_iter().filter(|format| ends(format.extension())).max_by_key(|format| format.extension().len())
    }

    /// The extension of its file names.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => ".ply",
            Self::CompressedPly => ".compressed.ply",
            Self::Spz => ".spz",
            Self::Glb => ".glb",
            Self::Sog => ".sog",
        }
    }

    /// The highest degree of the spherical harmonics that the format supports.
    pub fn sh_degree_max(self) -> usize {
        match self {
            Self::CompressedPly => compressed::DEGREE_MAX,
            Self::Glb => gltf::DEGREE_MAX,
            Self::Sog => sog::DEGREE_MAX,
            Self::Ply | Self::Spz => splat_op::sh::SH_DEGREE_MAX,
        }
    }

    /// Whether the format holds the origin that positions are relative to and the size of a scene unit.
    pub fn holds_origin(self) -> bool {
        self != Self::Spz
    }

    /// Whether the format holds every number without loss.
    pub fn is_exact(self) -> bool {
        self == Self::Ply
    }
}

/// The content of a scene file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneFile {
    /// The Gaussians.
    pub rows: GaussianRows,
    /// The origin that positions are relative to: `position_world = position + origin`, world frame, scene units.
    pub origin: DVec3,
    /// Metres per scene unit, finite and positive, where the size is known. All formats but SPZ hold it.
    pub metres_per_unit: Option<f64>,
    /// What the file states about its training. All formats hold whether that was with antialiasing; all but SPZ hold the rest.
    pub trained: TrainedAs,
}

impl SceneFile {
    fn world(&self) -> WorldFrame {
        WorldFrame { origin: self.origin, metres_per_unit: self.metres_per_unit, trained: self.trained }
    }
}

/// The part of a scene that was written. PLY holds all rows unchanged.
#[derive(Clone, Debug)]
pub struct Written<'a> {
    /// The rows of the file before rounding, in its order and of its degree.
    pub rows: Cow<'a, GaussianRows>,
    /// Number of Gaussians that were left out, because they cannot be rendered and the format cannot represent them.
    pub left_out: usize,
    /// Number of Gaussians that were moved nearer and shrunk accordingly, because they are beyond the reach of SPZ's grid.
    pub moved: usize,
}

impl FileError {
    fn broken(path: &Path, format: Format, detail: impl Into<String>) -> Self {
        Self::new(path, format!("broken {format} file: {}; copy or export it again", detail.into()))
    }

    fn foreign(path: &Path, what: String, remedy: impl fmt::Display) -> Self {
        const SCENES: &str = "Scenes are PLY files (original layout or SuperSplat's compressed one), SPZ and SOG";
        Self::new(
            path,
            format!("not a scene that is read: it is {what}. {SCENES}: {remedy}, or export it as one of these"),
        )
    }
}

/// Reads a scene of any format but glTF.
///
/// The function does not check whether the values are finite.
///
/// # Errors
/// A [`FileError`] for every file that is not a complete scene of one of the formats. Memory is bounded by a multiple of the
/// file's size, whatever the header claims: a small multiple for PLY, and the limits of compression for SPZ and SOG.
pub fn read(path: &Path) -> Result<(SceneFile, Format), FileError> {
    Ok(match Beginning::of(path)? {
        Beginning::Spz => (spz::read(path)?, Format::Spz),
        Beginning::Zip => (sog::read(path)?, Format::Sog),
        Beginning::Ply => {
            let (input, header) = PlyReader::open(path)?;
            let is_compressed = compressed::is_compressed(&header);
            let (rows, WorldFrame { origin, metres_per_unit, trained }) = match is_compressed {
                true => compressed::read(path, input, &header)?,
                false => ply::read_rows(input, &header)?,
            };
            let format = if is_compressed { Format::CompressedPly } else { Format::Ply };
            (SceneFile { rows, origin, metres_per_unit, trained }, format)
        }
    })
}

/// Writes the part of a scene that the format can hold: the Gaussians that can be rendered, with harmonics up to its degree ([`Written`]).
///
/// The file appears under its name only when it is complete; a file that was there before is replaced.
///
/// # Errors
/// If the format is compressed PLY, the rows' fields differ in length, the degree is above 4, the origin is not finite, the size of a unit is
/// not positive, no Gaussian can be rendered, or the file cannot be written. No temporary file is left behind.
pub fn write<'a>(path: &Path, scene: &'a SceneFile, format: Format) -> Result<Written<'a>, FileError> {
    write_with(path, scene, format, WriteOptions::default())
}

/// The choices that formats leave to their writers. Each format ignores those of the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// SPZ's.
    pub spz: SpzOptions,
    /// SOG's.
    pub sog: SogOptions,
}

/// Writes a scene as [`write`](fn@write) does, with other choices than the default's.
///
/// # Errors
/// As [`write`](fn@write).
pub fn write_with<'a>(
    path: &Path,
    scene: &'a SceneFile,
    format: Format,
    options: WriteOptions,
) -> Result<Written<'a>, FileError> {
    ply::check(path, &scene.rows, scene.world())?;
    let written = fit(&scene.rows, format);
    // A file with nothing in it is refused; PLY, which holds all rows, counts its own.
    ply::check_left(path, scene.rows.len() - written.left_out, scene.rows.len())?;
    let rows = &written.rows;
    match format {
        Format::Ply => ply::write(path, rows, scene.world())?,
        Format::CompressedPly => {
            return Err(FileError::new(
                path,
                "compressed PLY is read, not written: write SOG or SPZ, which are smaller",
            ));
        }
        Format::Spz => spz::write(path, rows, scene.trained.antialias, options.spz)?,
        Format::Glb => gltf::write(path, rows, scene)?,
        Format::Sog => sog::write(path, rows, scene, options.sog)?,
    }
    Ok(written)
}

/// The rows that a file of the format holds before rounding: the Gaussians that can be rendered ([`GaussianRows::is_usable`]),
/// with harmonics up to the format's degree. In SOG neighbours are near each other; in SPZ those beyond the grid's reach are moved to its
/// border. [`Written`] counts the differences. PLY holds all rows unchanged.
fn fit(rows: &GaussianRows, format: Format) -> Written<'_> {
    if format.is_exact() {
        return Written { rows: Cow::Borrowed(rows), left_out: 0, moved: 0 };
    }
    let mut fitted = GaussianRows { sh_degree: rows.sh_degree.min(format.sh_degree_max()), ..GaussianRows::default() };
    let order =
        if format == Format::Sog { morton_order(&rows.means) } else { (0..rows.len() as u32).collect::<Vec<_>>() };
    let usable = order.into_iter().map(|row| row as usize).filter(|&row| rows.is_usable(row));
    usable.for_each(|row| fitted.push(rows, row));
    let left_out = rows.len() - fitted.len();
    let moved = if format == Format::Spz { spz::bring_within_reach(&mut fitted) } else { 0 };
    Written { rows: Cow::Owned(fitted), left_out, moved }
}
