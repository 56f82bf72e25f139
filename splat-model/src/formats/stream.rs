//! Scenes that are read, converted and compared some rows at a time, so that they need not fit into memory.

use std::path::Path;

use super::{
    Beginning, Format, FormatError, QuantisationError, QuantisationSums, SceneFile, SpzOptions, compressed, gltf, json,
    sog, spz,
};
use crate::gaussians::GaussianRows;
use crate::ply::{self, PlyReader, PlyRows, WorldFrame};
use crate::replace::replace;

/// Rows that are in memory at a time: 16 MB at degree 3.
pub const ROWS_AT_ONCE: usize = 1 << 16;

/// A scene file that is read some rows at a time.
///
/// Of PLY only these rows are in memory. Of SPZ and compressed PLY the packed rows are, 65 and 61 bytes each at degree 3. glTF and SOG are
/// read whole.
pub struct SceneReader<'a> {
    path: &'a Path,
    about: SceneFile,
    format: Format,
    rows: Rows<'a>,
}

enum Rows<'a> {
    Ply(PlyRows<'a>),
    Compressed(compressed::CompressedRows),
    Spz(spz::SpzRows),
    Whole { rows: GaussianRows, next: usize },
}

impl<'a> SceneReader<'a> {
    /// Opens a scene of any format.
    ///
    /// # Errors
    /// Those of [`super::read`]; broken rows of a PLY file show when they are read.
    pub fn open(path: &'a Path) -> Result<Self, FormatError> {
        let whole = |scene: SceneFile| {
            let rows = Rows::Whole { rows: scene.rows, next: 0 };
            (SceneFile { rows: GaussianRows::default(), ..scene }, rows)
        };
        let of_world =
            |WorldFrame { origin, metres_per_unit }| SceneFile { origin, metres_per_unit, ..SceneFile::default() };
        let (format, (about, rows)) = match Beginning::of(path)? {
            Beginning::Spz => {
                let rows = spz::SpzRows::open(path)?;
                let about = SceneFile { antialiased: rows.antialiased, ..SceneFile::default() };
                (Format::Spz, (about, Rows::Spz(rows)))
            }
            Beginning::Glb => (Format::Glb, whole(gltf::read_binary(path)?)),
            Beginning::Zip => (Format::Sog, whole(sog::read_archive(path)?)),
            Beginning::Json => {
                let (format, json) = json(path)?;
                let scene = match format {
                    Format::Sog => sog::read_folder(path, &json)?,
                    _ => gltf::read_text(path, &json)?,
                };
                (format, whole(scene))
            }
            Beginning::Ply => {
                let (input, header) = PlyReader::open(path)?;
                if compressed::is_compressed(&header) {
                    let rows = compressed::CompressedRows::read(path, input, &header)?;
                    (Format::CompressedPly, (of_world(rows.world), Rows::Compressed(rows)))
                } else {
                    let rows = PlyRows::new(input, header)?;
                    (Format::Ply, (of_world(rows.world), Rows::Ply(rows)))
                }
            }
        };
        Ok(Self { path, about, format, rows })
    }

    /// What the file holds besides its rows; without rows.
    pub fn about(&self) -> &SceneFile {
        &self.about
    }

    /// The file's format.
    pub fn format(&self) -> Format {
        self.format
    }

    /// Number of Gaussians, and degree of their harmonics.
    pub fn size(&self) -> (usize, usize) {
        match &self.rows {
            Rows::Ply(rows) => (rows.count, rows.sh_degree),
            Rows::Compressed(rows) => rows.size(),
            Rows::Spz(rows) => rows.size(),
            Rows::Whole { rows, .. } => (rows.len(), rows.sh_degree),
        }
    }

