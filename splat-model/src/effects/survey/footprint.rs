//! How large the same thing is in different photographs.

use serde::Serialize;

use super::quantile;
use super::sights::Sights;

/// Footprints are pixels per scene unit at a point: focal length by depth. Renders at the photographs' size see points as
/// the photographs do, so the range across these is the range that a scene is trained and looked at with.
#[derive(Clone, Debug, Serialize)]
pub struct FootprintEvidence {
    /// The largest by the smallest footprint of a point, the median over the points.
    pub median_ratio: f64,
    /// The same, exceeded by a twentieth of the points.
    pub largest_ratio: f64,
}

pub(super) fn evidence(sights: &Sights) -> Option<FootprintEvidence> {
    let ratio = |seen: &Vec<super::sights::Sight>| {
        let footprints = seen.iter().map(|sight| sight.footprint);
        let largest = footprints.clone().fold(0.0, f64::max);
        largest / footprints.fold(f64::INFINITY, f64::min)
    };
    let mut ratios: Vec<f64> = sights.points.iter().map(ratio).collect();
    Some(FootprintEvidence { median_ratio: quantile(&mut ratios, 0.5)?, largest_ratio: quantile(&mut ratios, 0.95)? })
}
