//! Polycam and Record3D.

use super::*;

/// A camera of Polycam.
fn camera(pose: &DMat4) -> String {
    let rows = pose.transpose().to_cols_array_2d();
    let cell = |at: usize| format!(r#""t_{}{}": {:?}"#, at / 4, at % 4, rows[at / 4][at % 4]);
    let cells: Vec<String> = (0..12).map(cell).collect();
    let rest = r#""fx": 70, "fy": 71.5, "cx": 41, "cy": 28.5, "width": 80, "height": 60, "blur_score": 9.5"#;
    format!(r#"{{{rest}, "neighbors": [1, "x", {{}}], {}}}"#, cells.join(", "))
}

fn polycam() -> Vec<(String, String)> {
    let mut files = Vec::new();
    for (i, pose) in poses().iter().enumerate() {
        files.push((format!("keyframes/corrected_cameras/10{i}.json"), camera(pose)));
        files.push((format!("keyframes/cameras/10{i}.json"), camera(&poses()[0])));
        files.push((format!("keyframes/corrected_images/10{i}.jpg"), String::new()));
        files.push((format!("keyframes/images/10{i}.jpg"), String::new()));
    }
    // What macOS adds to an archive.
    files.push(("keyframes/corrected_cameras/._100.json".into(), "\u{0}".into()));
    files
}

fn borrowed(files: &[(String, String)]) -> Vec<(&str, &str)> {
    files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect()
}

#[test]
fn polycam_is_read_with_the_poses_that_it_optimised() {
    let root = folder(&borrowed(&polycam()));
    let expected = reference(r#""fl_x": 70, "fl_y": 71.5, "cx": 41, "cy": 28.5,"#);
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!((capture.format, &capture.folder), ("Polycam", &root.path().to_path_buf()));
    let corrected = [0, 1, 2].map(|i| format!("keyframes/corrected_images/10{i}.jpg"));
    assert_eq!(names(&capture), corrected);
    assert_same(&capture, &expected);
    assert!(capture.views.iter().all(|view| view.image_path.is_file()));
    // The folder of the photographs, and that above, are the same capture.
    for place in ["keyframes", "keyframes/corrected_images"] {
        assert_same(&Capture::load(&root.path().join(place)).unwrap(), &expected);
    }
    fs::remove_dir_all(root.path().join("keyframes/corrected_cameras")).unwrap();
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!(names(&capture)[0], "keyframes/images/100.jpg");
    assert_eq!(capture.views[0].cam_from_world, capture.views[2].cam_from_world);
}

#[test]
fn damaged_files_of_polycam_are_refused() {
    let files = polycam();
    let files = borrowed(&files);
    for (from, to, parts) in [
        ("\"fx\": 70", "\"fx\": \"70\"", &["100.json", "`fx` is missing or not a number"][..]),
        ("\"fx\": 70", "\"fx\": 0", &["corrected_images/100.jpg", "`fl_x` is 0"]),
        ("\"width\": 80", "\"width\": 0", &["corrected_images/100.jpg", "`w` is 0"]),
        ("\"t_23\"", "\"t_33\"", &["`t_23` is missing"]),
        ("\"t_00\": ", "\"t_00\": 7", &["corrected_images/100.jpg", "`transform_matrix`", "a rotation"]),
        ("\"t_00\": ", "\"t_00\": NaN, \"a\": ", &["line 1", "finite"]),
        ("[1, ", &"[".repeat(100_000), &["line 1", "recursion limit"]),
    ] {
        assert_refused(&files, 0, from, to, parts);
    }
    let without: Vec<_> =
        files.iter().copied().filter(|(name, _)| !name.ends_with("corrected_images/101.jpg")).collect();
    let message = Capture::load(folder(&without).path()).unwrap_err().to_string();
    assert_says(&message, &["corrected_cameras", "1 of 3 photographs", "corrected_images/101"]);
}

fn record3d(per_picture: bool) -> String {
    let pose = |pose: &DMat4| {
        let (_, turn, at) = pose.to_scale_rotation_translation();
        // A quaternion of any length.
        format!(
            "[{:?}, {:?}, {:?}, {:?}, {:?}, {:?}, {:?}]",
            2.0 * turn.x,
            2.0 * turn.y,
            2.0 * turn.z,
            2.0 * turn.w,
            at.x,
            at.y,
            at.z
        )
    };
    let poses: Vec<String> = poses().iter().map(pose).collect();
    let lenses = r#""perFrameIntrinsicCoeffs": [[70, 71.5, 41, 28.5], [70, 71.5, 41, 28.5], [70, 71.5, 41, 28.5]],"#;
    let (matrix, lenses) = if per_picture { (9.0, lenses) } else { (70.0, "") };
    format!(
        r#"{{"h": 60, "w": 80, "fps": 60, "dw": 4, "K": [{matrix:?}, 0, 0, 0, 71.5, 0, 41, 28.5, 1], {lenses} "initPose": [0, 0, 0, 1, 0, 0, 0],
            "poses": [{}]}}"#,
        poses.join(", ")
    )
}

#[test]
fn record3d_is_read_in_both_layouts() {
    let expected = reference(r#""fl_x": 70, "fl_y": 71.5, "cx": 41, "cy": 28.5,"#);
    for (file, pictures, per_picture) in [("metadata", "rgbd", true), ("metadata.json", "rgb", false)] {
        let pictures = [0, 1, 2].map(|i| format!("{pictures}/{i}.jpg"));
        let text = record3d(per_picture);
        let mut files = pictures.each_ref().map(|name| (name.as_str(), "")).to_vec();
        files.push((file, &text));
        let root = folder(&files);
        let capture = Capture::load(root.path()).unwrap();
        assert_eq!((capture.format, names(&capture)), ("Record3D", pictures.each_ref().map(String::as_str).to_vec()));
        assert_same(&capture, &expected);
        assert_same(&Capture::load(&root.path().join(file)).unwrap(), &expected);
        // A photograph that is not there is missing when it is needed, as in JSON with sizes.
        fs::remove_file(root.path().join(&pictures[1])).unwrap();
        let capture = Capture::load(root.path()).unwrap();
        assert_says(
            &capture.check_photographs(&[0, 1]).unwrap_err().to_string(),
            &["1 of 3 photographs", &pictures[1]],
        );
    }
}

#[test]
fn damaged_files_of_record3d_are_refused() {
    let text = record3d(false);
    let files = [("metadata", text.as_str()), ("rgbd/0.jpg", ""), ("rgbd/1.jpg", ""), ("rgbd/2.jpg", "")];
    let pose = text.split("\"poses\": [").nth(1).unwrap().split(']').next().unwrap();
    for (from, to, parts) in [
        ("\"w\": 80", "\"w\": 0", &["frame 0 (\"rgbd/0.jpg\")", "`w` is 0"][..]),
        ("\"w\": 80", "\"v\": 80", &["missing field `w`"]),
        ("[70.0, 0,", "[-70.0, 0,", &["`fl_x` is -70"]),
        ("[70.0, 0,", "[0,", &["K", "invalid length 8"]),
        (pose, "[0, 0, 0, 0, 1, 2, 3", &["frame 0", "0 0 0 0", "a quaternion"]),
        (pose, "[0, 0, 0, 1, 1e300, 2, 3", &["frame 0", "`TX`", "1e15"]),
        (pose, "[0, 0, 0, 1", &["poses[0]", "invalid length 4"]),
        (pose, "[NaN", &["poses[0]", "finite"]),
        ("\"poses\": [", "\"poses\": [], \"q\": [", &["lists no images"]),
    ] {
        assert_refused(&files, 0, from, to, parts);
    }
}
