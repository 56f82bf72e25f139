//! Reprojection errors of the poses.

use serde::Serialize;

use super::{Capture, quantile};

/// Largest error that counts in the mean, in medians: wrong tracks and strays say nothing about the other poses.
const FEW_MEDIANS: f64 = 10.0;

/// Source of the reprojection errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PoseSource {
    /// Measured: projected points of the tracks against keypoints.
    Tracks,
    /// Taken from the points' ERROR field, in pixels of the reconstruction's picture size.
    Stated,
}

/// Distances between observed and projected positions of points, px.
#[derive(Clone, Debug, Serialize)]
pub struct PoseEvidence {
    /// Source of the errors.
    pub source: PoseSource,
    /// Mean error; errors beyond ten times the median count as that.
    pub mean_px: f64,
    /// Quantile that a twentieth of the errors exceed.
    pub largest_px: f64,
}

pub(super) fn evidence(capture: &Capture) -> Option<PoseEvidence> {
    let count = capture.points.positions.len();
    let all = 0..capture.views.len();
    let mut errors = capture.misses(all, |_, _, _, miss_px| Some(miss_px).filter(|px| px.is_finite())).concat();
    let mut source = PoseSource::Tracks;
    if errors.is_empty() {
        source = PoseSource::Stated;
        errors = (0..count).filter_map(|point| capture.tracks.stated_error_px(point).map(f64::from)).collect();
    }
    let most_px = FEW_MEDIANS * quantile(&mut errors, 0.5)?;
    let mean_px = errors.iter().map(|error| error.min(most_px)).sum::<f64>() / errors.len() as f64;
    Some(PoseEvidence { source, mean_px, largest_px: quantile(&mut errors, 0.95)? })
}
