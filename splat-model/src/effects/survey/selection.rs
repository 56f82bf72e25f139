//! The photographs that a survey decodes where all have too many pixels.
//!
//! Evenly spaced photographs of a large capture hardly show the same points, and colours are compared at points that several
//! photographs show. So photographs are taken in groups: evenly spaced ones, each with those that share most points with it.

use super::observations::project;
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
    let shown = shown(capture, views);
    let mut chosen = vec![false; views.len()];
    for group in 0..groups {
        // The middle of the group's part of the capture.
        let middle = (2 * group + 1) * views.len() / (2 * groups);
        let size = ((group + 1) * count / groups - group * count / groups).max(1);
        let mut others: Vec<usize> = (0..views.len()).filter(|&view| !chosen[view]).collect();
        let shared = |view: usize| shared(&shown[middle], &shown[view]);
        // The middle comes first among equals, and then its neighbours.
        others.sort_by_cached_key(|&view| (std::cmp::Reverse(shared(view)), view.abs_diff(middle)));
        others.into_iter().take(size).for_each(|view| chosen[view] = true);
    }
    views.iter().zip(chosen).filter_map(|(&view, chosen)| chosen.then_some(view)).collect()
}

/// The points that each of the views shows, ascending.
fn shown(capture: &Capture, views: &[usize]) -> Vec<Vec<usize>> {
    let count = capture.points.positions.len();
    let tracked = capture.tracks.observations() > 0;
    let every = count.div_ceil(if tracked { TRACKED } else { PROJECTED }).max(1);
    let points = (0..count).step_by(every);
    if tracked {
        let mut shown = vec![Vec::new(); views.len()];
        for point in points {
            for observation in capture.tracks.of(point) {
                if let Ok(view) = views.binary_search(&observation.view) {
                    shown[view].push(point);
                }
            }
        }
        return shown;
    }
    let of_view = |&view: &usize| {
        let view = &capture.views[view];
        let projector = view.intrinsics.projector();
        points.clone().filter(|&point| project(view, &projector, capture.position(point)).is_some()).collect()
    };
    views.iter().map(of_view).collect()
}

/// Number of points that are in both lists, which are ascending.
fn shared(a: &[usize], b: &[usize]) -> usize {
    let mut rest = b;
    let in_both = |point: &&usize| {
        rest = &rest[rest.partition_point(|other| other < point)..];
        rest.first() == Some(point)
    };
    a.iter().filter(in_both).count()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use glam::{DAffine3, DVec3};
    use splat_op::Intrinsics;

    use super::*;
    use crate::capture::{Observation, PointCloud, Tracks, View};

    /// Number of photographs along the street.
    const VIEWS: usize = 200;

    /// Number of photographs that show a point.
    const SHOWN_BY: usize = 16;

    /// A street: cameras a unit apart look sideways at a wall, and each point of it shows in 16 photographs in a row.
    fn street(tracked: bool) -> Capture {
        let intrinsics = Intrinsics::centred(160, 100, 100.0);
        let view = |i: usize| View {
            name: format!("{i:03}"),
            image_path: PathBuf::new(),
            intrinsics,
            cam_from_world: DAffine3::from_translation(DVec3::new(-(i as f64), 0.0, 10.0)),
        };
        let points: Vec<[f32; 3]> = (0..10 * VIEWS).map(|i| [i as f32 / 10.0, 0.0, 0.0]).collect();
        let mut tracks = Tracks::default();
        for point in points.iter().filter(|_| tracked) {
            let first = (point[0] as usize).saturating_sub(SHOWN_BY / 2);
            let seen = (first..(first + SHOWN_BY).min(VIEWS)).map(|view| Some(Observation { view, at_px: [0.0; 2] }));
            tracks.push(seen, 0.1);
        }
        Capture {
            scale: None,
            folder: PathBuf::new(),
            views: (0..VIEWS).map(view).collect(),
            points: PointCloud { colours: vec![[0; 3]; points.len()], positions: points },
            tracks,
            origin: DVec3::ZERO,
            split: None,
            masks: Vec::new(),
            focus: None,
            files: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// The largest number of these photographs that show one point, for every tenth of the street.
    fn by_tenth(chosen: &[usize]) -> Vec<usize> {
        let around = |at: usize| chosen.iter().filter(|view| view.abs_diff(at) < SHOWN_BY / 2).count();
        (0..10).map(|tenth| (20 * tenth..20 * (tenth + 1)).map(around).max().unwrap_or(0)).collect()
    }

    #[test]
    fn photographs_of_a_large_capture_show_the_same_points() {
        let all: Vec<usize> = (0..VIEWS).collect();
        for tracked in [true, false] {
            let capture = street(tracked);
            let chosen = select(&capture, &all, 50 * 160 * 100);
            assert_eq!(chosen.len(), 50, "{tracked}");
            assert!(chosen.is_sorted());
            let groups = by_tenth(&chosen);
            assert!(groups.iter().filter(|count| **count >= 9).count() >= 4, "{tracked}: {groups:?}");
            assert!(groups.iter().take(5).any(|count| *count >= 9) && groups.iter().skip(5).any(|count| *count >= 9));
            // Evenly spaced photographs are too few for any point.
            assert!(by_tenth(&all.iter().copied().step_by(4).collect::<Vec<_>>()).iter().all(|count| *count < 9));
        }
    }

    #[test]
    fn a_selection_is_of_the_views_it_may_take_and_never_empty() {
        let capture = street(true);
        let odd: Vec<usize> = (0..VIEWS).filter(|view| view % 2 == 1).collect();
        assert_eq!(select(&capture, &odd, usize::MAX), odd);
        let some = select(&capture, &odd, 30 * 160 * 100);
        assert!(some.len() == 30 && some.iter().all(|view| view % 2 == 1), "{some:?}");
        assert_eq!(select(&capture, &odd, 1).len(), 1);
        assert!(select(&capture, &[], 0).is_empty());
        let unseen = Capture { points: PointCloud::default(), tracks: Tracks::default(), ..capture };
        assert_eq!(select(&unseen, &odd, 30 * 160 * 100).len(), 30);
    }
}
