//! Scenes as PLY files, in the layout of the original 3D Gaussian splatting code (Kerbl et al. 2023), which every splat viewer
//! opens. [`crate::formats`] also reads compressed files.
//!
//! The element `vertex` holds one row of float properties per Gaussian: `x y z` (scene units), `nx ny nz` (always 0), `f_dc_0..2`,
//! `f_rest_0..` (all coefficients of red, then green, then blue), `opacity` (logit), `scale_0..2` (natural logarithm), `rot_0..3`
//! (quaternion wxyz). Files are written as binary little endian. Reading also supports ASCII and big endian, and properties in any order
//! and of any numeric type. Further properties are [groups](crate::gaussians::GroupRows): `name_0`, `name_1` and so on one group.
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

pub use frame::{TrainedAs, WorldFrame};
pub use points::read_points;
pub use rows::read;
pub use write::{write, write_parts, write_to};

// The compressed layout, which is PLY too, uses these.
pub(crate) use frame::world_frame;
pub(crate) use read::{PlyReader, brief, require, vertex};
pub(crate) use row::{degree_of_rest, rest_names};
pub(crate) use rows::read_rows;
pub(crate) use write::{check, check_left};

/// The element that holds the Gaussians.
pub(crate) const VERTEX: &str = "vertex";
