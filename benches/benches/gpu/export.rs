//! Writes scenes and captures for `benches/gsplat.py`, so that another program measures the same.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use serde::Serialize;
use splat_benches::job::{Job, JobSize};
use splat_model::capture::{Capture, Split, View};
use splat_model::ply;
use splat_op::{CameraModel, Intrinsics};
use splat_train::input::extent;

/// A pinhole camera: sizes, focal lengths and principal point, px, and the pose, row by row, with OpenCV's axes.
#[derive(Serialize)]
struct Pinhole {
    size: [usize; 2],
    lens: [f64; 4],
    cam_from_world: [[f64; 4]; 3],
}

impl Pinhole {
    fn new(intrinsics: &Intrinsics, cam_from_world: &DAffine3) -> Self {
        let &Intrinsics { width, height, fx, fy, cx, cy, .. } = intrinsics;
        let [x, y, z, c] = cam_from_world.to_cols_array_2d();
        let row = |i: usize| [x[i], y[i], z[i], c[i]];
        Self { size: [width, height], lens: [fx, fy, cx, cy], cam_from_world: [row(0), row(1), row(2)] }
    }
}

/// A photograph and its camera.
#[derive(Serialize)]
struct Photograph {
    file: PathBuf,
    camera: Pinhole,
    /// Whether it is held out.
    test: bool,
}

#[derive(Serialize)]
struct Photographs {
    photographs: Vec<Photograph>,
    /// Position, scene units, and colour, 0 to 255.
    points: Vec<([f32; 3], [u8; 3])>,
    /// 1.1 times the radius of the cameras, scene units.
    extent: f64,
}

/// Writes into the folder that the first word names: for each synthetic scene `NAME.ply` and `NAME.json` with its camera, for each capture
/// `NAME.json` with its cameras, points and split.
///
/// # Errors
/// If there is no folder, a word is neither a synthetic scene nor a capture, or a camera of a capture is no pinhole.
pub fn run(words: &[String]) -> Result<(), Box<dyn Error>> {
    let [folder, names @ ..] = words else { return Err("`export` needs a folder and scenes or captures".into()) };
    let folder = Path::new(folder);
    fs::create_dir_all(folder)?;
    for name in names {
        let (name, text) = match name.parse::<JobSize>().ok().filter(|size| size.view().is_some()) {
            Some(size) => {
                let job = Job::new(size)?;
                ply::write(&folder.join(format!("{name}.ply")), &job.rows, DVec3::ZERO)?;
                (name.as_str(), serde_json::to_string(&Pinhole::new(&job.intrinsics, &DAffine3::IDENTITY))?)
            }
            None => {
                let folder = Path::new(name);
                let last = folder.file_name().and_then(|name| name.to_str()).ok_or("a capture has a name")?;
                (last, serde_json::to_string(&photographs(folder)?)?)
            }
        };
        fs::write(folder.join(format!("{name}.json")), text)?;
    }
    Ok(())
}

fn photographs(folder: &Path) -> Result<Photographs, Box<dyn Error>> {
    let capture = Capture::load(folder)?;
    let split = capture.split.clone().unwrap_or_else(|| Split::every(&capture.views, Split::USUAL));
    let photograph = |(i, view): (usize, &View)| {
        if view.intrinsics.model != CameraModel::Pinhole {
            return Err(format!("{}: its camera is no pinhole, which gsplat takes", view.name));
        }
        let file = fs::canonicalize(&view.image_path).map_err(|error| format!("{}: {error}", view.name))?;
        let camera = Pinhole::new(&view.intrinsics, &view.cam_from_world);
        Ok(Photograph { file, camera, test: split.test.contains(&i) })
    };
    let points = capture.points.positions.iter().copied().zip(capture.points.colours.iter().copied()).collect();
    let photographs = capture.views.iter().enumerate().map(photograph).collect::<Result<_, _>>()?;
    Ok(Photographs { photographs, points, extent: extent(&capture) })
}