    /// The next rows, at most so many; none at the end.
    ///
    /// # Errors
    /// If a row of a PLY file cannot be read.
    pub fn next_rows(&mut self, most: usize) -> Result<GaussianRows, FormatError> {
        Ok(match &mut self.rows {
            Rows::Ply(rows) => rows.next_rows(most)?,
            Rows::Compressed(rows) => rows.next_rows(most),
            Rows::Spz(rows) => rows.next_rows(most),
            Rows::Whole { rows, next } => {
                let which = *next..rows.len().min(next.saturating_add(most));
                *next = which.end;
                rows.part(which)
            }
        })
    }

    /// The scene with all rows that have not been read yet.
    ///
    /// # Errors
    /// As [`Self::next_rows`].
    pub fn read(mut self) -> Result<SceneFile, FormatError> {
        let rows = match self.rows {
            Rows::Whole { rows, next: 0 } => rows,
            _ => self.next_rows(usize::MAX)?,
        };
        Ok(SceneFile { rows, ..self.about })
    }

    /// Begins anew.
    fn rewind(&mut self) -> Result<(), FormatError> {
        match &mut self.rows {
            Rows::Ply(rows) => {
                let (input, header) = PlyReader::open(self.path)?;
                let again = PlyRows::new(input, header)?;
                if (again.count, again.sh_degree) != (rows.count, rows.sh_degree) {
                    return Err(self.changed());
                }
                *rows = again;
            }
            Rows::Compressed(rows) => rows.rewind(),
            Rows::Spz(rows) => rows.rewind(),
            Rows::Whole { next, .. } => *next = 0,
        }
        Ok(())
    }

    fn changed(&self) -> FormatError {
        FormatError::broken(self.path, self.format, "it changed while it was read")
    }
}

/// Choices of [`convert`].
#[derive(Clone, Copy, Debug, Default)]
pub struct ConvertOptions {
    /// Highest degree of the harmonics that is kept; `None` for all.
    pub sh_degree: Option<usize>,
    /// Marks the scene as trained with antialiasing, whether its file does or not.
    pub antialiased: bool,
    /// Choices of SPZ.
    pub spz: SpzOptions,
}

/// What [`convert`] did.
#[derive(Clone, Copy, Debug)]
pub struct Converted {
    /// Number of Gaussians in the file.
    pub count: usize,
    /// Degree of their harmonics.
    pub sh_degree: usize,
    /// As [`super::Written::left_out`].
    pub left_out: usize,
    /// As [`super::Written::moved`].
    pub moved: usize,
    /// Error of the file, which was read again.
    pub error: QuantisationError,
}

/// Whether [`convert`] writes this format.
pub fn is_streamed(format: Format) -> bool {
    matches!(format, Format::Ply | Format::Spz)
}

