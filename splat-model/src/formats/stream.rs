//! Scenes that are read, converted and compared some rows at a time, so that they need not fit into memory.

mod write;

use std::io;
use std::path::Path;

use self::write::{write_compressed, write_glb, write_ply, write_spz};
use super::{
    Beginning, Format, FormatError, QuantisationError, QuantisationSums, SceneFile, SpzOptions, compressed, gltf, json,
    sog, spz,
};
use crate::gaussians::{GaussianRows, ROWS_AT_ONCE};
use crate::ply::{self, PlyReader, PlyRows, WorldFrame};

/// A scene file that is read some rows at a time.
///
/// Of PLY and binary glTF only these rows are in memory. Of SPZ and compressed PLY the packed rows are, 65 and 61 bytes each at degree 3, and
/// of glTF as JSON the decoded data. SOG is read whole.
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
    Gltf(gltf::GltfRows<'a>),
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
        let of_gltf = |mut rows: gltf::GltfRows<'a>| (std::mem::take(&mut rows.about), Rows::Gltf(rows));
        let of_world = |WorldFrame { origin, metres_per_unit, trained }| {
            let antialiased = trained.antialias;
            SceneFile { origin, metres_per_unit, antialiased, trained, ..SceneFile::default() }
        };
        let (format, (about, rows)) = match Beginning::of(path)? {
            Beginning::Spz => {
                let rows = spz::SpzRows::open(path)?;
                let about = SceneFile { antialiased: rows.antialiased, ..SceneFile::default() };
                (Format::Spz, (about, Rows::Spz(rows)))
            }
            Beginning::Glb => (Format::Glb, of_gltf(gltf::GltfRows::open_binary(path)?)),
            Beginning::Zip => (Format::Sog, whole(sog::read_archive(path)?)),
            Beginning::Json => {
                let (format, json) = json(path)?;
                let opened = match format {
                    Format::Sog => whole(sog::read_folder(path, &json)?),
                    _ => of_gltf(gltf::GltfRows::open_text(path, &json)?),
                };
                (format, opened)
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
            Rows::Gltf(rows) => rows.size(),
            Rows::Whole { rows, .. } => (rows.len(), rows.sh_degree),
        }
    }

    /// The next rows, at most so many; none at the end.
    ///
    /// # Errors
    /// If a row of a PLY file or the data of a binary glTF cannot be read.
    pub fn next_rows(&mut self, most: usize) -> Result<GaussianRows, FormatError> {
        Ok(match &mut self.rows {
            Rows::Ply(rows) => rows.next_rows(most)?,
            Rows::Compressed(rows) => rows.next_rows(most),
            Rows::Spz(rows) => rows.next_rows(most),
            Rows::Gltf(rows) => rows.next_rows(most)?,
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
            Rows::Gltf(rows) => rows.rewind(),
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
    /// As [`super::Written::added`].
    pub added: usize,
    /// As [`super::Written::moved`].
    pub moved: usize,
    /// Error of the file, which was read again.
    pub error: QuantisationError,
}

/// Whether [`convert`] writes this format.
pub fn is_streamed(format: Format) -> bool {
    matches!(format, Format::Ply | Format::CompressedPly | Format::Spz | Format::Glb)
}

/// Writes a scene as PLY, compressed PLY, SPZ or binary glTF as [`super::write`] does, and compares the file with it, [`ROWS_AT_ONCE`] at a time.
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
    let sh_degree = options.sh_degree.unwrap_or(of_degree).min(of_degree).min(format.sh_degree_max());
    let world = from.about.world();
    ply::check(to, &GaussianRows { sh_degree, ..GaussianRows::default() }, world)?;
    let mut fit = Fit { exact: format.is_exact(), sh_degree, moved: Vec::new(), next: 0 };
    let mut place_of_row = None;
    match format {
        Format::Ply => write_ply(from, &mut fit, to)?,
        Format::CompressedPly => place_of_row = Some(write_compressed(from, &mut fit, to)?),
        Format::Glb => write_glb(from, &mut fit, to, options)?,
        _ => write_spz(from, &mut fit, to, options)?,
    }
    let mut read = SceneReader::open(to)?;
    let (count, found_degree) = read.size();
    let (mut sums, mut next) = (QuantisationSums::default(), 0);
    from.rewind()?;
    fit.each(from, |rows| {
        let which = next..next + rows.len();
        next = which.end;
        let found = match (&read.rows, &place_of_row) {
            (Rows::Compressed(packed), Some(places)) => {
                let own = places.get(which).unwrap_or_default();
                packed.rows_at(own.iter().map(|place| *place as usize).filter(|place| *place < count))
            }
            _ => read.next_rows(rows.len()).map_err(Stop::Format)?,
        };
        if (found.len(), found_degree) != (rows.len(), sh_degree) {
            return Err(Stop::Format(read.changed()));
        }
        sums.add(rows, &found);
        Ok(())
    })
    .map_err(Stop::format)?;
    let added = place_of_row.map_or(0, |places| count.saturating_sub(places.len()));
    let left_out = all - (count - added).min(all);
    Ok(Converted { count, sh_degree, left_out, added, moved: fit.moved.len(), error: sums.error() })
}

/// Why rows are not taken any further.
enum Stop {
    Format(FormatError),
    Io(io::Error),
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
    /// Rows whose centres and scales differ from the scene's, in order.
    moved: Vec<Moved>,
    /// First of the next rows.
    next: usize,
}

/// A row that is not where the scene has it.
struct Moved {
    row: usize,
    mean: [f32; 3],
    log_scales: [f32; 3],
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
            take(&self.of(rows))?;
        }
    }

    /// Centres, scales and colours of all rows.
    fn geometry_of(&mut self, from: &mut SceneReader) -> Result<GaussianRows, FormatError> {
        let mut geometry = GaussianRows::default();
        from.rewind()?;
        self.each(from, |rows| {
            geometry.means.extend_from_slice(&rows.means);
            geometry.log_scales.extend_from_slice(&rows.log_scales);
            geometry.sh_dc.extend_from_slice(&rows.sh_dc);
            Ok(())
        })
        .map_err(Stop::format)?;
        Ok(geometry)
    }

    fn of(&mut self, mut rows: GaussianRows) -> GaussianRows {
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
        let which = self.next..self.next + rows.len();
        self.next = which.end;
        let first = self.moved.partition_point(|moved| moved.row < which.start);
        for Moved { row, mean, log_scales } in self.moved[first..].iter().take_while(|moved| moved.row < which.end) {
            rows.means[row - which.start] = *mean;
            rows.log_scales[row - which.start] = *log_scales;
        }
        rows
    }
}

#[cfg(test)]
mod tests;
