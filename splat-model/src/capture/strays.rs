//! Photographs whose poses cannot be right. They are left out: one of seventeen costs a scene up to 20 dB.

use super::origin::centre_world;
use super::spread::Spread;
use super::{Capture, Split};
use crate::quantile::quantile;
use glam::DVec3;

/// Distance of a photograph from the middle of the cameras from which on it is left out, relative to the size of the scene: that of the
/// cameras or of half of the points, whichever is larger. From there the scene is a few degrees wide.
const AWAY: f64 = 20.0;

/// The same without points, where cameras that hardly move do not tell the size of the scene.
const AWAY_WITHOUT_POINTS: f64 = 100.0;

/// Median distance between the observed and the projected points of a photograph, relative to its longer side, from which on it is left out.
/// Pose refinement mends less.
const MISS: f64 = 0.25;

/// Least number of observations by which that is told.
const FEWEST: usize = 8;

/// One in so many photographs may be left out. Where more are wrong, the capture is.
const ONE_IN: usize = 4;

/// Number of photographs that the remark names.
const NAMED: usize = 5;

/// The capture without photographs that lie far from all others, or show their points elsewhere than where they observed them, and with
/// a remark that names them.
pub(crate) fn leave_out(mut capture: Capture) -> Capture {
    let far = far(&capture);
    let misses = misses(&capture);
    let reasons: Vec<Option<String>> = far
        .into_iter()
        .zip(misses)
        .map(|(far, miss)| match (far, miss) {
            (Some(times), _) => Some(format!("{times:.0} times the size of the scene away from the others")),
            (_, Some(miss)) if miss.is_infinite() => Some("its points are outside of its picture".into()),
            (_, Some(miss)) => {
                Some(format!("its points are {:.0}% of its longer side beside their places", 100.0 * miss))
            }
            _ => None,
        })
        .collect();
    let (all, count) = (capture.views.len(), reasons.iter().flatten().count());
    if count == 0 || ONE_IN * count > all {
        return capture;
    }
    let of_view =
        |(view, reason): (usize, &Option<String>)| Some(format!("{} ({})", capture.views[view].name, reason.as_ref()?));
    let mut named: Vec<String> = reasons.iter().enumerate().filter_map(of_view).take(NAMED).collect();
    if count > NAMED {
        named.push(format!("and {} more", count - NAMED));
    }
    capture.remarks.push(format!(
        "{count} of {all} photographs are left out, because their poses cannot be right: {}. Align them again, or remove them",
        named.join(", ")
    ));
    let mut places = 0..;
    let place = |reason: &Option<String>| if reason.is_none() { places.next() } else { None };
    let place: Vec<Option<usize>> = reasons.iter().map(place).collect();
    capture.of_views(&place)
}

/// For each view that lies too far away its distance from the middle of the cameras, in sizes of the scene.
fn far(capture: &Capture) -> Vec<Option<f64>> {
    let centres: Vec<DVec3> = capture.views.iter().map(|view| centre_world(&view.cam_from_world)).collect();
    let Some(Spread { middle, radius, .. }) = Spread::of(&centres) else { return vec![None; centres.len()] };
    let points = 0..capture.points.positions.len();
    let mut distances: Vec<f64> = points.map(|point| capture.position(point).distance(middle)).collect();
    let of_points = quantile(&mut distances, 0.5);
    let size = radius.max(of_points.unwrap_or_default());
    let most = if of_points.is_some() { AWAY } else { AWAY_WITHOUT_POINTS };
    let times = |centre: &DVec3| centre.distance(middle) / size;
    centres.iter().map(times).map(|times| (times > most && times.is_finite()).then_some(times)).collect()
}

/// For each view with enough observations the median of their misses, if it is too large.
fn misses(capture: &Capture) -> Vec<Option<f64>> {
    let lists = capture.misses(0..capture.views.len(), |view, _, _, miss_px| {
        Some(miss_px / view.intrinsics.width.max(view.intrinsics.height) as f64)
    });
    let miss = |mut list: Vec<f64>| quantile(&mut list, 0.5).filter(|miss| list.len() >= FEWEST && *miss > MISS);
    lists.into_iter().map(miss).collect()
}

impl Capture {
    /// The views that have a place, which is ascending, with what belongs to them.
    fn of_views(self, place: &[Option<usize>]) -> Self {
        let placed = |list: Vec<usize>| list.into_iter().filter_map(|view| place[view]).collect();
        let split = self.split.map(|Split { train, test }| Split { train: placed(train), test: placed(test) });
        let tracks = self.tracks.picked(0..self.points.positions.len(), place);
        Self { views: picked(self.views, place), masks: picked(self.masks, place), tracks, split, ..self }
    }
}

/// Of a list with an entry for each view, or an empty one, the entries of the views that have a place.
pub(super) fn picked<T>(all: Vec<T>, place: &[Option<usize>]) -> Vec<T> {
    all.into_iter().zip(place).filter_map(|(one, place)| place.map(|_| one)).collect()
}

#[cfg(test)]
mod tests;
