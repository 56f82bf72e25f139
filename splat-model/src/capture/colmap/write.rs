//! Writing a model in the binary encoding.

use std::fs;
use std::io::Write;
use std::path::Path;

use glam::{DAffine3, DMat3, DQuat};
use splat_op::Intrinsics;

use super::model::ColmapCameraModel;
use super::{ModelFiles, binary, by_id, check_entries};
use crate::capture::read::{Place, PlaceInFile};
use crate::capture::{CaptureError, PointCloud, Tracks, View};
use crate::replace::replace;

/// The largest accepted deviation of a pose from rigid: well above f64 rounding, well below what a picture shows.
const RIGID_WITHIN: f64 = 1e-6;

/// Writes `cameras.bin`, `images.bin` and `points3D.bin` under `folder/sparse/0`, replacing those that are there.
///
/// Positions are written as they are, relative to the capture's origin if it has one. Images have no keypoints and
/// points empty tracks (see [`write_binary_with_tracks`]); views of equal [`Intrinsics`] share a camera. Pictures are not
/// written; each view's is expected at `folder/images/<name>`.
///
/// Each file is written under a temporary name and renamed, so that it appears whole or not at all.
///
/// # Errors
///
/// A [`CaptureError`] if a file cannot be written, or for anything that [`Capture::load`](crate::capture::Capture::load)
/// would refuse to read; then nothing is written.
pub fn write_binary(folder: &Path, views: &[View], points: &PointCloud) -> Result<(), CaptureError> {
    write_binary_with_tracks(folder, views, points, &Tracks::default())
}

/// As [`write_binary`], with the points' tracks, which refer to `views` and `points` in their order.
///
/// # Errors
///
/// Those of [`write_binary`].
pub fn write_binary_with_tracks(
    folder: &Path,
    views: &[View],
    points: &PointCloud,
    tracks: &Tracks,
) -> Result<(), CaptureError> {
    let model = folder.join("sparse").join("0");
    let files = ModelFiles::encoded(&model, "bin");
    if points.positions.len() != points.colours.len() {
        let (positions, colours) = (points.positions.len(), points.colours.len());
        let detail =
            format!("{positions} positions and {colours} colours of points, expected one colour for each position");
        return Err(CaptureError::content(&files.points, detail));
    }
    let cameras = distinct(views);
    let camera_bytes = camera_bytes(&files.cameras, &cameras)?;
    let (keypoints, elements) = keypoints(views.len(), points, tracks);
    let image_bytes = image_bytes(&files.images, &cameras, views, &keypoints)?;
    let point_bytes = point_bytes(points, tracks, &elements);
    // Reads back the bytes before they are written, so that reader and writer cannot disagree on validity.
    let read = by_id(&files.cameras, binary::cameras(&files.cameras, &camera_bytes)?)?;
    check_entries(&files, &read, &binary::images(&files.images, &image_bytes)?)?;
    binary::points(&files.points, &point_bytes)?;
    fs::create_dir_all(&model).map_err(|reason| CaptureError::Write { file: model, reason })?;
    for (file, bytes) in [(files.cameras, camera_bytes), (files.images, image_bytes), (files.points, point_bytes)] {
        replace(&file, |out| out.write_all(&bytes)).map_err(|reason| CaptureError::Write { file, reason })?;
    }
    Ok(())
}

/// Each of the views' intrinsics once, in order of first use.
fn distinct(views: &[View]) -> Vec<Intrinsics> {
    let mut cameras: Vec<Intrinsics> = Vec::new();
    for view in views {
        if !cameras.contains(&view.intrinsics) {
            cameras.push(view.intrinsics);
        }
    }
    cameras
}

fn camera_bytes(file: &Path, cameras: &[Intrinsics]) -> Result<Vec<u8>, CaptureError> {
    let mut out = Bytes::counted(cameras.len());
    for (i, camera) in cameras.iter().enumerate() {
        let place = Place::new(file, PlaceInFile::Entry("camera", i + 1));
        let (number, model) =
            ColmapCameraModel::full(camera.model).ok_or_else(|| place.unsupported(&format!("{:?}", camera.model)))?;
        out.add(number_of(i).to_le_bytes());
        out.add(number.to_le_bytes());
        out.add((camera.width as u64).to_le_bytes());
        out.add((camera.height as u64).to_le_bytes());
        out.numbers([camera.fx, camera.fy, camera.cx, camera.cy]);
        let (used, unused) = camera.distortion.split_at(model.coefficients);
        if let Some(&found) = unused.iter().find(|coefficient| **coefficient != 0.0) {
            let expected = "zeros after the coefficients of the camera's model";
            return Err(place.refuse_with("distortion", found, expected, "Set them to zero, or choose their model"));
        }
        used.iter().for_each(|&coefficient| out.numbers([coefficient]));
    }
    Ok(out.0)
}

