//! Scenes as PLY files, in the layout of the original 3D Gaussian splatting code (Kerbl et al. 2023), which every
//! splat viewer opens. [`crate::formats`] also reads compressed ones.
//!
//! The element `vertex` holds one row of float properties per Gaussian: `x y z` (scene units), `nx ny nz` (always 0),
//! `f_dc_0..2`, `f_rest_0..` (all coefficients of red, then green, then blue), `opacity` (logit), `scale_0..2`
//! (natural logarithm), `rot_0..3` (quaternion wxyz). Files are written as binary little endian. Reading also takes
//! ascii and big endian, properties in any order and of any numeric type, and ignores what it does not know.
//!
//! [`read_points`] reads files of plain points instead, positions and colours, as sparse reconstructions are exchanged.
//!
//! A scene whose positions are relative to an origin says so in the comment `splat origin X Y Z`:
//! `position_file_world = position + origin`.

mod points;
mod read;
mod row;
#[cfg(test)]
mod tests;
mod write;

use std::path::PathBuf;

use thiserror::Error;

pub use points::read_points;
pub use read::read;
pub use write::{write, write_to};

// For the compressed layout, which is a PLY file too.
pub(crate) use read::{Input, brief, origin, read_from, require, vertex};
pub(crate) use write::{check, origin_comment};

/// The element that holds the Gaussians.
pub(crate) const VERTEX: &str = "vertex";

/// What the comment that carries the origin begins with.
const ORIGIN_COMMENT: &str = "splat origin ";

/// A PLY file that cannot be read or written, named so that it can be mended.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The operating system refused.
    #[error("{path}: could not {action}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried, with the remedy where there is one.
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file does not begin with a line `ply`.
    #[error("{path}: not a PLY file: it begins with `{found}`, expected a line `ply`; pass a .ply file", path = path.display())]
    NotPly {
        /// The file.
        path: PathBuf,
        /// Its first bytes, made printable.
        found: String,
    },
    /// The header breaks the format's grammar.
    #[error("{path}: broken PLY header: {detail}; export it again", path = path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        detail: String,
    },
    /// There is no element `vertex`.
    #[error("{path}: no element `vertex`, found {found}; export a scene as a Gaussian splatting PLY", path = path.display())]
    MissingVertex {
        /// The file.
        path: PathBuf,
        /// The elements that there are.
        found: String,
    },
    /// `vertex` lacks a property that a Gaussian or a point needs.
    #[error(
        "{path}: element `vertex` has no property `{property}`, found {found}; \
         export a scene in the original 3D Gaussian splatting layout, and points with `x`, `y` and `z`",
        path = path.display()
    )]
    MissingProperty {
        /// The file.
        path: PathBuf,
        /// The property.
        property: String,
        /// The properties that there are.
        found: String,
    },
    /// A property of `vertex` is a list.
    #[error("{path}: property `{property}` of `vertex` is a list, expected one number per row; remove it or export it as scalars", path = path.display())]
    ListProperty {
        /// The file.
        path: PathBuf,
        /// The property.
        property: String,
    },
    /// The number of `f_rest_*` fits no degree of the spherical harmonics.
    #[error(
        "{path}: {found} properties `f_rest_*`, expected 0, 9, 24, 45 or 72 (degree 0 to 4); \
         export all coefficients of the scene or none",
        path = path.display()
    )]
    RestCount {
        /// The file.
        path: PathBuf,
        /// How many there are.
        found: usize,
    },
    /// The header claims more rows than the file can hold.
    #[error(
        "{path}: the header claims {rows} rows of `{element}`, at least {needed} bytes of data, but {found} bytes \
         follow the header; the file is truncated or its header wrong: copy or export it again",
        path = path.display()
    )]
    TooManyRows {
        /// The file.
        path: PathBuf,
        /// The element.
        element: String,
        /// Rows claimed.
        rows: usize,
        /// Bytes that all rows up to and including this element take at the very least.
        needed: u64,
        /// Bytes after the header.
        found: u64,
    },
    /// The file ends before its last row.
    #[error(
        "{path}: the file ends in row {row} of `{element}`, expected {rows} rows; it is truncated: copy or export it again",
        path = path.display()
    )]
    Truncated {
        /// The file.
        path: PathBuf,
        /// The element.
        element: String,
        /// First row that is not complete, from 0.
        row: usize,
        /// Rows claimed.
        rows: usize,
    },
    /// A row holds something else than the header declares.
    #[error("{path}: row {row} of `{element}`: {detail}; correct that row or export the scene again", path = path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// The element.
        element: String,
        /// The row, from 0.
        row: usize,
        /// What was found and what was expected.
        detail: String,
    },
    /// The comment that carries the origin does not hold three finite numbers.
    #[error("{path}: comment `splat origin {found}`, expected three finite numbers; correct or remove that line", path = path.display())]
    Origin {
        /// The file.
        path: PathBuf,
        /// What follows the words `splat origin`.
        found: String,
    },
    /// The rows to be written do not belong together.
    #[error("{path}: not written: `{field}` is {found}, expected {expected}; make all fields describe the same Gaussians", path = path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// The field of [`crate::gaussians::GaussianRows`], or the argument.
        field: &'static str,
        /// Its length or value.
        found: String,
        /// What the other fields ask for.
        expected: String,
    },
}
