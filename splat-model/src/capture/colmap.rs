//! COLMAP reconstructions: `sparse/0/{cameras,images,points3D}.{bin,txt}` beside `images/`, or wherever [`find`](super::find) finds them. Of several models the largest is read.
//!
//! Format: <https://colmap.github.io/format.html>. Poses map world to camera, axes are OpenCV's, quaternions are wxyz, pixel
//! centres lie at +0.5: the conventions of this crate. Keypoints are kept where a track refers to them; `rigs` and `frames` are ignored.

mod binary;
mod check;
mod files;
mod model;
mod pictures;
mod text;

#[cfg(test)]
mod tests;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

use self::files::{ModelFiles, find, of_model};
pub(super) use self::files::{SPARSE, is_complete, models_in};
pub use self::pictures::Pictures;
use super::names::{Names, PICTURES, parent};
use super::read::{Place, PlaceInFile, quoted, read};
use super::{Capture, CaptureError, CaptureFormat, Cut, Observation, Result, Tracks, View};
use crate::encoding::utf8;
use crate::ply;

/// One line of `cameras`.
#[derive(Clone, Debug, PartialEq)]
struct CameraRecord {
    at: PlaceInFile,
    id: u32,
    intrinsics: Intrinsics,
    cut: Cut,
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

/// The format.
pub(super) struct Colmap;

impl CaptureFormat for Colmap {
    fn name(&self) -> &'static str {
        "COLMAP"
    }

    /// The models in `sparse/`, if one is complete.
    fn usual(&self, folder: &Path) -> Vec<PathBuf> {
        let models = models_in(&folder.join(SPARSE));
        if models.iter().any(|model| is_complete(model)) { models } else { Vec::new() }
    }

    /// Models in numbered subfolders, or else in the folder itself. They may be incomplete.
    fn here(&self, folder: &Path) -> Vec<Vec<PathBuf>> {
        let models: Vec<PathBuf> = models_in(folder).into_iter().filter(|model| is_model(model)).collect();
        let models = if models.is_empty() && is_model(folder) { vec![folder.to_owned()] } else { models };
        if models.is_empty() { Vec::new() } else { vec![models] }
    }

    fn of_file(&self, file: &Path) -> Vec<PathBuf> {
        let [stem, extension] = [file.file_stem(), file.extension()]
            .map(|part| part.map(|part| part.to_string_lossy().to_ascii_lowercase()).unwrap_or_default());
        let is_part = ["cameras", "images", "points3d", "rigs", "frames"].contains(&&*stem);
        let folder = Some(parent(file)).filter(|_| is_part && ["bin", "txt"].contains(&&*extension));
        folder.into_iter().filter(|folder| is_model(folder)).collect()
    }

    fn load(&self, models: &[PathBuf], pictures: &Pictures) -> Result<Capture> {
        load(models, pictures)
    }
}

/// Whether a folder has files of a model, complete or not. A file `images.txt` alone may be any list.
fn is_model(folder: &Path) -> bool {
    ["cameras.bin", "cameras.txt", "images.bin"].iter().any(|name| folder.join(name).is_file())
}

/// Loads one of some models, and finds its pictures.
pub(super) fn load(models: &[PathBuf], pictures: &Pictures) -> Result<Capture> {
    let (files, remark) = find(models)?;
    let cameras = by_id(&files.cameras, parse(&files.cameras, binary::cameras, text::cameras)?)?;
    let mut images = parse(&files.images, binary::images, text::images)?;
    let size = |image: &ImageRecord| cameras.get(&image.camera_id).map(|(camera, _)| [camera.width, camera.height]);
    let root = pictures.root(&files.cameras, &images, size);
    let mut names = Names::default();
    for image in &mut images {
        if let Some(found) = names.find(&root.pictures, &image.name, &PICTURES) {
            image.name = found;
        }
    }
    check_entries(&files, &cameras, &images)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let path = &files.points;
    let mut points = if path.exists() { parse(path, binary::points, text::points)? } else { Vec::new() };
    let mut remarks: Vec<String> = remark.into_iter().collect();
    let mut read = vec![files.images, files.cameras];
    let tracks = tracks(&images, &points);
    if !points.is_empty() {
        read.push(files.points);
    } else if let Some(file) = point_file([&parent(&read[0]), &root.capture]) {
        let (positions, colours) = ply::read_points(&file).map_err(|error| CaptureError::Content(error.to_string()))?;
        remarks.push(format!("the model has no points: {} are read from {}", positions.len(), file.display()));
        let point = |(position, colour)| PointRecord { position, colour, error_px: f64::NAN, track: Vec::new() };
        points = positions.into_iter().zip(colours).map(point).collect();
        read.push(file);
    }
    let view = |image: ImageRecord| View {
        image_path: root.pictures.join(&image.name),
        name: image.name,
        intrinsics: cameras[&image.camera_id].0,
        cam_from_world: image.cam_from_world,
        cut: cameras[&image.camera_id].1.clone(),
    };
    let views = images.into_iter().map(view).collect();
    let (positions, colours): (Vec<_>, _) = points.iter().map(|point| (point.position, point.colour)).unzip();
    Ok(Capture { tracks, remarks, files: read, ..Capture::near_zero(&root.capture, views, &positions, colours) })
}

