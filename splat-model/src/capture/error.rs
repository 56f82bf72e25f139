//! Errors of captures.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::names::beside;
use crate::ply::PlyError;

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
    /// A file is there but cannot be read.
    #[error("cannot read {}: {reason}. {fix}", .file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The operating system's reason.
        reason: io::Error,
        /// What to do.
        fix: &'static str,
    },
    /// A file cannot be written.
    #[error("cannot write {}: {reason}. Check that the folder can be written to and that the disk has room", .file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The operating system's reason.
        reason: io::Error,
    },
    /// A file or folder holds something that no capture can have, or that is not supported.
    #[error("{}: {detail}", .file.display())]
    Content {
        /// The file or folder.
        file: PathBuf,
        /// What was found, what was expected and what to do.
        detail: String,
    },
    /// The picture of a view cannot be decoded.
    #[error("cannot decode {}: {reason}. Expected a JPEG or PNG picture: export or copy it again", .file.display())]
    Picture {
        /// The picture.
        file: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// A photograph changed between two decodings.
    #[error(
        "the photograph {name} has changed since the run began, in its size, its transparent parts or its mask: put it back"
    )]
    Changed {
        /// The view's name.
        name: String,
    },
    /// The file of points that the capture names cannot be read.
    #[error(transparent)]
    Points(PlyError),
    /// A split that leaves nothing to test on.
    #[error(
        "{} for training and none is held out for testing, expected at least one. {}", all(*.views),
        if *.views > 1 { "Set `--test-every` to 8, say, to hold out every eighth" } else { "Add photographs" }
    )]
    NoTestViews {
        /// Number of views in the split.
        views: usize,
    },
    /// A split that leaves nothing to train on.
    #[error(
        "{} held out for testing and none is for training, expected at least one. Set `--test-every 0` to train on {}, or \
         add photographs", all(*.views), if *.views > 1 { "all, or 8 to hold out every eighth" } else { "it" }
    )]
    NoTrainingViews {
        /// Number of views in the split.
        views: usize,
    },
}

impl CaptureError {
    /// The error for a file or folder with such content.
    pub(crate) fn content(file: &Path, detail: impl Into<String>) -> Self {
        Self::Content { file: file.to_owned(), detail: detail.into() }
    }

    pub(super) fn no_views(file: &Path) -> Self {
        Self::content(
            file,
            "it lists no images, expected at least one. Run the reconstruction again, or choose another of its models",
        )
    }

    /// The error for photographs that `file` lists, of which these are missing.
    pub(super) fn photographs(missing: &[PathBuf], of: usize, file: &Path) -> Self {
        let first = missing.first().cloned().unwrap_or_default();
        let detail = format!(
            "{} of {of} photographs that it lists are missing, the first is {}: {}. Put the photographs where it lists them: below \
             `images/`, or for JSON below its folder",
            missing.len(),
            first.display(),
            beside(&first)
        );
        Self::content(file, detail)
    }
}

/// The beginning of a sentence about so many views.
fn all(views: usize) -> String {
    if views == 1 { "the 1 view is".into() } else { format!("all {views} views are") }
}

fn list(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    names.join(" and ")
}
