//! Depths of the scene.

use glam::DVec3;
use serde::Serialize;

use super::{Capture, PointObservations, quantile};
use crate::capture::spread::Spread;
use crate::optim::scene_extent;

/// Depths of the points in the photographs that show them, scene units.
#[derive(Clone, Debug, Serialize)]
pub struct DepthEvidence {
    /// Quantile of 1%.
    pub nearest: f64,
    /// Median.
    pub median: f64,
    /// Quantile of 99%.
    pub furthest: f64,
    /// Share of the points further from the middle of the cameras than [`DepthEvidence::FAR_EXTENTS`] times their extent.
    pub far_share: f64,
}

impl DepthEvidence {
    /// Distance beyond which no two cameras see a point in very different directions, in extents of the cameras.
    pub const FAR_EXTENTS: f64 = 10.0;
}

pub(super) fn evidence(capture: &Capture, observations: &PointObservations) -> Option<DepthEvidence> {
    let mut depths: Vec<f64> = observations.points.iter().flatten().map(|observation| observation.depth).collect();
    let centres: Vec<DVec3> = capture.views.iter().map(|view| view.cam_from_world.inverse().translation).collect();
    let middle = Spread::of(&centres)?.middle;
    let far = DepthEvidence::FAR_EXTENTS * scene_extent(&centres);
    let is_far = |&&point: &&usize| capture.position(point).distance(middle) > far;
    Some(DepthEvidence {
        nearest: quantile(&mut depths, 0.01)?,
        median: quantile(&mut depths, 0.5)?,
        furthest: quantile(&mut depths, 0.99)?,
        far_share: observations.indices.iter().filter(is_far).count() as f64 / observations.indices.len().max(1) as f64,
    })
}
