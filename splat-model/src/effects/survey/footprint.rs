//! Sizes of the same point in different photographs.

use serde::Serialize;

use super::{PointObservations, quantile};

/// Ratios of footprints. A footprint is the number of pixels per scene unit at a point: focal length divided by depth.
/// Renders at the photographs' size have the same footprints, so this is the range of sizes in training and viewing.
#[derive(Clone, Debug, Serialize)]
pub struct FootprintEvidence {
    /// Ratio of the largest to the smallest footprint of a point, median over the points.
    pub median_ratio: f64,
    /// The same ratio, exceeded by a twentieth of the points.
    pub largest_ratio: f64,
}

pub(super) fn evidence(observations: &PointObservations) -> Option<FootprintEvidence> {
    let ratio = |seen: &Vec<super::observations::PointObservation>| {
        let footprints = seen.iter().map(|observation| observation.footprint);
        let largest = footprints.clone().fold(0.0, f64::max);
        largest / footprints.fold(f64::INFINITY, f64::min)
    };
    let mut ratios: Vec<f64> = observations.points.iter().map(ratio).collect();
    Some(FootprintEvidence { median_ratio: quantile(&mut ratios, 0.5)?, largest_ratio: quantile(&mut ratios, 0.95)? })
}
