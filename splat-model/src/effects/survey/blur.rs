//! Sharpness of the photographs.

use serde::Serialize;

use super::detail::Detail;
use super::pictures::Glance;
use super::{Capture, PointObservations, quantile};

/// Sharpness of the photographs: the energy of differences between neighbouring pixels divided by that between pixels three
/// apart, in the least sharp of four directions, because camera motion blurs along its direction only. It is one ninth for
/// a smooth picture and 1 for noise, for any contrast. The value of a sharp picture depends on its content, so sharpness is
/// compared within a capture, and around the same points.
#[derive(Clone, Debug, Serialize)]
pub struct BlurEvidence {
    /// Median over the photographs.
    pub median: Option<f64>,
    /// Quantile that a twentieth of the photographs are below.
    pub least: Option<f64>,
    /// Name of the least sharp photograph.
    pub least_sharp: Option<String>,
    /// Sharpness around the points of a photograph, relative to that around the same points in photographs from a like distance: quantile
    /// that a twentieth of the photographs are below. `None` if no photographs share enough points.
    pub least_of_same: Option<f64>,
}

pub(super) fn evidence(capture: &Capture, glances: &[Glance], observations: &PointObservations) -> BlurEvidence {
    let known = glances.iter().filter_map(|glance| Some((glance.view, glance.sharpness?)));
    let least_sharp = known.clone().min_by(|a, b| a.1.total_cmp(&b.1));
    let mut values: Vec<f64> = known.map(|(_, sharpness)| sharpness).collect();
    BlurEvidence {
        median: quantile(&mut values, 0.5),
        least: quantile(&mut values, 0.05),
        least_sharp: least_sharp.map(|(view, _)| capture.views[view].name.clone()),
        least_of_same: quantile(&mut relative(observations, capture.views.len()), 0.05),
    }
}

/// Largest ratio of the sizes of a point in two photographs that are compared. A point looks smoother from nearby.
const LIKE_SIZE: f64 = 1.25;

/// Smallest number of points by which a photograph is compared.
const FEWEST_POINTS: usize = 20;

/// The sharpness of each photograph around its points relative to that of others around the same points, where enough are shared.
fn relative(observations: &PointObservations, views: usize) -> Vec<f64> {
    let mut sums = vec![(0, Detail::default(), Detail::default()); views];
    for seen in &observations.points {
        let known = || seen.iter().filter_map(|one| Some((one, one.sample?.detail?)));
        for (one, own) in known() {
            let is_like = |footprint: f64| footprint.max(one.footprint) <= LIKE_SIZE * footprint.min(one.footprint);
            let (mut count, mut others) = (0, Detail::default());
            for (_, detail) in known().filter(|(other, _)| other.view != one.view && is_like(other.footprint)) {
                count += 1;
                others.add(&detail, 1.0);
            }
            if count > 0 {
                let (points, of_view, of_others) = &mut sums[one.view];
                *points += 1;
                of_view.add(&own, 1.0);
                of_others.add(&others, 1.0 / f64::from(count));
            }
        }
    }
    let enough = sums.into_iter().filter(|(points, ..)| *points >= FEWEST_POINTS);
    enough.filter_map(|(_, own, others)| Some(own.sharpness()? / others.sharpness()?)).collect()
}
