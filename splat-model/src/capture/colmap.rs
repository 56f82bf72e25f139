//! COLMAP reconstructions: `sparse/0/{cameras,images,points3D}.{bin,txt}` beside `images/`. Of several models the largest is read.
//!
//! Format: <https://colmap.github.io/format.html>. Poses map world to camera, axes are OpenCV's, quaternions are wxyz, pixel
//! centres lie at +0.5: the conventions of this crate. Keypoints are kept where a track refers to them; `rigs` and `frames` are ignored.

mod binary;
mod check;
mod files;
mod model;
mod text;
mod write;

#[cfg(test)]
mod tests;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

pub(super) use self::files::is_there;
use self::files::{Files, find, of_model};
use super::read::{Place, PlaceInFile, quoted, read};
use super::{Capture, CaptureError, Observation, Tracks, View};

pub use write::{write_binary, write_binary_with_tracks};

/// One line of `cameras`.
#[derive(Clone, Debug, PartialEq)]
struct CameraRecord {
    at: PlaceInFile,
    id: u32,
    intrinsics: Intrinsics,
}

/// One entry of `images`.
#[derive(Clone, Debug, PartialEq)]
struct ImageRecord {
    at: PlaceInFile,
    id: u32,
    camera_id: u32,
    name: String,
    cam_from_world: DAffine3,
    /// Keypoints, px. The tracks say which point each belongs to.
    keypoints: Vec<[f32; 2]>,
}

/// One entry of `points3D`.
#[derive(Clone, Debug, PartialEq)]
struct PointRecord {
    position: DVec3,
    colour: [u8; 3],
    /// Reprojection error as the file states it, px.
    error_px: f64,
    track: Vec<TrackElement>,
}

/// One observation of a point, by the file's image id and keypoint index.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TrackElement {
    image_id: u32,
    /// Counted from zero within the image.
    keypoint: u32,
}

/// See [`Capture::load`].
pub(super) fn load(folder: &Path) -> Result<Capture, CaptureError> {
    let (files, remark) = find(folder)?;
    let cameras = parse(&files.cameras, binary::cameras, text::cameras)?;
    let images = parse(&files.images, binary::images, text::images)?;
    let points = match files.points.exists() {
        true => parse(&files.points, binary::points, text::points)?,
        false => Vec::new(),
    };
    let capture = assemble(folder, &files, cameras, images, &points)?;
    let read = [files.cameras, files.images, files.points].into_iter().filter(|file| file.exists()).collect();
    Ok(Capture { files: read, remarks: remark.into_iter().collect(), ..capture })
}

/// The number of photographs in a model's folder, such as `sparse/0`.
///
/// # Errors
/// A [`CaptureError`] if it holds no model, or a damaged one.
pub fn photographs_in(model: &Path) -> Result<usize, CaptureError> {
    Ok(parse(&of_model(model)?.images, binary::images, text::images)?.len())
}

type Parser<T> = fn(&Path, &[u8]) -> Result<Vec<T>, CaptureError>;

fn parse<T>(file: &Path, binary: Parser<T>, text: Parser<T>) -> Result<Vec<T>, CaptureError> {
    let parser = if file.extension().is_some_and(|extension| extension == "bin") { binary } else { text };
    parser(file, &read(file)?)
}

fn assemble(
    folder: &Path,
    files: &Files,
    cameras: Vec<CameraRecord>,
    images: Vec<ImageRecord>,
    points: &[PointRecord],
) -> Result<Capture, CaptureError> {
    let cameras = by_id(&files.cameras, cameras)?;
    check_unique(&files.images, &images)?;
    let mut images = images;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let tracks = tracks(&images, points);
    let views = images
        .into_iter()
        .map(|image| {
            let intrinsics = *cameras.get(&image.camera_id).ok_or_else(|| no_camera(files, &image, cameras.len()))?;
            let image_path = folder.join("images").join(&image.name);
            Ok(View { name: image.name, image_path, intrinsics, cam_from_world: image.cam_from_world })
        })
        .collect::<Result<Vec<View>, CaptureError>>()?;
    if views.is_empty() {
        return Err(CaptureError::NoViews { file: files.images.clone() });
    }
    let (positions, colours): (Vec<_>, _) = points.iter().map(|point| (point.position, point.colour)).unzip();
    Ok(Capture { tracks, ..Capture::near_zero(folder, views, &positions, colours) })
}

/// The observations of all points, in the order of the points. `images` are in the order of the views.
fn tracks(images: &[ImageRecord], points: &[PointRecord]) -> Tracks {
    let by_id: HashMap<u32, usize> = images.iter().enumerate().map(|(view, image)| (image.id, view)).collect();
    let observation = |element: &TrackElement| {
        let view = *by_id.get(&element.image_id)?;
        let at_px = *images[view].keypoints.get(element.keypoint as usize)?;
        Some(Observation { view, at_px })
    };
    let mut tracks = Tracks::default();
    for point in points {
        tracks.push(point.track.iter().map(observation), point.error_px);
    }
    tracks
}

fn by_id(file: &Path, cameras: Vec<CameraRecord>) -> Result<HashMap<u32, Intrinsics>, CaptureError> {
    let mut map = HashMap::with_capacity(cameras.len());
    for CameraRecord { at, id, intrinsics } in cameras {
        if map.insert(id, intrinsics).is_some() {
            let place = Place::new(file, at);
            return Err(place.refuse("CAMERA_ID", format!("{id} again"), "a number of its own for each camera"));
        }
    }
    Ok(map)
}

fn check_unique(file: &Path, images: &[ImageRecord]) -> Result<(), CaptureError> {
    let (mut ids, mut names) = (HashSet::new(), HashSet::new());
    for ImageRecord { at, id, name, .. } in images {
        let place = Place::new(file, *at);
        if !ids.insert(id) {
            return Err(place.refuse("IMAGE_ID", format!("{id} again"), "a number of its own for each image"));
        }
        if !names.insert(name) {
            let found = format!("{} again", quoted(name));
            return Err(place.refuse("NAME", found, "a name of its own for each image"));
        }
    }
    Ok(())
}

fn no_camera(files: &Files, image: &ImageRecord, cameras: usize) -> CaptureError {
    let place = Place::new(&files.images, image.at);
    let found = format!("{} (of image {})", image.camera_id, quoted(&image.name));
    place.refuse("CAMERA_ID", found, format!("one of the {cameras} cameras in {}", files.cameras.display()))
}
