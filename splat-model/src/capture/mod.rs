//! Captures: photographs with their cameras and, where there is one, a sparse point cloud. One file per format.

pub mod image;

mod colmap;
pub mod demo;
mod error;
mod origin;
pub(crate) mod packed;
mod split;
mod tracks;

#[cfg(test)]
pub(crate) mod testing;

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

pub use colmap::{write_binary, write_binary_with_tracks};
pub use error::CaptureError;
pub use image::{Photo, load_all};
pub use split::Split;
pub use tracks::{Observation, Tracks};

/// A capture as its files describe it; pictures are not yet decoded.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The folder it came from.
    pub folder: PathBuf,
    /// Photographs, sorted by name.
    pub views: Vec<View>,
    /// Sparse points, empty if the capture has none.
    pub points: PointCloud,
    /// Where the points were found in the photographs; empty where the files do not say.
    pub tracks: Tracks,
    /// What was subtracted, in f64, from every position of the files: `position_file = position + origin`.
    /// Zero unless the capture lies so far from zero that f32 would lose digits.
    pub origin: DVec3,
}

impl Capture {
    /// Reads a COLMAP folder: `images/`, and `sparse/0/` (or `sparse/`) with `cameras`, `images` and `points3D`, each as
    /// `.bin` or else as `.txt`. Pictures are not opened.
    ///
    /// Without `points3D` the point cloud is empty. A capture whose mean camera centre lies further from zero than 100
    /// times its extent is moved next to zero; [`Capture::origin`] says by how much.
    ///
    /// # Errors
    ///
    /// A [`CaptureError`] if `cameras` or `images` is missing, or if any file is cut short, contradicts another, or
    /// holds what no capture can have.
    pub fn load(folder: &Path) -> Result<Self, CaptureError> {
        colmap::load(folder)
    }
}

/// One photograph.
#[derive(Clone, Debug)]
pub struct View {
    /// Its file name below the folder of pictures.
    pub name: String,
    /// Where the picture lies.
    pub image_path: PathBuf,
    /// Size and projection, at the size of the file.
    pub intrinsics: Intrinsics,
    /// Rigid; OpenCV axes; world relative to [`Capture::origin`].
    pub cam_from_world: DAffine3,
}

/// Points of a sparse reconstruction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions, world frame relative to [`Capture::origin`].
    pub positions: Vec<[f32; 3]>,
    /// Display-referred colours, 0 to 255.
    pub colours: Vec<[u8; 3]>,
}
