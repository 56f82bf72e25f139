//! Captures: photographs with their cameras and, where there is one, a sparse point cloud. One file per format.

pub mod blocks;
pub mod image;

mod colmap;
pub(crate) mod depth_maps;
mod error;
pub mod exif;
mod exports;
mod find;
mod format;
pub mod masks;
pub(crate) mod names;
pub(crate) mod origin;
pub(crate) mod packed;
pub mod panoramas;
mod photograph;
mod read;
pub mod scale;
pub(crate) mod seen;
mod split;
pub(crate) mod spread;
pub(crate) mod strays;
mod tracks;
mod transforms;
pub mod unposed;
mod unused;

#[cfg(test)]
pub(crate) mod testing;

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3, Vec2, Vec3};
use splat_op::Intrinsics;

use self::blocks::Bounds;
pub use colmap::{Pictures, photographs_in};
pub use error::{CaptureError, Result};
pub use format::{CaptureFormat, register};
pub use image::{Photo, load_all};
pub use panoramas::Cut;
pub use photograph::{Photograph, PhotographFacts};
pub use scale::Scale;
pub use seen::PointsSeen;
pub use split::Split;
pub use tracks::{Observation, Tracks};
pub use transforms::read_keyframes;

use crate::ply::WorldFrame;

/// A capture as its files describe it. Pictures are not decoded yet.
#[derive(Clone, Debug, Default)]
pub struct Capture {
    /// Name of the [format](CaptureFormat).
    pub format: &'static str,
    /// The capture's folder, which holds masks and the like.
    pub folder: PathBuf,
    /// The files that were read, besides pictures: first that which lists the photographs, then cameras, points, the size of a unit and the
    /// list of a block.
    pub files: Vec<PathBuf>,
    /// Photographs, sorted by name. The six views of a [panorama](panoramas) stand together.
    pub views: Vec<View>,
    /// Sparse points, empty if the capture has none.
    pub points: PointCloud,
    /// The observations of the points in the photographs; empty where the files have none.
    pub tracks: Tracks,
    /// The offset subtracted, in f64, from every position of the files: `position_file = position + origin`.
    /// Zero unless the capture lies far enough from zero for f32 to lose digits.
    pub origin: DVec3,
    /// The size of a scene unit, where it was measured: `scale.json` in the folder.
    pub scale: Option<Scale>,
    /// The files' own split into training and held-out views, if any; see [`Split::of`].
    pub split: Option<Split>,
    /// Mask files that the capture itself names, one entry per view, or empty; see
    /// [`masks::find`].
    pub masks: Vec<Option<PathBuf>>,
    /// The part of the scene on which the capture focuses, if it is a block of another; see [`blocks`].
    pub focus: Option<Bounds>,
    /// Notes for the user about how the files were read.
    pub remarks: Vec<String>,
}

impl Capture {
    /// Reads a folder as the first of these formats that matches, after those of [`register`]:
    ///
    /// 1. COLMAP: `images/`, and `sparse/0/` (or `sparse/`) with `cameras`, `images` and `points3D`, each as `.bin` or else
    ///    as `.txt`. Of several models, `sparse/0`, `sparse/1` and so on, the one with the most photographs.
    /// 2. NeRF-synthetic: `transforms_train.json`, and `transforms_test.json` or else `transforms_val.json`, which make the
    ///    capture's own split.
    /// 3. nerfstudio and instant-ngp: `transforms.json`. Its `train_filenames`, `val_filenames` and `test_filenames` make the
    ///    capture's own split, its `ply_file_path` is the point cloud, and its frames may name masks.
    /// 4. A COLMAP model, a JSON file with frames, or an export of Polycam, Record3D, Metashape or RealityScan anywhere in the folder, or directly
    ///    above it, if it is the only one whose photographs are there.
    ///
    /// Before them comes a block: `block.json`, which names a capture in one of these formats and a part of it (see [`blocks`]). The
    /// folder of the result is that of the whole capture, and so are its origin, masks and depth maps. A file of cameras may be named
    /// instead of its folder.
    ///
    /// Pictures are not opened, except for the sizes in their headers where a JSON file lacks them. A picture in JSON is named by its path
    /// below the folder, with its extension. Names may differ from the files' in letter case and Unicode form, and have `\` for `/`.
    ///
    /// Without points the point cloud is empty. A capture whose mean camera centre lies further from zero than 100
    /// times its extent is moved next to zero; [`Capture::origin`] says by how much. `scale.json` gives the size of a scene unit.
    /// Photographs whose poses cannot be right, up to a quarter, are left out, and [`Capture::remarks`] name them.
    ///
    /// # Errors
    ///
    /// A [`CaptureError`] if there is neither a COLMAP model nor one of the JSON files, or if any file is cut short,
    /// contradicts another, or holds what no capture can have.
    pub fn load(folder: &Path) -> Result<Self> {
        if blocks::is_there(folder) {
            return blocks::load(folder);
        }
        let mut capture = find::load(folder)?;
        capture.scale = Scale::load(&capture.folder)?;
        capture.files.extend(capture.scale.is_some().then(|| capture.folder.join(scale::SCALE_FILE)));
        let unused = unused::remarks(&capture);
        capture.remarks.extend(unused);
        Ok(strays::leave_out(capture))
    }

    /// Whether a folder holds a capture's cameras in one of the formats of [`load`](Self::load), or is a file of them. They may be damaged, or
    /// several.
    pub fn is_in(folder: &Path) -> bool {
        blocks::is_there(folder) || find::is_there(folder)
    }

