//! What the subcommands read: captures, photographs and scenes.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use burn::tensor::Device;
use splat_model::capture::image::load_all;
use splat_model::capture::{Capture, Photo};
use splat_model::effects::masks;
use splat_model::gaussians::{GaussianRows, Gaussians};
use splat_model::optim::scene_extent;
use splat_model::ply;
use splat_op::Splats;

use crate::progress;

/// Reads the cameras of a capture; no picture is opened.
///
/// # Errors
/// If the folder is missing or is no capture.
pub fn capture(folder: &Path) -> Result<Capture> {
    ensure!(
        folder.is_dir(),
        "there is no capture folder {}: name the folder that holds `images/` and `sparse/0/`, or `transforms.json`",
        folder.display()
    );
    Ok(Capture::load(folder)?)
}

/// The extent of the scene that a capture's cameras see, scene units.
pub fn extent(capture: &Capture) -> f64 {
    let centres: Vec<_> = capture.views.iter().map(|view| view.cam_from_world.inverse().translation).collect();
    scene_extent(&centres)
}

/// Decodes the photographs of some of a capture's views, on all threads; with `masked`, with their masks, and without those
/// of which nothing is left.
///
/// # Errors
/// If a picture is missing, cannot be decoded, or has another size than its camera; with `masked`, also if a mask is so, or if
/// masks leave no photograph.
pub fn photographs(capture: &Capture, views: &[usize], max_side: Option<u32>, masked: bool) -> Result<Vec<Photo>> {
    let counter = progress::counter("reading photographs", views.len());
    let photos = load_all(views.iter().map(|&view| &capture.views[view]), max_side, |_| counter.inc(1));
    counter.finish_and_clear();
    let mut photos = photos?;
    if masked {
        masks::attach(capture, views, &mut photos)
            .context("a mask cannot be used (`splat train --effects=-masks` does without)")?;
        let dropped = views.len() - photos.len();
        ensure!(
            dropped == 0 || !photos.is_empty(),
            "the masks of {} exclude every pixel of {dropped} photographs, and no other is left: `--effects=-masks` does \
             without masks, and `--eval-every` chooses what is tested on",
            capture.folder.display()
        );
        if dropped > 0 {
            progress::note(&format!("photographs left out, because their masks exclude every pixel: {dropped}"));
        }
    }
    Ok(photos)
}

/// A scene that was read.
pub struct Scene {
    /// Without autodiff; Gaussians that cannot be rendered are masked.
    pub splats: Splats,
    /// How many those are.
    pub unusable: usize,
}

impl Scene {
    /// From its rows.
    ///
    /// # Errors
    /// If they do not fit together.
    pub fn new(rows: &GaussianRows, device: &Device) -> Result<Self> {
        Ok(Self { splats: Gaussians::from_rows_apart(rows, device)?.splats(), unusable: rows.unusable() })
    }
}

/// Reads a scene, without autodiff, with positions relative to the origin of `capture`. Says so if Gaussians of it cannot be
/// rendered.
///
/// # Errors
/// If the file is missing or holds no scene, or the scene no Gaussian.
pub fn scene(path: &Path, capture: &Capture, device: &Device) -> Result<Scene> {
    Scene::new(&rows(path, capture)?, device)
}

/// The rows of a scene, as [`scene`] has them.
///
/// # Errors
/// Those of [`scene`].
pub fn rows(path: &Path, capture: &Capture) -> Result<GaussianRows> {
    let (mut rows, origin) = ply::read(path).context("cannot read the scene that `--scene` names")?;
    ensure!(!rows.is_empty(), "{} holds no Gaussian: name a scene that was trained with `--scene`", path.display());
    move_means(&mut rows, (origin - capture.origin).to_array());
    progress::note_unusable(path, rows.unusable(), rows.len());
    Ok(rows)
}

/// Adds `capture_from_scene` to every position, in f64.
///
/// The positions move and not the cameras. A capture keeps its cameras near zero, so that positions which end up near
/// them have digits to spare. Cameras moved to a scene that was stored far from zero would lose theirs, and the
/// difference of two large numbers would have to be taken in every render.
fn move_means(rows: &mut GaussianRows, capture_from_scene: [f64; 3]) {
    // The usual case: a scene keeps its values to the last bit.
    if capture_from_scene == [0.0; 3] {
        return;
    }
    for mean in &mut rows.means {
        for (coordinate, offset) in mean.iter_mut().zip(capture_from_scene) {
            *coordinate = (f64::from(*coordinate) + offset) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_stored_far_away_arrives_near_zero() {
        let far = [4_000_000.5, -250_000.25, 12.0];
        let mut rows = GaussianRows { means: vec![far], ..GaussianRows::default() };
        move_means(&mut rows, [-4_000_000.0, 250_000.0, 0.0]);
        assert_eq!(rows.means, [[0.5, -0.25, 12.0]]);
    }

    #[test]
    fn without_a_difference_nothing_changes() {
        let means = vec![[0.1, f32::NAN, -0.0]];
        let mut rows = GaussianRows { means: means.clone(), ..GaussianRows::default() };
        move_means(&mut rows, [0.0; 3]);
        assert_eq!(rows.means[0].map(f32::to_bits), means[0].map(f32::to_bits));
    }
}
