//! Camera paths: nerfstudio's `camera_path.json`.

use std::path::Path;

use glam::{DAffine3, DMat4};
use serde::Deserialize;

use super::{camera, read_json};
use crate::capture::Result;
use crate::capture::read::{Place, PlaceInFile};

#[derive(Deserialize)]
struct PathFile {
    camera_path: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    camera_to_world: [f64; 16],
    fov: Option<f64>,
}

/// Reads the keyframes of a camera path, at least two: their poses, `world_from_cam`, rigid, OpenCV axes, in the world of the file, and vertical
/// fields of view, degrees, 0.01 to 179, where the file states them.
///
/// ```json
/// {"camera_path": [{"camera_to_world": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1], "fov": 50}, ...]}
/// ```
///
/// `camera_to_world` is a 4 × 4 matrix by rows, `[R | c]`, with OpenGL's axes. nerfstudio's viewer (`nerfstudio/viewer/render_panel.py`) and its add-on
/// for Blender write these fields, with a camera for each picture. Others are ignored.
///
/// # Errors
/// If the file cannot be read or is no camera path, has fewer than two cameras, or a matrix is no rigid motion.
pub fn read_keyframes(file: &Path) -> Result<Vec<(DAffine3, Option<f64>)>> {
    let PathFile { camera_path } = read_json(file)?;
    if camera_path.len() < 2 {
        let (place, found) = (Place::new(file, PlaceInFile::Whole), format!("a list of {}", camera_path.len()));
        return Err(place.refuse("camera_path", found, "at least 2 cameras"));
    }
    let keyframe = |(index, Frame { camera_to_world, fov })| {
        let place = Place::new(file, PlaceInFile::Frame(index));
        if let Some(degrees) = fov.filter(|degrees| !(0.01..=179.0).contains(degrees)) {
            return Err(place.refuse("fov", degrees, "a vertical field of view in degrees, 0.01 to 179"));
        }
        // Columns of the transpose are rows.
        let rows = DMat4::from_cols_array(&camera_to_world).to_cols_array_2d();
        Ok((camera::pose(&place, "camera_to_world", rows)?.inverse(), fov))
    };
    camera_path.into_iter().enumerate().map(keyframe).collect()
}

#[cfg(test)]
mod tests;
