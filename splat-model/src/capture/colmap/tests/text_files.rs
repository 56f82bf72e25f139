use proptest::prelude::*;

use super::*;

/// The error message of a small text model with one file replaced; it must name that file.
fn message(name: &str, text: impl AsRef<[u8]>) -> String {
    let folder = folder("sparse/0", &small_model_as_text());
    let replaced = folder.path().join("sparse/0").join(name);
    fs::write(&replaced, text).unwrap();
    let message = load(folder.path()).unwrap_err().to_string();
    assert!(message.contains(&replaced.display().to_string()), "{message}");
    message
}

#[test]
fn cameras_are_refused_by_line() {
    let bad = [
        ("1 FOV 40 30 50 50 20 15 0.1", ["FOV", "image_undistorter"]),
        ("1 PIN 40 30 50 50 20 15", ["PIN,", "image_undistorter"]),
        ("x PINHOLE 40 30 50 50 20 15", ["`CAMERA_ID` is \"x\"", "a whole number"]),
        ("1 PINHOLE 40 -3 50 50 20 15", ["`HEIGHT` is \"-3\"", "a whole number of px"]),
        ("1 PINHOLE 40 0 50 50 20 15", ["`HEIGHT` is 0", "1 to 32768 px"]),
        ("1 PINHOLE 40 30 50 50 20", ["`PARAMS` is 3 numbers", "4 numbers"]),
        ("1 OPENCV 40 30 50 50 20 15 0 0 0", ["`PARAMS` is 7 numbers", "8 numbers"]),
        ("1 SIMPLE_RADIAL 40 30", ["`PARAMS` is 0 numbers", "4 numbers"]),
        ("1 PINHOLE 40 30 50 50 20 15 0", ["`PARAMS` is 5 numbers", "4 numbers"]),
        ("1 SIMPLE_PINHOLE 40 30 nan 20 15", ["`PARAMS` is NaN", "a positive, finite focal length"]),
        ("1 PINHOLE", ["`WIDTH` is missing", "a value"]),
    ];
    for (line, parts) in bad {
        let message = message("cameras.txt", format!("# a comment\n\n{line}\n"));
        assert_says(&message, &["camera on line 3"]);
        assert_says(&message, &parts);
        assert!(message.contains("export it again") || message.contains("image_undistorter"), "{message}");
    }
}

#[test]
fn images_are_refused_by_line() {
    let bad = [
        ("2 1 0 0 inf 0 0 0 4 b", "`QZ` is inf"),
        ("2 0 0 0 0 0 0 0 4 b", "a quaternion that is not zero"),
        ("2 1 0 0 0 0 0 1e16 4 b", "`TZ` is 1"),
        ("2 1 0 0 0 0 zero 0 4 b", "`TY` is \"zero\""),
        ("2 1 0 0 0 0 0 0 -1 b", "`CAMERA_ID` is \"-1\""),
        ("2 1 0 0 0 0 0 0 77 b", "`CAMERA_ID` is 77 (of image \"b\")"),
        ("2 1 0 0 0 0 0 0 4", "`NAME` is \"\""),
        ("2 1 0 0 0 0 0 0 4 ../b", "neither absolute nor with `..`"),
        ("1 1 0 0 0 0 0 0 4 b", "`IMAGE_ID` is 1 again"),
        ("2 1 0 0 0 0 0 0 4 a", "`NAME` is \"a\" again"),
        ("2 1 0 0", "`QZ` is missing"),
    ];
    for (line, part) in bad {
        let message = message("images.txt", format!("# a comment\n1 1 0 0 0 0 0 0 4 a\n\n{line}\n\n"));
        assert_says(&message, &["image on line 4", part]);
        assert!(message.contains("export it again") || message.contains("--image_path"), "{message}");
    }
}

#[test]
fn images_without_lines_for_keypoints_are_refused_rather_than_halved() {
    let message = message("images.txt", "1 1 0 0 0 0 0 0 4 a\n2 1 0 0 0 0 0 0 4 b\n");
    assert_says(&message, &["line 2", "`POINTS2D`", "10 fields", "or an empty line", "export it again"]);
    // With blanks in its name, a line may have a multiple of three fields.
    let message = self::message("images.txt", "1 1 0 0 0 0 0 0 4 a\n2 1 0 0 0 0 0 0 4 my best photo\n");
    assert_says(&message, &["line 2", "`POINTS2D`", "12 fields"]);
}

#[test]
fn a_comment_sign_after_an_image_is_its_keypoints() {
    let folder = folder("sparse/0", &small_model_as_text());
    fs::write(folder.path().join("sparse/0/images.txt"), "1 1 0 0 0 0 0 0 4 a").unwrap();
    assert_eq!(load(folder.path()).unwrap().views.len(), 1, "the last line of keypoints may be missing");
}

