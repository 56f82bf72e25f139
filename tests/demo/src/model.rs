//! Writing of COLMAP models in the binary encoding (<https://colmap.github.io/format.html>).

use std::io::{self, Write};
use std::path::Path;

use glam::DQuat;
use splat_model::capture::{Observation, PointCloud, Tracks, View};
use splat_model::replace::replace;
use splat_op::{CameraModel, Intrinsics};

use super::{DemoError, create};

/// Writes `cameras.bin`, `images.bin` and `points3D.bin` under `folder/sparse/0`, replacing those that are there. Each appears whole or not
/// at all.
///
/// Positions are written as they are, relative to the capture's origin if it has one. `tracks` refer to `views` and `points` in their order;
/// views of equal [`Intrinsics`] share a camera. Nothing is checked: poses have to be rigid and names those of files below `images`, where
/// pictures are expected.
///
/// # Errors
/// [`DemoError::Io`] if a file cannot be written.
pub fn write_model(folder: &Path, views: &[View], points: &PointCloud, tracks: &Tracks) -> Result<(), DemoError> {
    let model = folder.join("sparse").join("0");
    create(&model)?;
    let mut cameras: Vec<Intrinsics> = Vec::new();
    let mut camera_of = |view: &View| {
        let known = cameras.iter().position(|camera| *camera == view.intrinsics);
        known.unwrap_or_else(|| {
            cameras.push(view.intrinsics);
            cameras.len() - 1
        })
    };
    let cameras_of: Vec<usize> = views.iter().map(&mut camera_of).collect();
    let mut keypoints = vec![Vec::new(); views.len()];
    let point_bytes = point_bytes(points, tracks, &mut keypoints);
    let mut image_bytes = counted(views.len());
    for (i, view) in views.iter().enumerate() {
        let DQuat { x, y, z, w } = DQuat::from_mat3(&view.cam_from_world.matrix3);
        image_bytes.extend(number_of(i));
        numbers(&mut image_bytes, &[w, x, y, z]);
        numbers(&mut image_bytes, &view.cam_from_world.translation.to_array());
        image_bytes.extend(number_of(cameras_of[i]));
        image_bytes.extend(view.name.bytes().chain([0]));
        image_bytes.extend(counted(keypoints[i].len()));
        for (at_px, point) in &keypoints[i] {
            numbers(&mut image_bytes, &at_px.map(f64::from));
            image_bytes.extend((*point as u64 + 1).to_le_bytes());
        }
    }
    let files = [("cameras.bin", camera_bytes(&cameras)), ("images.bin", image_bytes), ("points3D.bin", point_bytes)];
    files.into_iter().try_for_each(|(name, bytes)| {
        let path = model.join(name);
        replace(&path, |out| out.write_all(&bytes)).map_err(|source: io::Error| DemoError::Io { path, source })
    })
}

fn camera_bytes(cameras: &[Intrinsics]) -> Vec<u8> {
    let mut bytes = counted(cameras.len());
    for (i, camera) in cameras.iter().enumerate() {
        // COLMAP's models with two focal lengths.
        let model: i32 = match camera.model {
            CameraModel::OpenCv => 4,
            CameraModel::Fisheye => 5,
            CameraModel::FullOpenCv => 6,
            CameraModel::ThinPrismFisheye => 10,
            _ => 1,
        };
        bytes.extend(number_of(i));
        bytes.extend(model.to_le_bytes());
        bytes.extend(counted(camera.width));
        bytes.extend(counted(camera.height));
        numbers(&mut bytes, &[camera.fx, camera.fy, camera.cx, camera.cy]);
        numbers(&mut bytes, &camera.distortion[..camera.model.coefficients()]);
    }
    bytes
}

/// The bytes of all points. Appends the position and the point of each observation to the keypoints of its view.
fn point_bytes(points: &PointCloud, tracks: &Tracks, keypoints: &mut [Vec<([f32; 2], usize)>]) -> Vec<u8> {
    let mut bytes = counted(points.positions.len());
    for (point, (position, colour)) in points.positions.iter().zip(&points.colours).enumerate() {
        let seen: Vec<&Observation> = tracks.of(point).iter().filter(|seen| seen.view < keypoints.len()).collect();
        bytes.extend((point as u64 + 1).to_le_bytes());
        numbers(&mut bytes, &position.map(f64::from));
        bytes.extend(colour);
        // COLMAP's value for an unmeasured error.
        numbers(&mut bytes, &[tracks.stated_error_px(point).map_or(-1.0, f64::from)]);
        bytes.extend(counted(seen.len()));
        for Observation { view, at_px } in seen {
            bytes.extend(number_of(*view));
            bytes.extend((keypoints[*view].len() as u32).to_le_bytes());
            keypoints[*view].push((*at_px, point));
        }
    }
    bytes
}

fn counted(count: usize) -> Vec<u8> {
    (count as u64).to_le_bytes().to_vec()
}

/// COLMAP's ids are 32 bits wide and start at one.
fn number_of(index: usize) -> [u8; 4] {
    (index as u32 + 1).to_le_bytes()
}

fn numbers(bytes: &mut Vec<u8>, numbers: &[f64]) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

#[cfg(test)]
mod tests;
