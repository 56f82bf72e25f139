//! The photographs that a survey decodes where all have too many pixels.
//!
//! Evenly spaced photographs of a large capture hardly show the same points, and colours are compared at points that several
//! photographs show. So photographs are taken in groups: evenly spaced ones, each with those that share most points with it.

use crate::capture::Capture;

/// Number of photographs in a group, above the nine that the evidence on view-dependent colour requires.
const GROUP: usize = 12;

/// Largest number of points by which photographs are compared, with tracks and by projection, which takes longer.
const TRACKED: usize = 100_000;
const PROJECTED: usize = 2_000;

/// Selects photographs of `views`, indices in ascending order, that have at most `most_pixels` together, but at least one.
pub(super) fn select(capture: &Capture, views: &[usize], most_pixels: usize) -> Vec<usize> {
    let size = |&view: &usize| capture.views[view].intrinsics.width * capture.views[view].intrinsics.height;
    let pixels: usize = views.iter().map(size).sum();
    if pixels <= most_pixels {
        return views.to_vec();
    }
    let count = (views.len() as f64 * (most_pixels as f64 / pixels as f64)) as usize;
    let groups = (count / GROUP).max(1);
    let most = if capture.tracks.observations() > 0 { TRACKED } else { PROJECTED };
    let shown = capture.shown(views, capture.points.positions.len().div_ceil(most).max(1));
    let mut chosen = vec![false; views.len()];
    for group in 0..groups {
        // The middle of the group's part of the capture.
        let middle = (2 * group + 1) * views.len() / (2 * groups);
        let size = ((group + 1) * count / groups - group * count / groups).max(1);
        let mut others: Vec<usize> = (0..views.len()).filter(|&view| !chosen[view]).collect();
        // The lists are ascending.
        let is_shown = |view: usize, point: &u32| shown[view].binary_search(point).is_ok();
        let shared = |view: usize| shown[middle].iter().filter(|point| is_shown(view, point)).count();
        // The middle comes first among equals, and then its neighbours.
        others.sort_by_cached_key(|&view| (std::cmp::Reverse(shared(view)), view.abs_diff(middle)));
        others.into_iter().take(size).for_each(|view| chosen[view] = true);
    }
    views.iter().zip(chosen).filter_map(|(&view, chosen)| chosen.then_some(view)).collect()
}

#[cfg(test)]
mod tests;
