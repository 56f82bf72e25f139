//! Errors of captures.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// What reads or writes captures.
pub type Result<T, E = CaptureError> = std::result::Result<T, E>;

/// A capture that cannot be read or written. Each message names the file, what was found and what to do.
///
/// Reasons given by the operating system or a decoder are part of the message rather than a `source`, so that a report
/// that prints the whole chain says them once.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// A file that the format requires is not there.
    #[error("no {what} found: looked for {}. {fix}", list(.looked_for))]
    Missing {
        /// What the file would hold.
        what: &'static str,
        /// Every path that was tried.
        looked_for: Vec<PathBuf>,
        /// What to do.
        fix: &'static str,
    },
    /// A photograph changed between two decodings.
    #[error(
        "the photograph {name} has changed since the run began, in its size, its transparent parts or its mask: put it back"
    )]
    Changed {
        /// The view's name.
        name: String,
    },
    /// A file or folder cannot be read, decoded or written, or holds something that no capture can have or that is not supported; or a split
    /// leaves nothing: what was found, what was expected and what to do.
    #[error("{0}")]
    Content(String),
}

impl CaptureError {
    /// The error for a file or folder with such content.
    pub(crate) fn content(file: &Path, detail: impl Into<String>) -> Self {
        Self::Content(format!("{}: {}", file.display(), detail.into()))
    }

    /// The error for a file that the operating system does not let us write.
    pub(super) fn unwritable(file: &Path, reason: &io::Error) -> Self {
        let file = file.display();
        Self::Content(format!(
            "cannot write {file}: {reason}. Check that the folder can be written to and that the disk has room"
        ))
    }

    pub(super) fn no_views(file: &Path) -> Self {
        Self::content(
            file,
            "it lists no images, expected at least one. Run the reconstruction again, or choose another of its models",
        )
    }
}

fn list(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    names.join(" and ")
}