#[test]
fn points_are_refused_by_line() {
    let bad = [
        ("1 0 0 nan 1 2 3 0.5", "`Z` is NaN"),
        ("1 0 0 1e39 1 2 3 0.5", "`Z` is 1"),
        ("1 0 0 0 1 256 3 0.5", "`G` is \"256\""),
        ("1 0 0 0 1 -2 3 0.5", "a whole number from 0 to 255"),
        ("1 0 0 0 1 2", "`B` is missing"),
        ("-1 0 0 0 1 2 3", "`POINT3D_ID` is \"-1\""),
    ];
    for (line, part) in bad {
        let message = message("points3D.txt", format!("# a comment\n1 0 0 0 1 2 3 0.5 1 2\n{line}\n"));
        assert_says(&message, &["point on line 3", part, "export it again"]);
    }
}

#[test]
fn text_of_windows_is_read() {
    let wide = |text: &str, bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
    for encode in [
        |text: &str| format!("\u{feff}{text}").into_bytes(),
        |text: &str| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect(),
        |text: &str| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_be_bytes).collect::<Vec<u8>>(),
    ] {
        let folder = folder("sparse/0", &small_model_as_text().map(|(name, text)| (name, encode(&text))));
        check_small(&load(folder.path()).unwrap(), folder.path());
    }
    let folder = folder("sparse/0", &small_model_as_text().map(|(name, text)| (name, wide(&text, u16::to_le_bytes))));
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn a_wrong_number_of_parameters_names_the_model() {
    for (parameters, found) in [("50 20.5 15.5", "3 numbers"), ("50 51 20.5 15.5 0 0 0 0", "8 numbers")] {
        let message = message("cameras.txt", format!("4 PINHOLE 40 30 {parameters}\n"));
        assert_says(&message, &["line 1", "`PARAMS`", found, "4 numbers for the camera model PINHOLE"]);
    }
    let message = |parameters: &[f64]| message_with("cameras.bin", &file(&[camera(4, 4, [40, 30], parameters)]));
    assert_says(&message(&[1.0; 5]), &["camera entry 1", "OPENCV has 8 parameters", "ends after 5"]);
    assert_says(
        &message(&[1.0; 10]),
        &["camera entry 1", "`PARAMS` is 10 numbers", "8 numbers for the camera model OPENCV"],
    );
}

#[test]
fn pictures_are_found_by_the_names_that_other_systems_write() {
    let folder = folder("sparse/0", &small_model_as_text());
    let images = "1 1 0 0 0 0 0 0 4 b\\two.jpg\n\n2 1 0 0 0 0 0 0 4 A one.JPG\n\n3 1 0 0 0 0 0 0 4 c.png\n\n4 1 0 0 0 0 0 0 4 gone\\x.png\n\n";
    fs::write(folder.path().join("sparse/0/images.txt"), images).unwrap();
    fs::create_dir_all(folder.path().join("images/b")).unwrap();
    for name in ["b/two.jpg", "a one.jpg", "c.png.png"] {
        ::image::RgbImage::new(40, 30).save(folder.path().join("images").join(name)).unwrap();
    }
    let capture = load(folder.path()).unwrap();
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a one.jpg", "b/two.jpg", "c.png.png", "gone\\x.png"]);
    // Two names of one file are one photograph too many.
    let twice = images.replace("c.png", "b/two.jpg");
    fs::write(folder.path().join("sparse/0/images.txt"), twice).unwrap();
    assert_says(&load(folder.path()).unwrap_err().to_string(), &["`NAME` is \"b/two.jpg\" again"]);
    for name in ["..\\x.png", "C:\\x.png", "\\x.png"] {
        fs::write(folder.path().join("sparse/0/images.txt"), format!("1 1 0 0 0 0 0 0 4 {name}\n\n")).unwrap();
        assert_says(&load(folder.path()).unwrap_err().to_string(), &["`NAME`", "neither absolute nor with `..`"]);
    }
}

#[test]
fn bytes_that_are_not_text_are_refused_by_line() {
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        assert_says(&message(name, b"# one\n# two\n\xff\n"), &["line 3", "UTF-8", "export it again"]);
    }
}

proptest! {
    #[test]
    fn random_text_never_panics(text in "\\PC*") {
        let (file, bytes) = (Path::new("random.txt"), text.as_bytes());
        let _ = text::cameras(file, bytes);
        let _ = text::images(file, bytes);
        let _ = text::points(file, bytes);
    }

    /// Shuffled fields are closer to valid files than random text, and so test deeper parts of the readers.
    #[test]
    fn shuffled_fields_never_panic(text in "((-?[0-9]{1,3}(\\.[0-9])?|nan|inf|PINHOLE|#|a\\.jpg|\\.\\.)( |  |\n)){0,80}") {
        let (file, bytes) = (Path::new("random.txt"), text.as_bytes());
        let _ = text::cameras(file, bytes);
        let _ = text::images(file, bytes);
        let _ = text::points(file, bytes);
    }

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let file = Path::new("random.txt");
        let _ = text::cameras(file, &bytes);
        let _ = text::images(file, &bytes);
        let _ = text::points(file, &bytes);
    }
}
