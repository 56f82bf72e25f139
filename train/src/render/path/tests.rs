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
