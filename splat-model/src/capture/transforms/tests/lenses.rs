//! Tests of the lens parameters of files.

use splat_op::Intrinsics;

use super::*;

/// The camera of a file with the fields `of_file` and one frame with the fields `of_frame`.
fn camera(of_file: &str, of_frame: &str) -> Result<Intrinsics, String> {
    let text =
        format!(r#"{{{of_file} "frames": [{{{of_frame} "file_path": "a.png", "transform_matrix": {LOOKING_BACK}}}]}}"#);
    let root = folder(&[(SINGLE, &text), ("a.png", "")]);
    Ok(Capture::load(root.path()).map_err(|error| error.to_string())?.views[0].intrinsics)
}

fn model(fields: &str) -> Result<(CameraModel, [f64; 8]), String> {
    camera(&format!(r#""fl_x": 8, {fields}"#), "").map(|camera| (camera.model, camera.distortion))
}

#[test]
fn pixels_stand_for_themselves() {
    let camera = camera(r#""fl_x": 8.5, "fl_y": 9, "cx": 4.25, "cy": 2.5, "w": 10, "h": 7.0,"#, "").unwrap();
    let expected = Intrinsics::pinhole(10, 7, [8.5, 9.0], [4.25, 2.5]);
    assert_eq!(camera, expected);
}

#[test]
fn the_frame_goes_before_the_file_and_lengths_before_angles() {
    let focals = |of_file: &str, of_frame: &str| camera(of_file, of_frame).map(|camera| [camera.fx, camera.fy]);
    let right_angle = format!(r#""camera_angle_x": {},"#, std::f64::consts::FRAC_PI_2);
    let upright = right_angle.replace('x', "y");
    let near = |found: [f64; 2], expected: [f64; 2]| (0..2).all(|i| (found[i] - expected[i]).abs() < 1e-12);
    // 8 × 6 px under a right angle: the focal length is half the side.
    assert!(near(focals(&right_angle, "").unwrap(), [4.0, 4.0]), "pixels are square");
    assert!(near(focals(&[right_angle.as_str(), &upright].concat(), "").unwrap(), [4.0, 3.0]));
    assert_eq!(focals(&[&right_angle, r#""fl_x": 7,"#].concat(), ""), Ok([7.0, 7.0]));
    assert!(near(focals(r#""fl_x": 7,"#, &right_angle).unwrap(), [4.0, 4.0]));
    assert_eq!(focals(r#""fl_x": 7, "fl_y": 6,"#, r#""fl_x": 5,"#), Ok([5.0, 6.0]));
    assert_eq!(focals(r#""fl_x": null, "fl_y": 6,"#, ""), Ok([6.0, 6.0]));
    let sizes = camera(r#""fl_x": 7, "w": 8, "h": 6,"#, r#""w": 20, "h": 10, "cx": 9,"#).unwrap();
    assert_eq!((sizes.width, sizes.height, sizes.cx, sizes.cy), (20, 10, 9.0, 5.0));
}

#[test]
fn coefficients_decide_on_the_model() {
    let with = |distortion: [f64; 6]| {
        let [k1, k2, p1, p2, k3, k4] = distortion;
        format!(r#""k1": {k1}, "k2": {k2}, "p1": {p1}, "p2": {p2}, "k3": {k3}, "k4": {k4},"#)
    };
    let named = |name: &str, distortion| format!(r#""camera_model": "{name}", {}"#, with(distortion));
    let padded = |distortion: [f64; 6]| {
        let [a, b, c, d, e, f] = distortion;
        [a, b, c, d, e, f, 0.0, 0.0]
    };
    let zero = [0.0; 6];
    let (plain, third, fourth) =
        ([0.1, -0.2, 0.01, 0.02, 0.0, 0.0], [0.1, -0.2, 0.01, 0.02, 0.3, 0.0], [0.1, 0.0, 0.0, 0.0, 0.3, 0.4]);
    for name in ["OPENCV", "PINHOLE", "SIMPLE_RADIAL", "FULL_OPENCV"] {
        assert_eq!(model(&named(name, zero)), Ok((CameraModel::Pinhole, [0.0; 8])), "{name}");
        assert_eq!(model(&named(name, plain)), Ok((CameraModel::OpenCv, padded(plain))), "{name}");
        assert_eq!(model(&named(name, third)), Ok((CameraModel::FullOpenCv, padded(third))), "{name}");
    }
    assert_eq!(model(&with(plain)), Ok((CameraModel::OpenCv, padded(plain))), "without a name");
    assert_eq!(model(&named("FULL_OPENCV", fourth)), Ok((CameraModel::FullOpenCv, padded(fourth))));
    let ambiguous = model(&named("OPENCV", fourth)).unwrap_err();
    assert!(ambiguous.contains("`k4` is 0.4") && ambiguous.contains("FULL_OPENCV"), "{ambiguous}");
}

#[test]
fn fisheyes_have_their_own_order() {
    let numbers = r#""k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4,"#;
    let expected = Ok((CameraModel::Fisheye, [0.1, 0.2, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(model(&format!(r#""camera_model": "OPENCV_FISHEYE", {numbers}"#)), expected);
    assert_eq!(model(&format!(r#""is_fisheye": true, {numbers}"#)), expected);
    assert_eq!(model(r#""camera_model": "OPENCV_FISHEYE","#), Ok((CameraModel::Fisheye, [0.0; 8])));
    assert_eq!(model(&format!(r#""camera_model": "THIN_PRISM_FISHEYE", {numbers}"#)), expected);
    let thin = model(&format!(
        r#""camera_model": "THIN_PRISM_FISHEYE", "p1": 0.5, "p2": 0.6, "sx1": 0.7, "sy1": 0.8, {numbers}"#
    ));
    assert_eq!(thin, Ok((CameraModel::ThinPrismFisheye, [0.1, 0.2, 0.5, 0.6, 0.3, 0.4, 0.7, 0.8])));
    assert_eq!(model(r#""is_fisheye": false,"#), Ok((CameraModel::Pinhole, [0.0; 8])));
    let message = model(r#""camera_model": "OPENCV_FISHEYE", "p1": 0.01,"#).unwrap_err();
    assert!(message.contains("`p1` is 0.01"), "{message}");
}

#[test]
fn impossible_lenses_are_refused_by_name() {
    for (fields, parts) in [
        ("", ["`fl_x` is missing", "camera_angle_x"]),
        (r#""fl_x": 0,"#, ["`fl_x` is 0", "positive"]),
        (r#""camera_angle_x": 3.2,"#, ["`camera_angle_x` is 3.2", "below pi"]),
        (r#""fl_x": 8, "w": 8.5,"#, ["`w` is 8.5", "1 to 32768"]),
        (r#""fl_x": 8, "h": 0,"#, ["`h` is 0", "1 to 32768"]),
        (r#""fl_x": 8, "cx": 1e16,"#, ["`cx` is 1", "principal point"]),
        (r#""fl_x": 8, "k1": -1e10,"#, ["`k1` is -1", "coefficient"]),
        (r#""fl_x": 8, "camera_model": "EUCM","#, ["`camera_model` is \"EUCM\"", "EQUIRECTANGULAR"]),
    ] {
        let message = camera(fields, "").unwrap_err();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        assert!(message.contains("frame 0 (\"a.png\")") && message.contains("transforms.json"), "{message}");
    }
}
