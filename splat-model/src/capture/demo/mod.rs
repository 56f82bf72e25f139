//! A capture that the project makes itself: a ray-traced still life, photographed from three rings of cameras.
//!
//! Everything is known about it (geometry, light, cameras), nothing has to be downloaded, and the same options give the
//! same bytes. Surfaces are matte unless [`DemoOptions::glossy`] is set: their colour does not depend on the view, so
//! splats of degree 0 can explain them. World frame: z up, the round platform has radius 1.95 and its top at z = 0,
//! everything lies within a dome of radius 8.

mod camera;
mod geometry;
mod light;
mod picture;
mod points;
mod scene;
#[cfg(test)]
mod tests;
mod texture;
mod torus;

use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use thiserror::Error;

use self::camera::DemoCamera;
use self::light::LitScene;
#[cfg(test)]
pub(crate) use self::picture::gains;
use self::scene::Scene;
use super::{CaptureError, View, write_binary_with_tracks};

/// What the demo capture holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DemoOptions {
    /// Width of the pictures, 16 to 4096 px.
    pub width: usize,
    /// Height of the pictures, 16 to 4096 px.
    pub height: usize,
    /// How many pictures, 2 to 9999.
    pub views: usize,
    /// How many sparse points, at most 1,000,000.
    pub points: usize,
    /// One sphere reflects its surroundings and the sun, so that its colour depends on the view.
    pub glossy: bool,
    /// Each photograph has its own exposure and white balance: a gain per channel on its light, up to
    /// [`DemoOptions::EXPOSURE_STOPS`] either way.
    pub exposure: bool,
    /// Varies the cameras, the choice of points and the exposures.
    pub seed: u64,
}

impl DemoOptions {
    /// Stops of light by which gains differ from one at most.
    pub const EXPOSURE_STOPS: f64 = 0.75;
}

impl Default for DemoOptions {
    fn default() -> Self {
        Self { width: 240, height: 180, views: 48, points: 6000, glossy: false, exposure: false, seed: 0 }
    }
}

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
    /// The operating system refused.
    #[error("{path}: could not write: {source}; is the folder writable and the disk not full?", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A picture could not be stored.
    #[error("{path}: could not write the picture: {source}; is the folder writable and the disk not full?", path = path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: image::ImageError,
    },
    /// The COLMAP model could not be stored.
    #[error(transparent)]
    Model(#[from] CaptureError),
}

/// Writes the demo capture: `images/0000.png` and so on, and a COLMAP model in `sparse/0`. Creates the folder; files of
/// the same names are replaced.
///
/// # Errors
///
/// [`DemoError::Option`] for options outside their ranges, else if a file cannot be written.
pub fn write(folder: &Path, options: &DemoOptions) -> Result<(), DemoError> {
    check(options)?;
    let scene = LitScene::new(Scene::still_life(options.glossy));
    let cameras = camera::cameras(options);
    let pictures = folder.join("images");
    std::fs::create_dir_all(&pictures).map_err(|source| DemoError::Io { path: pictures.clone(), source })?;
    let views: Vec<View> = cameras.iter().enumerate().map(|(i, camera)| view(&pictures, i, camera)).collect();
    let gains = picture::gains(options);
    cameras.par_iter().zip(&views).zip(gains).try_for_each(|((camera, view), gain)| {
        let path = view.image_path.clone();
        picture::render(&scene, camera, gain).save(&path).map_err(|source| DemoError::Picture { path, source })
    })?;
    let (points, tracks) = points::sample(&scene, &cameras, options);
    Ok(write_binary_with_tracks(folder, &views, &points, &tracks)?)
}

fn view(pictures: &Path, i: usize, camera: &DemoCamera) -> View {
    let name = format!("{i:04}.png");
    let image_path = pictures.join(&name);
    View { name, image_path, intrinsics: camera.intrinsics, cam_from_world: camera.cam_from_world }
}

fn check(options: &DemoOptions) -> Result<(), DemoError> {
    let within = |field, found: usize, low: usize, high: usize, expected| match found >= low && found <= high {
        true => Ok(()),
        false => Err(DemoError::Option { field, found, expected }),
    };
    within("width", options.width, 16, 4096, "16 to 4096 px")?;
    within("height", options.height, 16, 4096, "16 to 4096 px")?;
    within("views", options.views, 2, 9999, "2 to 9999")?;
    within("points", options.points, 0, 1_000_000, "at most 1,000,000")
}
