//! Scenes as PLY files, in the layout of the original 3D Gaussian splatting code (Kerbl et al. 2023), which every splat viewer
//! opens. [`crate::formats`] also reads compressed files.
//!
//! The element `vertex` holds one row of float properties per Gaussian: `x y z` (scene units), `nx ny nz` (always 0),
//! `f_dc_0..2`, `f_rest_0..` (all coefficients of red, then green, then blue), `opacity` (logit), `scale_0..2` (natural
//! logarithm), `rot_0..3` (quaternion wxyz). Files are written as binary little endian. Reading also supports ASCII and big
//! endian, and properties in any order and of any numeric type. Further properties are
//! [groups](crate::gaussians::GroupRows): `name_0`, `name_1` and so on one group.
//!
//! [`read_points`] reads plain points with positions and colours, as in files of sparse reconstructions.
//!
//! The comment `splat origin X Y Z` holds the origin that positions are relative to: `position_file_world = position + origin`.
//! The comment `splat metres per unit M` holds the size of a scene unit, where it is known, and `splat trained as {…}` how the scene was
//! trained, in JSON, where that differs from [`TrainedAs::default`]. [`WorldFrame`] is all three.

mod frame;
#[cfg(test)]
mod groups_tests;
mod points;
mod read;
mod row;
mod rows;
#[cfg(test)]
mod tests;
mod write;

use std::path::PathBuf;

use thiserror::Error;

pub use frame::{TrainedAs, WorldFrame};
pub use points::read_points;
pub use rows::read;
pub use write::{write, write_parts, write_to};

// The compressed layout, which is PLY too, uses these.
pub(crate) use frame::world_frame;
pub(crate) use read::{PlyReader, brief, require, vertex};
pub(crate) use row::{degree_of_rest, rest_names};
pub(crate) use rows::read_rows;
pub(crate) use write::{check, check_left, element, file_header};

/// The element that holds the Gaussians.
pub(crate) const VERTEX: &str = "vertex";

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
    /// The file is no PLY, its header breaks the format's grammar or declares a layout that is not read, or its rows do not match the header.
    #[error("{path}: {detail}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What was found, what was expected and what to do.
        detail: String,
    },
    /// A scene to be written has no Gaussian that can be rendered: none at all, or each has a parameter without meaning.
    #[error(
        "{path}: not written: no splat is left, {of} of {of} cannot be rendered; a file of that name stays as it was. Write a scene that \
         has splats (`splat inspect` describes one)",
        path = path.display()
    )]
    Empty {
        /// The file.
        path: PathBuf,
        /// The number of Gaussians to be written.
        of: usize,
    },
    /// The rows to be written do not fit together.
    #[error("{path}: not written: `{field}` is {found}, expected {expected}; make all fields describe the same Gaussians", path = path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// The field of [`crate::gaussians::GaussianRows`], or the argument.
        field: String,
        /// Its length or value.
        found: String,
        /// The length or value that the other fields require.
        expected: String,
    },
}
