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
use std::fs;
use std::io;
use std::path::Path;

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

use self::check::{ColmapEntry, EntryPosition};
pub(super) use self::check::{MAX_MAGNITUDE, quoted};
use self::files::{Files, FoundModel, find};
use super::{Capture, CaptureError, Observation, PointCloud, Tracks, View, origin};

pub use write::{write_binary, write_binary_with_tracks};

/// One line of `cameras`.
#[derive(Clone, Debug, PartialEq)]
struct CameraRecord {
    at: EntryPosition,
    id: u32,
    intrinsics: Intrinsics,
}

/// One entry of `images`.
#[derive(Clone, Debug, PartialEq)]
struct ImageRecord {
    at: EntryPosition,
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

/// Whether the folder holds a model; its points may be missing.
pub(super) fn is_there(folder: &Path) -> bool {
    files::is_there(folder)
}

/// See [`Capture::load`].
pub(super) fn load(folder: &Path) -> Result<Capture, CaptureError> {
    let FoundModel { files, remark } = find(folder)?;
    let cameras = parse(&files.cameras, binary::cameras, text::cameras)?;
    let images = parse(&files.images, binary::images, text::images)?;
    let points = match files.points.exists() {
        true => parse(&files.points, binary::points, text::points)?,
        false => Vec::new(),
    };
    let capture = assemble(folder, &files, cameras, images, &points)?;
    Ok(Capture { remarks: remark.into_iter().collect(), ..capture })
}

type Parser<T> = fn(&Path, &[u8]) -> Result<Vec<T>, CaptureError>;

fn parse<T>(file: &Path, binary: Parser<T>, text: Parser<T>) -> Result<Vec<T>, CaptureError> {
    let parser = if file.extension().is_some_and(|extension| extension == "bin") { binary } else { text };
    parser(file, &read(file)?)
}

/// Reads a whole file. Only regular files are read, because a pipe would never end.
fn read(file: &Path) -> Result<Vec<u8>, CaptureError> {
    let fail = |reason| CaptureError::Read {
        file: file.to_owned(),
        reason,
        fix: "Check that it is an ordinary file which you may read",
    };
    if !fs::metadata(file).map_err(fail)?.is_file() {
        return Err(fail(io::Error::new(io::ErrorKind::InvalidInput, "not a regular file")));
    }
    fs::read(file).map_err(fail)
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
    let mut views = images
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
    let poses: Vec<DAffine3> = views.iter().map(|view| view.cam_from_world).collect();
    let origin = origin::choose(&poses);
    for view in &mut views {
        view.cam_from_world = origin::moved(&view.cam_from_world, origin);
    }
    let points = PointCloud {
        positions: points.iter().map(|point| (point.position - origin).as_vec3().to_array()).collect(),
        colours: points.iter().map(|point| point.colour).collect(),
    };
    let (split, masks, remarks) = Default::default();
    Ok(Capture { folder: folder.to_owned(), views, points, tracks, origin, split, masks, remarks })
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
    for camera in cameras {
        if map.insert(camera.id, camera.intrinsics).is_some() {
            let place = ColmapEntry { file, kind: "camera", at: camera.at };
            return Err(place.refuse(
                "CAMERA_ID",
                format!("{} again", camera.id),
                "a number of its own for each camera",
            ));
        }
    }
    Ok(map)
}

fn check_unique(file: &Path, images: &[ImageRecord]) -> Result<(), CaptureError> {
    let (mut ids, mut names) = (HashSet::new(), HashSet::new());
    for image in images {
        let place = ColmapEntry { file, kind: "image", at: image.at };
        if !ids.insert(image.id) {
            return Err(place.refuse("IMAGE_ID", format!("{} again", image.id), "a number of its own for each image"));
        }
        if !names.insert(&image.name) {
            return Err(place.refuse(
                "NAME",
                format!("{} again", quoted(&image.name)),
                "a name of its own for each image",
            ));
        }
    }
    Ok(())
}

fn no_camera(files: &Files, image: &ImageRecord, cameras: usize) -> CaptureError {
    let place = ColmapEntry { file: &files.images, kind: "image", at: image.at };
    let found = format!("{} (of image {})", image.camera_id, quoted(&image.name));
    place.refuse("CAMERA_ID", found, format!("one of the {cameras} cameras in {}", files.cameras.display()))
}
