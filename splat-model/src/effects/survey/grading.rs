//! Whether photographs were processed locally, as phones do, from the same points in several of them.
//!
//! A photograph's colour of a point is modelled as an affine map of the point's own colour, channel by channel. The first model has one map
//! for the whole photograph, as an [exposure](crate::effects::exposure) has. In the second model gain and offset change linearly across the
//! photograph, the simplest case that only a [grid](crate::effects::grid) can represent. Both are fitted by least squares with robust
//! weights, alternating with the points' colours, and their residuals are compared. View-dependent colour (gloss) does not change linearly
//! across a picture, so the second model does not explain it better.

use rayon::prelude::*;
use serde::Serialize;

use super::exposure::USABLE;
use super::{Capture, PointObservations, ViewDependenceEvidence, quantile};
use crate::solve::solve;

/// Iterations between maps and colours, which converge within a few.
const ROUNDS: usize = 8;

/// Smallest number of points of a photograph for the fit of six numbers.
const FEWEST_POINTS: usize = 40;

/// Smallest number of photographs of a point. With fewer, a point explains itself.
const FEWEST_OBSERVATIONS: usize = 3;

/// Residuals between the photographs' colours and the mapped colours of the points: the median of their absolute values
/// over all channels, in display-referred values of 0 to 1.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct GradingEvidence {
    /// Residual of one map for each photograph.
    pub left_by_maps: f64,
    /// Residual of maps that change linearly across each photograph.
    pub left_by_places: f64,
}

/// The observation of a point in a photograph, in one channel.
struct ChannelObservation {
    point: usize,
    /// Position, −1 to 1 from border to border.
    place: [f64; 2],
    value: f64,
}

pub(super) fn evidence(capture: &Capture, observations: &PointObservations) -> Option<GradingEvidence> {
    let points = observations.points.len();
    let of_channel = |channel: usize| {
        let views = seen(capture, observations, channel);
        let maps = left(&views, points, |colour, _| [1.0, colour]);
        let places = left(&views, points, |colour, [x, y]| [1.0, colour, x, y, colour * x, colour * y]);
        [maps, places]
    };
    let mut left = [Vec::new(), Vec::new()];
    for channel in 0..3 {
        left.iter_mut().zip(of_channel(channel)).for_each(|(all, of_channel)| all.extend(of_channel));
    }
    let [maps, places] = &mut left;
    Some(GradingEvidence { left_by_maps: quantile(maps, 0.5)?, left_by_places: quantile(places, 0.5)? })
}

/// Observations by photograph, without photographs that have too few points.
fn seen(capture: &Capture, observations: &PointObservations, channel: usize) -> Vec<Vec<ChannelObservation>> {
    let mut views: Vec<Vec<ChannelObservation>> = capture.views.iter().map(|_| Vec::new()).collect();
    for (point, all) in observations.points.iter().enumerate() {
        let usable = all.iter().filter_map(|observation| {
            let value = observation.sample.map(|sample| sample.mean[channel]).filter(|value| USABLE.contains(value))?;
            Some((observation, f64::from(value)))
        });
        if usable.clone().count() < FEWEST_OBSERVATIONS {
            continue;
        }
        for (observation, value) in usable {
            let camera = &capture.views[observation.view].intrinsics;
            let share = |at_px: f64, side: usize| 2.0 * at_px / side as f64 - 1.0;
            let place = [share(observation.at_px[0], camera.width), share(observation.at_px[1], camera.height)];
            views[observation.view].push(ChannelObservation { point, place, value });
        }
    }
    views.retain(|seen| seen.len() >= FEWEST_POINTS);
    views
}

/// Absolute residuals of maps that are linear in `terms` of a point's colour and its position. The second term is the colour itself.
fn left<const N: usize>(
    views: &[Vec<ChannelObservation>],
    points: usize,
    terms: impl Fn(f64, [f64; 2]) -> [f64; N] + Sync,
) -> Vec<f64> {
    let median = |values: Vec<Vec<f64>>| values.into_iter().map(|mut of_point| quantile(&mut of_point, 0.5));
    let by_point = |values: &[Vec<f64>]| {
        let mut of_point = vec![Vec::new(); points];
        for (seen, values) in views.iter().zip(values) {
            seen.iter().zip(values).for_each(|(seen, value)| of_point[seen.point].push(*value));
        }
        of_point
    };
    let shown: Vec<Vec<f64>> = views.iter().map(|seen| seen.iter().map(|seen| seen.value).collect()).collect();
    let mut colours: Vec<f64> = median(by_point(&shown)).map(Option::unwrap_or_default).collect();
    let mut identity = [0.0; N];
    identity[1] = 1.0;
    let mut maps = vec![identity; views.len()];
    let mut misses = Vec::new();
    for _ in 0..ROUNDS {
        let rest = |seen: &ChannelObservation, map: &[f64; N]| {
            let terms = terms(colours[seen.point], seen.place);
            let shown: f64 = terms.iter().zip(map).map(|(term, factor)| term * factor).sum();
            (terms, seen.value - shown)
        };
        maps.par_iter_mut().zip(views).for_each(|(map, seen)| {
            let (mut gram, mut moment) = ([[0.0; N]; N], [0.0; N]);
            for seen in seen {
                let (terms, miss) = rest(seen, map);
                let weight = 1.0 / miss.hypot(ViewDependenceEvidence::VISIBLE);
                for row in 0..N {
                    (0..N).for_each(|column| gram[row][column] += weight * terms[row] * terms[column]);
                    moment[row] += weight * terms[row] * seen.value;
                }
            }
            *map = solve(gram, moment).unwrap_or(*map);
        });
        let of_view =
            |(seen, map): (&Vec<ChannelObservation>, &[f64; N])| seen.iter().map(|seen| rest(seen, map).1).collect();
        misses = views.iter().zip(&maps).map(of_view).collect::<Vec<Vec<f64>>>();
        let moved = median(by_point(&misses)).map(Option::unwrap_or_default);
        colours.iter_mut().zip(moved).for_each(|(colour, moved)| *colour += moved);
    }
    misses.into_iter().flatten().map(f64::abs).collect()
}