/// An observation as a photograph lists it: its position and its point.
type Keypoint = ([f32; 2], usize);

/// The keypoints of each view, and for each point the view and keypoint of each of its observations.
fn keypoints(views: usize, points: &PointCloud, tracks: &Tracks) -> (Vec<Vec<Keypoint>>, Vec<Vec<[usize; 2]>>) {
    let mut keypoints: Vec<Vec<Keypoint>> = vec![Vec::new(); views];
    let track = |point: usize| {
        let mut elements = Vec::new();
        for observation in tracks.of(point).iter().filter(|observation| observation.view < views) {
            elements.push([observation.view, keypoints[observation.view].len()]);
            keypoints[observation.view].push((observation.at_px, point));
        }
        elements
    };
    let elements = (0..points.positions.len()).map(track).collect();
    (keypoints, elements)
}

fn image_bytes(
    file: &Path,
    cameras: &[Intrinsics],
    views: &[View],
    keypoints: &[Vec<Keypoint>],
) -> Result<Vec<u8>, CaptureError> {
    let mut out = Bytes::counted(views.len());
    for (i, view) in views.iter().enumerate() {
        let place = Place::new(file, PlaceInFile::Entry("image", i + 1));
        let name = place.name(&view.name)?;
        let rotation = rotation(&place, &view.cam_from_world)?;
        out.add(number_of(i).to_le_bytes());
        out.numbers([rotation.w, rotation.x, rotation.y, rotation.z]);
        out.numbers(view.cam_from_world.translation.to_array());
        // A camera with a NaN equals none, itself included; it is refused when the bytes are read back.
        let camera = cameras.iter().position(|camera| *camera == view.intrinsics).unwrap_or(0);
        out.add(number_of(camera).to_le_bytes());
        out.0.extend_from_slice(name.as_bytes());
        out.add([0]);
        out.add((keypoints[i].len() as u64).to_le_bytes());
        for (at_px, point) in &keypoints[i] {
            out.numbers(at_px.map(f64::from));
            out.add((*point as u64 + 1).to_le_bytes());
        }
    }
    Ok(out.0)
}

fn point_bytes(points: &PointCloud, tracks: &Tracks, elements: &[Vec<[usize; 2]>]) -> Vec<u8> {
    let mut out = Bytes::counted(points.positions.len());
    for (point, (position, colour)) in points.positions.iter().zip(&points.colours).enumerate() {
        out.add((point as u64 + 1).to_le_bytes());
        out.numbers(position.map(f64::from));
        out.add(*colour);
        // COLMAP's value for an unmeasured error.
        out.numbers([tracks.stated_error_px(point).map_or(-1.0, f64::from)]);
        out.add((elements[point].len() as u64).to_le_bytes());
        for &[view, keypoint] in &elements[point] {
            out.add(number_of(view).to_le_bytes());
            // Keypoint indices start at zero, and no photograph has 2³² keypoints.
            out.add((keypoint as u32).to_le_bytes());
        }
    }
    out.0
}

/// COLMAP's ids are 32 bits wide and start at one.
fn number_of(index: usize) -> u32 {
    // More than 2³² views do not fit in memory; ids that wrapped would be refused as duplicates when read back.
    (index as u32).wrapping_add(1)
}

fn rotation(place: &Place, cam_from_world: &DAffine3) -> Result<DQuat, CaptureError> {
    let matrix = cam_from_world.matrix3;
    let rigid = (matrix * matrix.transpose()).abs_diff_eq(DMat3::IDENTITY, RIGID_WITHIN) && matrix.determinant() > 0.0;
    match rigid {
        true => Ok(DQuat::from_mat3(&matrix)),
        false => Err(place.refuse_with(
            "cam_from_world",
            format!("the matrix {:?}", matrix.transpose().to_cols_array_2d()),
            "a rotation",
            "Give the view a rigid pose: scale the positions instead, or mirror the picture",
        )),
    }
}

struct Bytes(Vec<u8>);

impl Bytes {
    fn counted(count: usize) -> Self {
        Self((count as u64).to_le_bytes().to_vec())
    }

    fn add<const N: usize>(&mut self, bytes: [u8; N]) {
        self.0.extend_from_slice(&bytes);
    }

    fn numbers<const N: usize>(&mut self, numbers: [f64; N]) {
        for number in numbers {
            self.add(number.to_le_bytes());
        }
    }
}
