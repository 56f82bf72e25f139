//! The demo capture: a ray-traced still life, photographed from three rings of cameras; or a [town](DemoOptions::town).
//!
//! Its geometry, light and cameras are known, nothing has to be downloaded, and equal options give the
//! same bytes. Its photographs show only the effects that [`DemoOptions`] asks for. Surfaces are matte, so that splats of
//! degree 0 can represent them. World frame of the still life: z up, the round platform has radius 1.95 and its top at z = 0, and everything lies
//! within a dome of radius 8.

mod camera;
mod depth;
mod geometry;
mod grade;
mod light;
mod model;
mod moving;
mod options;
mod picture;
mod points;
mod pose;
mod scene;
mod shot;
mod surfaces;
#[cfg(test)]
mod tests;
mod texture;
mod torus;
mod town;
mod truth;

use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use splat_model::capture::{Cut, View};
use thiserror::Error;

use self::light::LitScene;
pub use self::model::write_model;
pub use self::moving::moving;
pub use self::options::DemoOptions;
use self::scene::DemoScene;
pub use self::shot::gains;
pub use self::surfaces::{MeshError, SurfaceSample, Surfaces};

/// A demo capture that cannot be made.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DemoError {
    /// An option outside its range.
    #[error("demo option `{field}` is {found}, expected {expected}")]
    Option {
        /// The option.
        field: &'static str,
        /// Its value.
        found: usize,
        /// The range.
        expected: &'static str,
    },
    /// Two options that exclude each other.
    #[error("demo options `{first}` and `{second}` exclude each other: {reason}; leave one of them out")]
    Conflict {
        /// An option.
        first: &'static str,
        /// The other.
        second: &'static str,
        /// Why.
        reason: &'static str,
    },
    /// The operating system refused.
    #[error("{path}: could not write: {source}; is the folder writable and the disk not full?", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

/// Writes the demo capture into `folder`, which is created; files of the same names are replaced.
///
/// - `images/0000.png` and so on, and a COLMAP model in `sparse/0`.
/// - `masks/0001.png` and so on, with [`DemoOptions::masks`], for the photographs that are not held out: white counts.
/// - `depth/0000.png` and so on, with [`DemoOptions::depth`]: 16 bits grey, the depth of what the middle of each pixel shows,
///   along the axis of the camera (z of the camera's frame, not the distance), in levels of as many scene units as
///   `depth/depth.json` says, `{"scale": 0.001}`. Zero is unknown: transparent, or beyond 65.535 scene units.
/// - `truth.json`, where the model and the photographs do not tell how they came about ([`DemoOptions::poses`], `motion`,
///   `rolling`): under `photographs`, for each its `name`; the exact pose at the middle of exposure and readout,
///   world to camera, as `rotation_wxyz` and `translation`; how the camera moves in its own frame over the whole `exposure`,
///   and from the first row to the last (`readout`), each as `linear`, scene units, and `angular`, a rotation vector in
///   radians. The camera at the time `t`, −½ to ½, has
///   its centre at `centre + R (t linear)` and the axes `R exp([t angular]×)`, `R` being the axes at the middle, camera to world;
///   a row at `y` px is read at `t = y / height − ½`.
///
/// # Errors
///
/// [`DemoError::Option`] for options outside their ranges, [`DemoError::Conflict`] for options that exclude each other, or if a
/// file cannot be written.
pub fn write(folder: &Path, options: &DemoOptions) -> Result<(), DemoError> {
    options.check()?;
    if options.town {
        return town::write(folder, options);
    }
    let scene = LitScene::new(DemoScene::still_life(options));
    let shots = shot::shots(options);
    let poses = pose::written(&shots, options);
    let [images, masks, depths] = [IMAGES, MASKS, DEPTHS].map(|name| folder.join(name));
    create(&images)?;
    let view = |(i, (shot, cam_from_world)): (usize, (&shot::Shot, _))| {
        let name = name(i);
        let (image_path, intrinsics) = (images.join(&name), shot.camera.intrinsics);
        View { name, image_path, intrinsics, cam_from_world, cut: Cut::Whole }
    };
    let views: Vec<View> = shots.iter().zip(poses).enumerate().map(view).collect();
    if options.masks {
        create(&masks)?;
    }
    if options.depth {
        create(&depths)?;
        store(&depths.join(DEPTH_SCALE), &format!("{{\"scale\": {:?}}}\n", DemoOptions::DEPTH_SCALE))?;
    }
    shots.par_iter().zip(&views).enumerate().try_for_each(|(i, (shot, view))| {
        let saved = |path: &Path, saved: image::ImageResult<()>| {
            saved.map_err(|error| DemoError::Io { path: path.to_owned(), source: io::Error::other(error) })
        };
        saved(&view.image_path, picture::render(&scene, shot).save(&view.image_path))?;
        if options.masks && !DemoOptions::held_out(i) {
            let path = masks.join(&view.name);
            saved(&path, picture::mask(shot).save(&path))?;
        }
        if options.depth {
            let path = depths.join(&view.name);
            saved(&path, depth::render(&scene, shot).save(&path))?;
        }
        Ok::<_, DemoError>(())
    })?;
    if options.has_truth() {
        store(&folder.join(TRUTH), &truth::json(&views, &shots))?;
    }
    let (points, tracks) = points::sample(&scene, &shots, options);
    write_model(folder, &views, &points, &tracks)
}

const IMAGES: &str = "images";
const MASKS: &str = "masks";
const DEPTHS: &str = "depth";
const DEPTH_SCALE: &str = "depth.json";
const TRUTH: &str = "truth.json";

/// The files and folders, directly below the capture's own, that a demo capture of any options may hold; the model comes last.
pub const PARTS: [&str; 5] = [IMAGES, MASKS, DEPTHS, TRUTH, "sparse"];

/// The files beside the model that [`write()`] writes for `options`, relative to the capture's folder.
pub fn files(options: &DemoOptions) -> Vec<PathBuf> {
    let below = |folder: &'static str, spared: bool| {
        let views = (0..options.views).filter(move |&view| !(spared && DemoOptions::held_out(view)));
        views.map(move |view| Path::new(folder).join(name(view)))
    };
    let mut files: Vec<PathBuf> = below(IMAGES, false).collect();
    if options.masks {
        files.extend(below(MASKS, true));
    }
    if options.depth {
        files.extend(below(DEPTHS, false));
        files.push(Path::new(DEPTHS).join(DEPTH_SCALE));
    }
    files.extend(options.has_truth().then(|| TRUTH.into()));
    files
}

fn name(view: usize) -> String {
    format!("{view:04}.png")
}

fn create(folder: &Path) -> Result<(), DemoError> {
    std::fs::create_dir_all(folder).map_err(|source| DemoError::Io { path: folder.to_owned(), source })
}

fn store(path: &Path, text: &str) -> Result<(), DemoError> {
    std::fs::write(path, text).map_err(|source| DemoError::Io { path: path.to_owned(), source })
}
