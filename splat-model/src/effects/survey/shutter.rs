//! Whether reprojection errors come from a rolling shutter.
//!
//! If the camera moves while rows are read one after the other, points in the upper half are displaced one way and points
//! in the lower half the other way, in proportion to the row. If the pose is wrong, all points are displaced together. Both
//! are twists of the camera, six numbers for each photograph, and linear in their effect on directions. Each model is
//! fitted to the tracks by least squares with robust weights, and their residuals are compared.

use glam::{DVec3, Vec2};
use rayon::prelude::*;
use serde::Serialize;

use super::{Capture, quantile};
use crate::effects::pose::anchors::{FEWEST, ROBUST_RAD, columns};
use crate::solve::solve;

/// Iterations of the robust weights.
const ROUNDS: usize = 10;

/// Residuals of the directions, as shares of the errors before the fit: medians over the photographs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ShutterEvidence {
    /// Residual after a correction of each pose.
    pub left_by_poses: f64,
    /// Residual after a rolling-shutter motion of each camera.
    pub left_by_rows: f64,
}

struct ShutterObservation {
    /// Derivative of the direction with respect to the camera's `ω` and `τ`.
    columns: [DVec3; 6],
    /// Observed direction minus projected direction.
    miss: DVec3,
    /// Row: −½ for the first, ½ for the last.
    row: f64,
}

pub(super) fn evidence(capture: &Capture) -> Option<ShutterEvidence> {
    let mut views = capture.by_view(0..capture.views.len(), |view, world, observation| {
        let found = view.intrinsics.cam_from_px(Vec2::from_array(observation.at_px).as_dvec2()).normalize_or_zero();
        let cam = view.cam_from_world.transform_point3(world);
        let row = f64::from(observation.at_px[1]) / view.intrinsics.height as f64 - 0.5;
        let seen = ShutterObservation { columns: columns(cam), miss: found - cam.normalize_or_zero(), row };
        (seen.miss.is_finite() && seen.columns.iter().all(|column| column.is_finite())).then_some(seen)
    });
    views.retain(|observations| observations.len() >= FEWEST);
    let shares = views.par_iter().filter_map(|observations| {
        let given: f64 = observations.iter().map(|observation| observation.miss.length()).sum();
        let [poses, rows] = [left(observations, |_| 1.0), left(observations, |observation| observation.row)];
        (given > 0.0).then(|| (poses / given, rows / given))
    });
    let (mut poses, mut rows): (Vec<f64>, Vec<f64>) = shares.unzip();
    Some(ShutterEvidence { left_by_poses: quantile(&mut poses, 0.5)?, left_by_rows: quantile(&mut rows, 0.5)? })
}

/// Sum of the residuals after the best-fitting twist, multiplied by `share` of each observation.
fn left(observations: &[ShutterObservation], share: impl Fn(&ShutterObservation) -> f64) -> f64 {
    let mut twist = [0.0; 6];
    let rest = |observation: &ShutterObservation, twist: &[f64; 6]| {
        let moved: DVec3 = observation.columns.iter().zip(twist).map(|(column, by)| *column * *by).sum();
        observation.miss - moved * share(observation)
    };
    for _ in 0..ROUNDS {
        let (mut gram, mut moment) = ([[0.0; 6]; 6], [0.0; 6]);
        for observation in observations {
            let weight =
                share(observation) / (rest(observation, &twist).length_squared() + ROBUST_RAD * ROBUST_RAD).sqrt();
            for row in 0..6 {
                for column in 0..6 {
                    gram[row][column] +=
                        weight * share(observation) * observation.columns[row].dot(observation.columns[column]);
                }
                moment[row] += weight * observation.columns[row].dot(observation.miss);
            }
        }
        let Some(found) = solve(gram, moment) else { break };
        twist = found;
    }
    observations.iter().map(|observation| rest(observation, &twist).length()).sum()
}

#[cfg(test)]
mod tests;
