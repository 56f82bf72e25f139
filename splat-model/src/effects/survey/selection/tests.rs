use std::path::PathBuf;

use glam::{DAffine3, DVec3};
use splat_op::Intrinsics;

use super::*;
use crate::capture::{Cut, Observation, PointCloud, Tracks, View};

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
        cut: Cut::Whole,
    };
    let points: Vec<[f32; 3]> = (0..10 * VIEWS).map(|i| [i as f32 / 10.0, 0.0, 0.0]).collect();
    let mut tracks = Tracks::default();
    for point in points.iter().filter(|_| tracked) {
        let first = (point[0] as usize).saturating_sub(SHOWN_BY / 2);
        let seen = (first..(first + SHOWN_BY).min(VIEWS)).map(|view| Observation { view, at_px: [0.0; 2] });
        tracks.push(seen, 0.1);
    }
    Capture {
        format: "COLMAP",
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
