//! Files that cannot be read or written.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// A file that cannot be read or written, or content that a file of its format cannot hold. The message names the file, what was found,
/// what was expected and what to do.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{path}: {detail}", path = path.display())]
pub struct FileError {
    path: PathBuf,
    detail: String,
}

impl FileError {
    pub(crate) fn new(path: &Path, detail: impl Into<String>) -> Self {
        Self { path: path.to_owned(), detail: detail.into() }
    }

    /// For an error of the operating system: the attempted action, with the remedy if there is one.
    pub(crate) fn io(path: &Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |reason| Self::new(path, format!("could not {action}: {reason}"))
    }
}
