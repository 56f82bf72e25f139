//! Depth maps without errors.

use glam::DVec2;
use image::{ImageBuffer, Luma};
use rayon::prelude::*;

use super::DemoOptions;
use super::light::LitScene;
use super::shot::Shot;

/// Depth along the camera's axis at the middle of each pixel and of its exposure, in levels of [`DemoOptions::DEPTH_SCALE`];
/// zero where the photograph is transparent or the depth exceeds 16 bits.
pub(super) fn render(scene: &LitScene, shot: &Shot) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    let (width, height) = (shot.camera.intrinsics.width, shot.camera.intrinsics.height);
    let mut levels = vec![0; width * height];
    levels.par_chunks_exact_mut(width).enumerate().for_each(|(y, row)| {
        for (x, level) in row.iter_mut().enumerate() {
            let depth = depth(scene, shot, DVec2::new(x as f64, y as f64) + 0.5).unwrap_or(0.0);
            let steps = (depth / DemoOptions::DEPTH_SCALE).round();
            *level = if steps > 0.0 && steps <= f64::from(u16::MAX) { steps as u16 } else { 0 };
        }
    });
    ImageBuffer::from_raw(width as u32, height as u32, levels).expect("a level for each pixel")
}

/// Depth along the axis, scene units; none where the ray meets nothing.
fn depth(scene: &LitScene, shot: &Shot, at_px: DVec2) -> Option<f64> {
    let point = scene.scene.hit(&shot.ray(at_px, 0.0))?;
    let hidden = shot.transparent && scene.scene.is_surroundings(&point);
    let camera = shot.camera_at(at_px.y, 0.0);
    (!hidden).then(|| camera.cam_from_world.transform_point3(point.position_world).z)
}
