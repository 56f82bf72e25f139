//! Captures: photographs with their cameras and, where there is one, a sparse point cloud. One file per format.

pub mod demo;

use std::path::PathBuf;

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

/// A capture as its files describe it; pictures are not yet decoded.
#[derive(Clone, Debug)]
pub struct Capture {
    /// The folder it came from.
    pub folder: PathBuf,
    /// Photographs, sorted by name.
    pub views: Vec<View>,
    /// Sparse points, empty if the capture has none.
    pub points: PointCloud,
    /// What was subtracted, in f64, from every position of the files: `position_file = position + origin`.
    /// Zero unless the capture lies so far from zero that f32 would lose digits.
    pub origin: DVec3,
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
