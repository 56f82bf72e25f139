use glam::DQuat;

use super::*;

/// A camera at `centre`, turned by some angle.
fn camera(centre: DVec3, angle_rad: f64) -> DAffine3 {
    let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), angle_rad);
    DAffine3::from_rotation_translation(rotation, -(rotation * centre))
}

fn ring(offset: DVec3, radius: f64) -> Vec<DAffine3> {
    (0..12)
        .map(|i| (f64::from(i), DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.5)))
        .map(|(angle, direction)| camera(offset + radius * direction, angle))
        .collect()
}

#[test]
fn a_capture_around_zero_stays() {
    assert_eq!(choose(&ring(DVec3::new(40.0, -3.0, 7.0), 2.0)), DVec3::ZERO);
    assert_eq!(choose(&[]), DVec3::ZERO);
}

#[test]
fn a_small_capture_some_units_away_stays() {
    assert_eq!(choose(&ring(DVec3::new(5.0, 0.0, 0.0), 0.01)), DVec3::ZERO);
}

#[test]
fn a_far_capture_moves_by_whole_units() {
    let offset = DVec3::new(6.4e6, -2.5e5, 1.25e5);
    let origin = choose(&ring(offset, 3.0));
    assert_eq!(origin, origin.round());
    assert!(origin.distance(offset) < 4.0, "{origin}");
}

#[test]
fn distance_counts_relative_to_the_extent() {
    let offset = DVec3::new(6.4e6, 0.0, 0.0);
    assert_eq!(choose(&ring(offset, 1e5)), DVec3::ZERO, "64 extents away");
    assert_ne!(choose(&ring(offset, 1e4)), DVec3::ZERO, "640 extents away");
}

#[test]
fn a_single_camera_moves_only_from_far_out() {
    assert_eq!(choose(&[camera(DVec3::new(90.0, 0.0, 0.0), 0.4)]), DVec3::ZERO);
    assert_eq!(choose(&[camera(DVec3::new(6.4e6, 0.3, 0.0), 0.4)]), DVec3::new(6.4e6, 0.0, 0.0));
}

#[test]
fn a_moved_pose_sees_the_same() {
    let origin = DVec3::new(6.4e6, -2.5e5, 12.0);
    let far = camera(origin + DVec3::new(1.0, 2.0, 3.0), 0.7);
    let near = moved(&far, origin);
    let point = DVec3::new(4.0, -1.0, 9.0);
    let error = near.transform_point3(point).distance(far.transform_point3(point + origin));
    assert!(error < 1e-7, "{error}");
    assert!(near.translation.length() < 10.0);
}