    /// Checks that the photographs of some views are there, without opening them.
    ///
    /// # Errors
    /// A [`CaptureError`], with the number of all photographs that are not.
    pub fn check_photographs(&self, views: &[usize]) -> Result<()> {
        // A folder in the place of a picture has an error of its own.
        if views.iter().all(|&view| self.views[view].image_path.exists()) {
            return Ok(());
        }
        let mut paths: Vec<&PathBuf> = self.views.iter().map(|view| &view.image_path).collect();
        paths.dedup();
        let missing: Vec<PathBuf> = paths.iter().filter(|path| !path.exists()).copied().cloned().collect();
        Err(names::missing_photographs(&missing, paths.len(), self.files.first().unwrap_or(&self.folder)))
    }

    /// A capture of views and points, `positions` with a colour each, of the files' world, moved next to zero where it lies far away.
    /// Without tracks, split and masks.
    pub fn near_zero(folder: &Path, mut views: Vec<View>, positions: &[DVec3], colours: Vec<[u8; 3]>) -> Self {
        let poses: Vec<DAffine3> = views.iter().map(|view| view.cam_from_world).collect();
        let origin = origin::choose(&poses);
        for view in &mut views {
            view.cam_from_world = origin::moved(&view.cam_from_world, origin);
        }
        let positions = positions.iter().map(|&position| (position - origin).as_vec3().to_array()).collect();
        let points = PointCloud { positions, colours };
        Self { folder: folder.to_owned(), views, points, origin, ..Self::default() }
    }

    /// What a file of a scene in this capture's world states about it.
    pub fn world_frame(&self) -> WorldFrame {
        let metres_per_unit = self.scale.as_ref().map(|scale| scale.metres_per_unit);
        WorldFrame { metres_per_unit, ..self.origin.into() }
    }

    /// Mean number of pixels of some photographs, whose longer sides are at most `max_side` px. 0 without photographs.
    pub fn mean_pixels(&self, views: &[usize], max_side: Option<u32>) -> f64 {
        let cameras = views.iter().map(|&view| self.views[view].intrinsics_within(max_side));
        cameras.map(|camera| (camera.width * camera.height) as f64).sum::<f64>() / views.len().max(1) as f64
    }

    /// The position of a sparse point, world frame.
    pub(crate) fn position(&self, point: usize) -> DVec3 {
        Vec3::from_array(self.points.positions[point]).as_dvec3()
    }

    /// What `found` makes of each observation of a point in the tracks, of the point in the camera's frame and its distance from where it was
    /// observed, px, infinite where the camera cannot show it: a list for each of `views`.
    pub(crate) fn misses<T>(
        &self,
        views: impl IntoIterator<Item = usize>,
        found: impl Fn(&View, &Observation, DVec3, f64) -> Option<T>,
    ) -> Vec<Vec<T>> {
        let projectors: Vec<_> = self.views.iter().map(|view| view.intrinsics.projector()).collect();
        self.by_view(views, |view, world, seen| {
            let cam = view.cam_from_world.transform_point3(world);
            let at_px = Vec2::from_array(seen.at_px).as_dvec2();
            let miss_px = projectors[seen.view].px_from_cam(cam).map_or(f64::INFINITY, |px| px.distance(at_px));
            found(view, seen, cam, miss_px)
        })
    }

    /// What `found` makes of each observation of a point (world frame) in the tracks: a list for each of `views`.
    pub(crate) fn by_view<T>(
        &self,
        views: impl IntoIterator<Item = usize>,
        found: impl Fn(&View, DVec3, &Observation) -> Option<T>,
    ) -> Vec<Vec<T>> {
        let mut place = vec![None; self.views.len()];
        let mut lists = Vec::new();
        for view in views {
            place[view] = Some(lists.len());
            lists.push(Vec::new());
        }
        for point in 0..self.points.positions.len() {
            for observation in self.tracks.of(point) {
                if let Some(&Some(at)) = place.get(observation.view) {
                    lists[at].extend(found(&self.views[observation.view], self.position(point), observation));
                }
            }
        }
        lists
    }
}

/// One photograph.
#[derive(Clone, Debug)]
pub struct View {
    /// Path below the picture folder, which is the capture's folder for JSON captures.
    pub name: String,
    /// Path of the picture.
    pub image_path: PathBuf,
    /// Size and projection, at the size of the file, or of a face of it.
    pub intrinsics: Intrinsics,
    /// Pose: rigid, OpenCV axes, world relative to [`Capture::origin`].
    pub cam_from_world: DAffine3,
    /// What part of the file the picture is.
    pub cut: Cut,
}

impl View {
    /// The intrinsics of a photograph whose longer side is at most `max_side` px.
    pub fn intrinsics_within(&self, max_side: Option<u32>) -> Intrinsics {
        let Intrinsics { width, height, .. } = self.intrinsics;
        let [width, height] = image::size_within([width as u32, height as u32], max_side);
        self.intrinsics.resized(width as usize, height as usize)
    }
}

/// Points of a sparse reconstruction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions, world frame relative to [`Capture::origin`].
    pub positions: Vec<[f32; 3]>,
    /// Display-referred colours, 0 to 255.
    pub colours: Vec<[u8; 3]>,
}

impl PointCloud {
    /// The points of these indices, in their order.
    pub fn picked(&self, points: impl Iterator<Item = usize>) -> Self {
        let (positions, colours) = points.map(|point| (self.positions[point], self.colours[point])).unzip();
        Self { positions, colours }
    }

    /// Drops the points from `count` on.
    pub fn truncate(&mut self, count: usize) {
        self.positions.truncate(count);
        self.colours.truncate(count);
    }
}
