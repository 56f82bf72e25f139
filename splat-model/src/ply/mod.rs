//! Scenes as PLY files, in the layout of the original 3D Gaussian splatting code (Kerbl et al. 2023), which every splat viewer
//! opens. [`crate::formats`] also reads compressed files.
//!
//! The element `vertex` holds one row of float properties per Gaussian: `x y z` (scene units), `nx ny nz` (always 0),
//! `f_dc_0..2`, `f_rest_0..` (all coefficients of red, then green, then blue), `opacity` (logit), `scale_0..2` (natural
//! logarithm), `rot_0..3` (quaternion wxyz). Files are written as binary little endian. Reading also supports ASCII and big
//! endian, and properties in any order and of any numeric type. Unknown properties are ignored.
//!
//! [`read_points`] reads plain points with positions and colours, as in files of sparse reconstructions.
//!
//! The comment `splat origin X Y Z` holds the origin that positions are relative to: `position_file_world = position + origin`.

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

// The compressed layout, which is PLY too, uses these.
pub(crate) use read::{PlyReader, brief, origin, read_from, require, vertex};
pub(crate) use write::{check, origin_comment};

/// The element that holds the Gaussians.
pub(crate) const VERTEX: &str = "vertex";

/// Prefix of the comment that holds the origin.
const ORIGIN_COMMENT: &str = "splat origin ";

/// A PLY file that cannot be read or written. Each message names the file, what was found and what to do.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The operating system reported an error.
    #[error("{path}: could not {action}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The attempted action, with the remedy if there is one.
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
        /// The elements of the file.
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
        /// The properties of the element.
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
        /// Number of these properties.
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
        /// Number of rows that the header claims.
        rows: usize,
        /// Minimum number of bytes of all rows up to and including this element.
        needed: u64,
        /// Number of bytes after the header.
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
        /// First incomplete row, from 0.
        row: usize,
        /// Number of rows that the header claims.
        rows: usize,
    },
    /// A row does not match the header.
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
    /// The comment with the origin does not hold three finite numbers.
    #[error("{path}: comment `splat origin {found}`, expected three finite numbers; correct or remove that line", path = path.display())]
    Origin {
        /// The file.
        path: PathBuf,
        /// What follows the words `splat origin`.
        found: String,
    },
    /// The rows to be written do not fit together.
    #[error("{path}: not written: `{field}` is {found}, expected {expected}; make all fields describe the same Gaussians", path = path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// The field of [`crate::gaussians::GaussianRows`], or the argument.
        field: &'static str,
        /// Its length or value.
        found: String,
        /// The length or value that the other fields require.
        expected: String,
    },
}