/// Writes a scene as PLY or SPZ as [`super::write`] does, and compares the file with it, [`ROWS_AT_ONCE`] at a time.
///
/// # Errors
/// Those of [`super::read`] and [`super::write`]; then an existing file stays as it was.
///
/// # Panics
/// If the format is not [streamed](is_streamed).
pub fn convert(
    from: &mut SceneReader,
    to: &Path,
    format: Format,
    options: &ConvertOptions,
) -> Result<Converted, FormatError> {
    assert!(is_streamed(format), "{format} is not written in a stream");
    let (all, of_degree) = from.size();
    let sh_degree = options.sh_degree.map_or(of_degree, |degree| degree.min(of_degree));
    let world = from.about.world();
    ply::check(to, &GaussianRows { sh_degree, ..GaussianRows::default() }, world)?;
    let mut fit = Fit { exact: format.is_exact(), sh_degree, geometry: None, next: 0 };
    let mut moved = 0;
    from.rewind()?;
    if format == Format::Ply {
        let mut failed = None;
        let written = replace(to, |out| {
            ply::write_header(out, all, sh_degree, world)?;
            fit.each(from, |rows| ply::write_rows(out, rows).map_err(Stop::Io)).map_err(|stop| match stop {
                Stop::Io(error) => error,
                Stop::Format(error) => {
                    failed = Some(error);
                    std::io::ErrorKind::Other.into()
                }
            })
        });
        // An input that cannot be read is the cause.
        failed.map_or(Ok(()), Err)?;
        written.map_err(|refused| FormatError::refused(to, refused))?;
    } else {
        let mut geometry = GaussianRows::default();
        fit.each(from, |rows| {
            geometry.means.extend_from_slice(&rows.means);
            geometry.log_scales.extend_from_slice(&rows.log_scales);
            Ok(())
        })
        .map_err(Stop::format)?;
        moved = spz::bring_within_reach(&mut geometry);
        let mut sections = spz::PackedSections::new(sh_degree, spz::farthest(&geometry.means), options.spz);
        fit.geometry = Some(geometry);
        from.rewind()?;
        fit.each(from, |rows| {
            sections.add(rows);
            Ok(())
        })
        .map_err(Stop::format)?;
        sections.write(to, from.about.antialiased || options.antialiased)?;
    }
    let mut read = SceneReader::open(to)?;
    let (count, found_degree) = read.size();
    let mut sums = QuantisationSums::default();
    from.rewind()?;
    fit.each(from, |rows| {
        let found = read.next_rows(rows.len()).map_err(Stop::Format)?;
        if (found.len(), found_degree) != (rows.len(), sh_degree) {
            return Err(Stop::Format(read.changed()));
        }
        sums.add(rows, &found);
        Ok(())
    })
    .map_err(Stop::format)?;
    Ok(Converted { count, sh_degree, left_out: all - count.min(all), moved, error: sums.error() })
}

/// Why rows are not taken any further.
enum Stop {
    Format(FormatError),
    Io(std::io::Error),
}

impl Stop {
    fn format(self) -> FormatError {
        match self {
            Self::Format(error) => error,
            Self::Io(_) => unreachable!("only a writer of rows returns it"),
        }
    }
}

/// Rows as a format holds them before rounding (see [`super::fit`]), for formats that keep the order.
struct Fit {
    /// Whether the format holds every row.
    exact: bool,
    sh_degree: usize,
    /// Centres and scales of all rows that are kept, where they may differ from the scene's.
    geometry: Option<GaussianRows>,
    /// First of those of the next rows.
    next: usize,
}

impl Fit {
    /// Passes the remaining rows of a scene on.
    fn each(
        &mut self,
        from: &mut SceneReader,
        mut take: impl FnMut(&GaussianRows) -> Result<(), Stop>,
    ) -> Result<(), Stop> {
        self.next = 0;
        loop {
            let rows = from.next_rows(ROWS_AT_ONCE).map_err(Stop::Format)?;
            if rows.is_empty() {
                return Ok(());
            }
            take(&self.of(rows).ok_or_else(|| Stop::Format(from.changed()))?)?;
        }
    }

    /// `None` if there are other rows than before.
    fn of(&mut self, mut rows: GaussianRows) -> Option<GaussianRows> {
        if self.sh_degree < rows.sh_degree {
            let mut cut = GaussianRows { sh_degree: self.sh_degree, ..GaussianRows::default() };
            (0..rows.len()).for_each(|row| cut.push(&rows, row));
            rows = cut;
        }
        if !self.exact && (0..rows.len()).any(|row| !rows.is_usable(row)) {
            let mut usable = GaussianRows { sh_degree: rows.sh_degree, ..GaussianRows::default() };
            (0..rows.len()).filter(|&row| rows.is_usable(row)).for_each(|row| usable.push(&rows, row));
            rows = usable;
        }
        if let Some(geometry) = &self.geometry {
            let which = self.next..self.next + rows.len();
            rows.means.copy_from_slice(geometry.means.get(which.clone())?);
            rows.log_scales.copy_from_slice(geometry.log_scales.get(which.clone())?);
            self.next = which.end;
        }
        Some(rows)
    }
}

#[cfg(test)]
mod tests;
