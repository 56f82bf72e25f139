use std::path::Path;

use super::*;
use crate::capture::Observation;

fn camera(angle_rad: f64) -> (Intrinsics, DAffine3) {
    (
        Intrinsics::centred(60, 40, 50.0),
        DAffine3::from_translation(5.0 * DVec3::Z) * DAffine3::from_rotation_y(angle_rad),
    )
}

#[test]
fn points_are_counted_in_each_photograph_and_in_none() {
    let points = [[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.3, 4.9], [0.0, 90.0, 0.0]];
    let away = (Intrinsics::centred(60, 40, 50.0), DAffine3::from_translation(-5.0 * DVec3::Z));
    let seen = PointsSeen::of(&[camera(0.0), camera(3.1), away], &points);
    assert_eq!(seen, PointsSeen { points: 4, unseen: 1, by_view: vec![3, 2, 0] });
    let said = seen.said(|view| ["a", "b", "c"][view]);
    assert_eq!(
        said,
        "photographs show 0 to 3 of the 4 points, 2 in the median; 1 of 3 show none, the first is c; no photograph \
             shows 1 of the 4 points"
    );
    let none = PointsSeen::of(&[away], &points);
    let said = none.said(|_| "c");
    assert!(said.starts_with("no photograph shows 4 of the 4 points: the axes of the cameras"), "{said}");
}

#[test]
fn of_many_points_some_are_looked_at() {
    let points: Vec<[f32; 3]> = (0..120_000).map(|i| [0.0, 0.0, if i % 5 == 0 { -9.0 } else { 0.0 }]).collect();
    let seen = PointsSeen::of(&[camera(0.0)], &points);
    assert_eq!(seen, PointsSeen { points: 120_000, unseen: 24_000, by_view: vec![96_000] });
    assert_eq!(PointsSeen::of(&[], &points).unseen, 120_000);
    assert_eq!(PointsSeen::of(&[camera(0.0)], &[]), PointsSeen { points: 0, unseen: 0, by_view: vec![0] });
}

#[test]
fn a_view_shows_a_point_once_by_its_tracks_or_else_by_projection() {
    let (intrinsics, towards) = camera(0.0);
    let view = |cam_from_world| {
        let (name, image_path, cut) = ("a".into(), "a".into(), Default::default());
        View { name, image_path, intrinsics, cam_from_world, cut }
    };
    let views = vec![view(towards), view(DAffine3::from_translation(-5.0 * DVec3::Z))];
    let mut capture = Capture::near_zero(Path::new(""), views, &[DVec3::ZERO; 3], vec![[0; 3]; 3]);
    assert_eq!(capture.shown(&[0, 1], 2), [vec![0, 2], vec![]]);
    for views in [vec![1, 1], vec![], vec![0, 1]] {
        capture.tracks.push(views.into_iter().map(|view| Observation { view, at_px: [1.0, 2.0] }), 0.5);
    }
    assert_eq!(capture.shown(&[1, 0], 1), [vec![0, 2], vec![2]]);
}