/// The first of the files of points that programs write beside a model: COLMAP's, nerfstudio's and the original code's.
pub(super) fn point_file(folders: [&PathBuf; 2]) -> Option<PathBuf> {
    const FILES: [&str; 6] =
        ["points3D.ply", "sparse_pc.ply", "fused.ply", "input.ply", "points.ply", "point_cloud.ply"];
    let mut names = Names::default();
    let files = folders.into_iter().flat_map(|folder| FILES.map(|name| (folder, name)));
    files.into_iter().find_map(|(folder, name)| Some(folder.join(names.find(folder, name, &[])?)))
}

/// The number of photographs in a model's folder, such as `sparse/0`.
///
/// # Errors
/// A [`CaptureError`] if it holds no model, or a damaged one.
pub fn photographs_in(model: &Path) -> Result<usize> {
    Ok(parse(&of_model(model)?.images, binary::images, text::images)?.len())
}

type Parser<T> = fn(&Path, &[u8]) -> Result<Vec<T>>;

fn parse<T>(file: &Path, binary: Parser<T>, text: Parser<T>) -> Result<Vec<T>> {
    let parser = if file.extension().is_some_and(|extension| extension == "bin") { binary } else { text };
    let is_text = file.extension().is_some_and(|extension| extension == "txt");
    let bytes = read(file)?;
    parser(file, &if is_text { utf8(bytes) } else { bytes })
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
        tracks.push(point.track.iter().filter_map(observation), point.error_px);
    }
    tracks
}

/// Cameras by their `CAMERA_ID`.
type CamerasById = HashMap<u32, (Intrinsics, Cut)>;

fn by_id(file: &Path, cameras: Vec<CameraRecord>) -> Result<CamerasById> {
    let mut map = HashMap::with_capacity(cameras.len());
    for CameraRecord { at, id, intrinsics, cut } in cameras {
        if map.insert(id, (intrinsics, cut)).is_some() {
            let place = Place::new(file, at);
            return Err(place.refuse("CAMERA_ID", format!("{id} again"), "a number of its own for each camera"));
        }
    }
    Ok(map)
}

/// Checks that each image has a camera, and an id and a name of its own.
fn check_entries(files: &ModelFiles, cameras: &CamerasById, images: &[ImageRecord]) -> Result<()> {
    let (mut ids, mut names) = (HashSet::new(), HashSet::new());
    for image in images {
        let place = Place::new(&files.images, image.at);
        if !ids.insert(image.id) {
            return Err(place.refuse("IMAGE_ID", format!("{} again", image.id), "a number of its own for each image"));
        }
        if !names.insert(&image.name) {
            let found = format!("{} again", quoted(&image.name));
            return Err(place.refuse("NAME", found, "a name of its own for each image"));
        }
        if !cameras.contains_key(&image.camera_id) {
            let found = format!("{} (of image {})", image.camera_id, quoted(&image.name));
            let expected = format!("one of the {} cameras in {}", cameras.len(), files.cameras.display());
            return Err(place.refuse("CAMERA_ID", found, expected));
        }
    }
    if images.is_empty() { Err(CaptureError::no_views(&files.images)) } else { Ok(()) }
}
