//! The town of `splat demo --town`: streets on a grid with houses and trees, 400 m across, for captures that are trained in
//! blocks. World frame: metres, z up, the ground at z = 0, the crossing of the middle streets at zero.
//!
//! Its photographs are plain: sharp, opaque, at one exposure, with the exact model. Most are taken from the streets, where houses
//! hide all but the nearest; a fifth is taken from above the roofs. The ray tracer looks for things in a grid of squares, so that a
//! ray costs about the same in a town of any size.

mod grid;
mod layout;
mod light;
mod paint;
mod photographs;
mod solid;
#[cfg(test)]
mod tests;

use std::io;
use std::path::Path;

use rayon::prelude::*;

use self::light::LitTown;
use super::{Cut, DemoError, DemoOptions, IMAGES, View, create, name, write_model};

/// Half of the town's side, m.
const HALF: f64 = 200.0;

/// Distance between the middles of neighbouring streets, m.
const BETWEEN_STREETS: f64 = 100.0;

/// Half of a street's width, its pavements included, m.
const HALF_STREET: f64 = 8.0;

/// Writes the town's capture; see [`super::write`].
pub(super) fn write(folder: &Path, options: &DemoOptions) -> Result<(), DemoError> {
    let town = LitTown::new(layout::things(options));
    let cameras = photographs::cameras(options);
    let images = folder.join(IMAGES);
    create(&images)?;
    let views: Vec<View> = (cameras.iter().enumerate())
        .map(|(i, camera)| View {
            name: name(i),
            image_path: images.join(name(i)),
            intrinsics: camera.intrinsics,
            cam_from_world: camera.cam_from_world,
            cut: Cut::Whole,
        })
        .collect();
    cameras.par_iter().zip(&views).try_for_each(|(camera, view)| {
        let saved = photographs::render(&town, camera).save(&view.image_path);
        saved.map_err(|error| DemoError::Io { path: view.image_path.clone(), source: io::Error::other(error) })
    })?;
    let (points, tracks) = photographs::sample(&town, &cameras, options);
    write_model(folder, &views, &points, &tracks)
}
