//! Captures that other programs export with poses. Readers make frames of their files, as [`super::transforms`] has them, which checks names, poses
//! and lenses. The world is that of the files.

mod metashape;
mod polycam;
mod realityscan;
mod record3d;

#[cfg(test)]
mod tests;

use std::iter::once;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DMat4;

use super::names::{Names, PICTURES, below, children, parent};
use super::transforms::{Fields, each, of_frames};
use super::{Capture, CaptureFormat, Pictures, Result};

/// The formats, in the order in which they are tried.
pub(super) fn formats() -> impl Iterator<Item = Arc<dyn CaptureFormat>> {
    let all = [polycam::FORMAT, record3d::FORMAT, metashape::FORMAT, realityscan::FORMAT];
    all.into_iter().map(|format| Arc::new(format) as Arc<dyn CaptureFormat>)
}

struct Format {
    name: &'static str,
    /// Whether a file, or for Polycam a folder, is cameras of the format.
    is: fn(&Path) -> bool,
    frames: fn(&Path, &mut Photographs) -> Result<Vec<Fields>>,
}

impl CaptureFormat for Format {
    fn name(&self) -> &'static str {
        self.name
    }

    fn usual(&self, _: &Path) -> Vec<PathBuf> {
        Vec::new()
    }

    fn here(&self, folder: &Path) -> Vec<Vec<PathBuf>> {
        each(folder, self.is)
    }

    fn of_file(&self, file: &Path) -> Vec<PathBuf> {
        if (self.is)(file) { vec![file.to_owned()] } else { Vec::new() }
    }

    fn load(&self, cameras: &[PathBuf], pictures: &Pictures) -> Result<Capture> {
        let mut photographs = Photographs::around(&cameras[0], pictures);
        let frames = (self.frames)(&cameras[0], &mut photographs)?;
        of_frames(photographs.folder, &cameras[0], frames, photographs.remarks)
    }
}

/// Finds photographs by what cameras call them, as a rule without their folder: in `images` or `input` beside the cameras or in the capture, there
/// themselves, or up to two folders below.
struct Photographs {
    folder: PathBuf,
    /// Paths below the folder. A photograph that is nowhere is missing in the first.
    places: Vec<String>,
    names: Names,
    /// Notes for the user.
    remarks: Vec<String>,
}

impl Photographs {
    fn around(cameras: &Path, pictures: &Pictures) -> Self {
        let folder = match pictures {
            Pictures::Near(folder) => folder.to_path_buf(),
            Pictures::In(folder) => parent(folder),
        };
        let with_children = |child: PathBuf| once(child.clone()).chain(children(&child));
        let (beside, bases) = (parent(cameras), [parent(cameras), folder.clone()]);
        let usual = bases.iter().flat_map(|base| ["images", "input", ""].map(|name| base.join(name)));
        let deeper = bases.iter().flat_map(|base| children(base)).flat_map(with_children);
        let below = |place: PathBuf| Some(place.strip_prefix(&folder).ok()?.to_str()?.replace('\\', "/"));
        let places = once(beside).chain(usual).chain(deeper).filter_map(below).collect();
        Self { folder, places, names: Names::default(), remarks: Vec::new() }
    }

    /// The path of a photograph below the folder.
    fn find(&mut self, name: &str) -> String {
        // Who reads the frame refuses a name that leads out of the folder.
        let Some(name) = below(name) else { return name.to_owned() };
        let join = |place: &str, name: &str| format!("{place}/{name}").trim_start_matches('/').to_owned();
        let found = self
            .places
            .iter()
            .find_map(|place| Some(join(place, &self.names.find(&self.folder.join(place), &name, &PICTURES)?)));
        found.unwrap_or_else(|| join(self.places.first().map_or("", String::as_str), &name))
    }
}

/// A frame with a pose whose camera has OpenGL's axes, focal lengths, principal point and, where it is known, size, px.
fn frame(file_path: String, world_from_cam: DMat4, lens: [f64; 4], size: Option<[f64; 2]>) -> Fields {
    let rows = world_from_cam.transpose().to_cols_array_2d();
    let ([fl_x, fl_y, cx, cy], [w, h]) = (lens.map(Some), [0, 1].map(|side| size.map(|size| size[side])));
    let (file_path, transform_matrix) = (Some(file_path), Some(rows.map(Vec::from).to_vec()));
    Fields { file_path, transform_matrix, fl_x, fl_y, cx, cy, w, h, ..Fields::default() }
}

/// A frame with a model of lenses and its coefficients.
fn with_lens(frame: Fields, model: &str, coefficients: [f64; 6]) -> Fields {
    let [k1, k2, p1, p2, k3, k4] = coefficients.map(Some);
    Fields { camera_model: Some(model.into()), k1, k2, p1, p2, k3, k4, ..frame }
}
