use super::*;

#[test]
fn a_lens_moves_the_corners_most() {
    let pinhole = Intrinsics::centred(100, 80, 50.0);
    assert_eq!(displacement_px(&pinhole), Some(0.0));
    let plain = pinhole.with_lens(CameraModel::OpenCv, [0.0; 8]);
    assert!(displacement_px(&plain).expect("as a pinhole") < 1e-9);
    let mut barrel = plain;
    barrel.distortion[0] = -0.05;
    // The corner is the image of the slopes s: r (1 - 0.05 r²) = |(50, 40)| / 50.
    let corner = DVec2::new(50.0, 40.0).length() / 50.0;
    let mut r = corner;
    for _ in 0..200 {
        r = corner / (1.0 - 0.05 * r * r);
    }
    let expected = 50.0 * (r - corner);
    let found = displacement_px(&barrel).expect("less than a right angle");
    assert!((found - expected).abs() < 1e-6, "{found} instead of {expected}");
    let fisheye = pinhole.with_focal(20.0, 20.0).with_lens(CameraModel::Fisheye, [0.0; 8]);
    assert_eq!(displacement_px(&fisheye), None, "its border lies beyond a right angle");
}
