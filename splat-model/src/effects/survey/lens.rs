//! Lens distortion.

use glam::DVec2;
use serde::Serialize;
use splat_op::{CameraModel, Intrinsics};

use super::Capture;

/// Test positions on each border of a picture. A lens displaces points far from its axis most.
const BORDER_PLACES: usize = 8;

/// The lenses of a capture's cameras.
#[derive(Clone, Debug, Serialize)]
pub struct LensEvidence {
    /// Names of the camera models.
    pub models: Vec<String>,
    /// Number of different cameras: photographs of one camera have the same intrinsics.
    pub cameras: usize,
    /// Largest distance on the border of a picture between the image of a direction through the lens and through a pinhole,
    /// px. `None` if a picture shows directions that no pinhole can show, at a right angle from the axis or beyond.
    pub largest_displacement_px: Option<f64>,
}

pub(super) fn evidence(capture: &Capture) -> LensEvidence {
    let mut models: Vec<String> = Vec::new();
    let mut cameras: Vec<Intrinsics> = Vec::new();
    let mut largest_displacement_px = Some(0.0_f64);
    for view in &capture.views {
        let name = format!("{:?}", view.intrinsics.model).to_lowercase();
        if !models.contains(&name) {
            models.push(name);
        }
        if !cameras.contains(&view.intrinsics) {
            cameras.push(view.intrinsics);
        }
        largest_displacement_px = largest_displacement_px.zip(displacement_px(&view.intrinsics)).map(|(a, b)| a.max(b));
    }
    LensEvidence { models, cameras: cameras.len(), largest_displacement_px }
}

fn displacement_px(camera: &Intrinsics) -> Option<f64> {
    if camera.model == CameraModel::Pinhole {
        return Some(0.0);
    }
    let size = DVec2::new(camera.width as f64, camera.height as f64);
    let mut largest = 0.0_f64;
    for i in 0..=BORDER_PLACES {
        let along = i as f64 / BORDER_PLACES as f64;
        for share in [(along, 0.0), (along, 1.0), (0.0, along), (1.0, along)] {
            let px = size * DVec2::from(share);
            let direction = camera.cam_from_px(px);
            // Directions within a millionth of a radian of the right angle are not usable for a pinhole either.
            if !(direction.z > 1e-6 * direction.length()) {
                return None;
            }
            let slopes = direction.truncate() / direction.z;
            let straight = DVec2::new(camera.fx * slopes.x + camera.cx, camera.fy * slopes.y + camera.cy);
            largest = largest.max(straight.distance(px));
        }
    }
    Some(largest)
}

#[cfg(test)]
mod tests;
