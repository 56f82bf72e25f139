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
    /// Photographs that a file lists are not there.
    #[error(
        "{missing} of {of} photographs that {} lists are missing, the first is {}: {beside}. Put the photographs where it lists them: below \
         `images/`, or for JSON below its folder", .file.display(), .first.display()
    )]
    Photographs {
        /// The file.
        file: PathBuf,
        /// Number of photographs that are missing.
        missing: usize,
        /// Number of photographs that were looked for.
        of: usize,
        /// Where the first should be.
        first: PathBuf,
        /// What lies there instead.
        beside: String,
    },
    /// Cameras lie at unusual places, and which are meant is not clear.
    #[error("{}: {detail}", .folder.display())]
    Cameras {
        /// The folder in which they were looked for.
        folder: PathBuf,
        /// What was found, and what to do.
        detail: String,
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
    /// One field of one entry holds something that no capture can have.
    #[error("{}: {place}: `{field}` is {found}, expected {expected}. {fix}", .file.display())]
    Entry {
        /// The file.
        file: PathBuf,
        /// The entry, such as "image entry 3" or "camera on line 4".
        place: String,
        /// The field, as the format's own document calls it.
        field: &'static str,
        /// The value found.
        found: Box<str>,
        /// The values allowed.
        expected: Box<str>,
        /// What to do.
        fix: &'static str,
    },
    /// The lens model of a camera is not supported.
    #[error(
        "{}: {place}: the camera model is {model}, which is not supported, while the pinhole, radial, OPENCV and fisheye models \
         are. Remove the lens distortion with `colmap image_undistorter` and use the folder that it writes, or reconstruct with \
         another `--ImageReader.camera_model`",
        .file.display()
    )]
    Model {
        /// The file.
        file: PathBuf,
        /// The camera.
        place: String,
        /// Its model, by COLMAP's name where there is one.
        model: String,
    },
    /// The counts of a binary file and its bytes contradict each other.
    #[error("{}: {detail}", .file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// What was found, what was expected and what to do.
        detail: String,
    },
    /// The reconstruction lists no photographs.
    #[error("{} lists no images, expected at least one. Run the reconstruction again, or choose another of its models", .file.display())]
    NoViews {
        /// The file.
        file: PathBuf,
    },
    /// The picture of a view cannot be decoded.
    #[error("cannot decode {}: {reason}. Expected a JPEG or PNG picture: export or copy it again", .file.display())]
    Picture {
        /// The picture.
        file: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// A depth map, or the file beside them, cannot be used.
    #[error(
        "{}: {reason}. Expected 16-bit grey PNG pictures, and beside them `depth.json` with scene units per level: \
         {{\"scale\": 0.001}}; `--effects=-depth-supervision` does without",
        .file.display()
    )]
    Depth {
        /// The file.
        file: PathBuf,
        /// What was found.
        reason: String,
    },
    /// The picture of a view has another size than its camera.
    #[error(
        "{}: the picture is {} × {} px, expected {} × {} px as its camera states. Use the pictures that the reconstruction \
         was made from, or run it again on these",
        .file.display(), .found[0], .found[1], .expected[0], .expected[1]
    )]
    PictureSize {
        /// The picture.
        file: PathBuf,
        /// Its width and height, px.
        found: [usize; 2],
        /// The width and height of its camera, px.
        expected: [usize; 2],
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
    /// A point cloud whose columns differ in length.
    #[error("the point cloud has {positions} positions and {colours} colours, expected one colour for each position")]
    Cloud {
        /// Number of positions.
        positions: usize,
        /// Number of colours.
        colours: usize,
    },
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
    /// The error for photographs that `file` lists, of which these are missing.
    pub(super) fn photographs(missing: &[PathBuf], of: usize, file: &Path) -> Self {
        let first = missing.first().cloned().unwrap_or_default();
        Self::Photographs { file: file.to_owned(), missing: missing.len(), of, beside: beside(&first), first }
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
