use super::*;

#[test]
fn an_orbit_goes_around_what_the_cameras_look_at() {
    let centre = DVec3::new(3.0, -1.0, 2.0);
    // Three cameras on a quarter of a circle with a radius of 2, half a unit above, +y down, that look at the centre.
    let view = |angle: f64| {
        let position = centre + DVec3::new(2.0 * angle.cos(), -0.5, 2.0 * angle.sin());
        let forward = (centre - position).normalize();
        let right = forward.cross(DVec3::NEG_Y).normalize();
        let axes = DMat3::from_cols(right, forward.cross(right), forward);
        DAffine3::from_mat3_translation(axes, position)
    };
    let poses = [0.0, 0.8, 1.6].map(view);
    assert!((focus(&poses).unwrap() - centre).length() < 1e-9);
    assert_eq!(focus(&[poses[0], poses[0]]), None);
    let lens = pinhole(&Intrinsics::centred(65, 49, 60.0).with_focal(60.0, 70.0));
    assert_eq!((lens.width, lens.height, lens.fx), (64, 48, 70.0));
    let path = orbit(&poses, 8).unwrap();
    for (i, cam_from_world) in path.iter().enumerate() {
        let pose = cam_from_world.inverse();
        let ahead = cam_from_world.transform_point3(centre);
        assert!(ahead.truncate().length() < 1e-9 && (ahead.z - 4.25f64.sqrt()).abs() < 1e-3, "{i}: {ahead}");
        assert!(pose.matrix3.y_axis.y > 0.9 && (pose.matrix3.determinant() - 1.0).abs() < 1e-9, "{i}");
        let step = |i: usize| (path[i % 8].inverse().translation - path[(i + 1) % 8].inverse().translation).length();
        assert!((step(i) - step(0)).abs() < 1e-9, "{i}: {} instead of {}", step(i), step(0));
        // Three tilted cameras on one side lean the mean of their vertical axes, so the circle is not quite theirs.
        let expected = 4.0 * (TAU / 16.0).sin();
        assert!((step(i) - expected).abs() < 0.05 * expected, "{i}: {} instead of {expected}", step(i));
    }
}

/// A camera at a place, turned around the world's y axis.
fn keyframe(position: DVec3, turn: f64, fov_y_degrees: Option<f64>) -> (DAffine3, Option<f64>) {
    (DAffine3::from_rotation_translation(DQuat::from_rotation_y(turn), position), fov_y_degrees)
}

/// The turn of a camera around the y axis, from 0 to τ.
fn turn(cam_from_world: &DAffine3) -> f64 {
    let forward = cam_from_world.inverse().matrix3.z_axis;
    assert!(forward.y.abs() < 1e-9, "{forward}");
    forward.x.atan2(forward.z).rem_euclid(TAU)
}

#[test]
fn a_path_goes_smoothly_through_its_keyframes() {
    let lens = Intrinsics::centred(64, 48, 60.0);
    let origin = DVec3::new(1e6, 0.0, -2e6);
    // All the way around, in steps that need both signs of quaternions.
    let places =
        [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [2.0, -1.0, 3.0], [2.0, -1.0, 4.0], [0.0, 0.0, 6.0]].map(DVec3::from);
    let keyframes: Vec<_> =
        (0..5).map(|i| keyframe(origin + places[i], 1.5 * i as f64 + 0.1, (i % 2 == 0).then_some(90.0))).collect();
    let cameras = along(&keyframes, origin, &lens, 4 * 100 + 1);
    let position = |i: usize| cameras[i].1.inverse().translation;
    for (i, place) in places.iter().enumerate() {
        let (intrinsics, pose) = cameras[100 * i];
        assert!(position(100 * i).distance(*place) < 1e-9, "{i}: {}", position(100 * i));
        assert!((turn(&pose) - (1.5 * i as f64 + 0.1)).abs() < 1e-9, "{i}: {}", turn(&pose));
        // 48 px at 90 degrees.
        let expected = if i % 2 == 0 { 24.0 } else { 60.0 };
        assert!((intrinsics.fx - expected).abs() < 1e-9 && intrinsics.fx <= intrinsics.fy, "{i}: {}", intrinsics.fx);
        assert_eq!((intrinsics.width, intrinsics.height, intrinsics.cx), (64, 48, 32.0));
    }
    // Neither velocity jumps: a step differs from the next by its acceleration, which falls with the square of a step's duration.
    let along_turn: Vec<f64> = cameras.iter().map(|(_, pose)| turn(pose)).collect();
    for i in 1..400 {
        let jump = position(i + 1) - 2.0 * position(i) + position(i - 1);
        assert!(jump.length() < 2e-3, "{i}: {jump}");
        let (before, after) = (along_turn[i] - along_turn[i - 1], along_turn[i + 1] - along_turn[i]);
        assert!((before - after).abs() < 1e-3 && (0.01..0.02).contains(&before), "{i}: {before}, {after}");
    }
}

#[test]
fn two_keyframes_are_a_straight_line_and_one_picture_is_its_beginning() {
    let lens = Intrinsics::centred(64, 48, 60.0);
    let keyframes = [keyframe(DVec3::ZERO, 0.0, None), keyframe(DVec3::X, 0.5, None)];
    for (i, (_, pose)) in along(&keyframes, DVec3::ZERO, &lens, 5).iter().enumerate() {
        let (position, share) = (pose.inverse().translation, i as f64 / 4.0);
        assert!(position.distance(share * DVec3::X) < 1e-12, "{i}: {position}");
        assert!((turn(pose) - 0.5 * share).abs() < 2e-3, "{i}: {}", turn(pose));
    }
    let one = along(&keyframes, DVec3::ZERO, &lens, 1);
    assert_eq!((one.len(), one[0].1.inverse().translation), (1, DVec3::ZERO));
}
