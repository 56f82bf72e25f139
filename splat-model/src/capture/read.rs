//! What the readers of all formats share: whole files, and the places in them that errors name.

use std::path::Path;
use std::{fmt, fs, io};

use super::{CaptureError, Result};

/// Positions and lens parameters beyond this count as damage. The square of this limit still fits an f32, and no survey needs more.
pub(super) const MAX_MAGNITUDE: f64 = 1e15;

/// The size of a regular file in bytes. A pipe would never end, and opening one waits for a writer.
pub(super) fn regular_size(file: &Path) -> io::Result<u64> {
    let metadata = fs::metadata(file)?;
    match metadata.is_file() {
        true => Ok(metadata.len()),
        false => Err(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file")),
    }
}

/// Reads a whole regular file.
pub(super) fn read(file: &Path) -> Result<Vec<u8>> {
    regular_size(file).and_then(|_| fs::read(file)).map_err(|reason| unreadable(file, reason))
}

/// The error for a file that the operating system does not let us read.
pub(super) fn unreadable(file: &Path, reason: io::Error) -> CaptureError {
    let file = file.display();
    CaptureError::Content(format!("cannot read {file}: {reason}. Check that it is an ordinary file which you may read"))
}

/// A name as messages quote it: escaped, and truncated to a line.
pub(super) fn quoted(name: &str) -> String {
    const MAX_CHARS: usize = 100;
    match name.char_indices().nth(MAX_CHARS) {
        None => format!("{name:?}"),
        Some((cut, _)) => format!("{:?}… of {} bytes", &name[..cut], name.len()),
    }
}

/// A place in a file, as errors name it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place<'a> {
    pub file: &'a Path,
    pub at: PlaceInFile,
    /// The `file_path` of a frame in JSON; empty where it is not known.
    pub path: &'a str,
}

/// An entry of COLMAP's files is of a kind: "camera", "image" or "point".
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum PlaceInFile {
    /// A kind, and the entry's number in a binary file, from one.
    Entry(&'static str, usize),
    /// A kind, and a line, from one.
    Line(&'static str, usize),
    /// The index of a frame in JSON, from zero.
    Frame(usize),
    /// The fields beside `frames` in JSON.
    Whole,
}

impl fmt::Display for Place<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.at {
            PlaceInFile::Entry(kind, number) => write!(out, "{kind} entry {number}"),
            PlaceInFile::Line(kind, line) => write!(out, "{kind} on line {line}"),
            PlaceInFile::Frame(index) if self.path.is_empty() => write!(out, "frame {index}"),
            PlaceInFile::Frame(index) => write!(out, "frame {index} ({})", quoted(self.path)),
            PlaceInFile::Whole => out.write_str("the file as a whole"),
        }
    }
}

impl<'a> Place<'a> {
    pub fn new(file: &'a Path, at: PlaceInFile) -> Self {
        Self { file, at, path: "" }
    }

    /// The error for a field with an invalid value.
    pub fn refuse(&self, field: &'static str, found: impl fmt::Display, expected: impl fmt::Display) -> CaptureError {
        let fix = match self.at {
            PlaceInFile::Entry(..) | PlaceInFile::Line(..) => {
                "The file is damaged or the reconstruction failed: export it again, for instance with `colmap model_converter`"
            }
            PlaceInFile::Frame(..) | PlaceInFile::Whole => "Correct the file, or export it again",
        };
        self.refuse_with(field, found, expected, fix)
    }

    /// As [`Self::refuse`], with another remedy.
    pub fn refuse_with(
        &self,
        field: &'static str,
        found: impl fmt::Display,
        expected: impl fmt::Display,
        fix: &'static str,
    ) -> CaptureError {
        CaptureError::content(self.file, format!("{self}: `{field}` is {found}, expected {expected}. {fix}"))
    }
}
