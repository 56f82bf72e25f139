use std::time::{Duration, Instant};

use proptest::prelude::*;
use splat_op::CameraModel;

use super::*;

fn cameras(entries: &[Vec<u8>]) -> String {
    message_with("cameras.bin", &file(entries))
}

fn images(entries: &[Vec<u8>]) -> String {
    message_with("images.bin", &file(entries))
}

fn points(entries: &[Vec<u8>]) -> String {
    message_with("points3D.bin", &file(entries))
}

const GOOD: [f64; 4] = [50.0, 50.0, 20.0, 15.0];

#[test]
fn other_cameras_are_refused_by_name() {
    for (number, name) in [(7, "FOV"), (11, "RAD_TAN_THIN_PRISM_FISHEYE"), (16, "EUCM")] {
        let other = camera(1, number, [40, 30], &[50.0, 50.0, 20.0, 15.0, 0.1]);
        assert_says(&cameras(&[other]), &["camera entry 1", name, "not supported", "image_undistorter"]);
    }
    for number in [-1, 77, i32::MIN] {
        let unknown = camera(1, number, [40, 30], &GOOD);
        assert_says(&cameras(&[unknown]), &[&format!("number {number}"), "image_undistorter"]);
    }
}

/// COLMAP's number and parameters of each model, and ours.
#[test]
fn every_lens_is_read() {
    let p = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0];
    for (number, ours, focals, coefficients) in [
        (0, CameraModel::Pinhole, 1, 0),
        (1, CameraModel::Pinhole, 2, 0),
        (2, CameraModel::OpenCv, 1, 1),
        (3, CameraModel::OpenCv, 1, 2),
        (4, CameraModel::OpenCv, 2, 4),
        (5, CameraModel::Fisheye, 2, 4),
        (6, CameraModel::FullOpenCv, 2, 8),
        (8, CameraModel::Fisheye, 1, 1),
        (9, CameraModel::Fisheye, 1, 2),
        (10, CameraModel::ThinPrismFisheye, 2, 8),
        (14, CameraModel::Fisheye, 1, 0),
        (15, CameraModel::Fisheye, 2, 0),
    ] {
        let bytes = file(&[camera(1, number, [40, 30], &p[..focals + 2 + coefficients])]);
        let found = binary::cameras(Path::new("cameras.bin"), &bytes).unwrap()[0].intrinsics;
        assert_eq!((found.model, found.fx, found.fy), (ours, 1.0, focals as f64), "number {number}");
        assert_eq!((found.cx, found.cy), (p[focals], p[focals + 1]), "number {number}");
        let mut distortion = [0.0; 8];
        distortion[..coefficients].copy_from_slice(&p[focals + 2..focals + 2 + coefficients]);
        assert_eq!(found.distortion, distortion, "number {number}");
    }
}

#[test]
fn bad_sizes_are_refused() {
    for (size, field, found) in
        [([0, 30], "`WIDTH`", "is 0,"), ([40, 0], "`HEIGHT`", "is 0,"), ([40, u64::MAX], "`HEIGHT`", "is 18446")]
    {
        let message = cameras(&[camera(1, 1, [40, 30], &GOOD), camera(2, 1, size, &GOOD)]);
        assert_says(&message, &["camera entry 2", field, found, "1 to 32768 px", "export it again"]);
    }
    let widest = [camera(4, 1, [32768, 32768], &GOOD), camera(9, 1, [1, 1], &GOOD)];
    let folder = folder("sparse/0", &small_model());
    fs::write(folder.path().join("sparse/0/cameras.bin"), file(&widest)).unwrap();
    assert!(load(folder.path()).is_ok());
    assert_says(&cameras(&[camera(1, 1, [32769, 1], &GOOD)]), &["`WIDTH` is 32769"]);
}

#[test]
fn bad_lenses_are_refused() {
    for focal in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        for parameters in [[focal, 50.0, 20.0, 15.0], [50.0, focal, 20.0, 15.0]] {
            let message = cameras(&[camera(1, 1, [40, 30], &parameters)]);
            assert_says(&message, &["`PARAMS`", "a positive, finite focal length", "export it again"]);
        }
    }
    for coefficient in [f64::NAN, f64::INFINITY, -2e9] {
        let message = cameras(&[camera(1, 2, [40, 30], &[50.0, 20.0, 15.0, coefficient])]);
        assert_says(&message, &["`PARAMS`", "a coefficient of the lens", "export it again"]);
    }
    for parameters in [[50.0, 50.0, f64::NAN, 15.0], [50.0, 50.0, 20.0, f64::NEG_INFINITY]] {
        let message = cameras(&[camera(1, 1, [40, 30], &parameters)]);
        assert_says(&message, &["`PARAMS`", "a finite principal point", "export it again"]);
    }
}

#[test]
fn bad_poses_are_refused() {
    for (slot, field) in ["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"].into_iter().enumerate() {
        for value in [f64::NAN, f64::INFINITY] {
            let mut pose = looking_from([0.0; 3]);
            pose[slot] = value;
            let message = images(&[image(1, pose, 4, b"a"), image(2, pose, 4, b"b")]);
            assert_says(&message, &["image entry 1", &format!("`{field}`"), "a finite number", "export it again"]);
        }
    }
    let message = images(&[image(1, [0.0; 7], 4, b"a")]);
    assert_says(&message, &["QW QX QY QZ", "0 0 0 0", "not zero", "export it again"]);
}

#[test]
fn quaternions_of_any_length_are_rotations() {
    for length in [1e-300, 1e-20, 1.0, 1e20, 1e300] {
        let [cameras, _, _] = small_model();
        let pose = [length, length, 0.0, 0.0, 0.0, 0.0, 0.0];
        let folder = folder("sparse/0", &[cameras, ("images.bin", file(&[image(1, pose, 4, b"a")]))]);
        let seen = load(folder.path()).unwrap().views[0].cam_from_world.transform_vector3(DVec3::Y);
        assert!(seen.distance(DVec3::Z) < 1e-12, "a quarter turn about x, at length {length}: {seen}");
    }
}

#[test]
fn names_must_stay_below_the_folder_of_pictures() {
    for name in ["/etc/passwd", "../a.jpg", "a/../../b.jpg", ".."] {
        let message = images(&[image(1, looking_from([0.0; 3]), 4, name.as_bytes())]);
        assert_says(&message, &["image entry 1", "`NAME`", name, "neither absolute nor with `..`", "--image_path"]);
    }
    assert_says(&images(&[image(1, looking_from([0.0; 3]), 4, b"")]), &["`NAME` is \"\"", "--image_path"]);
    assert_says(&images(&[image(1, looking_from([0.0; 3]), 4, b"\xff.jpg")]), &["`NAME`", "\\xff.jpg", "UTF-8"]);
}

#[test]
fn contradictions_are_refused() {
    let pose = looking_from([0.0; 3]);
    let message = images(&[image(1, pose, 4, b"a"), image(1, pose, 4, b"b")]);
    assert_says(&message, &["image entry 2", "`IMAGE_ID` is 1 again", "export it again"]);
    let message = images(&[image(1, pose, 4, b"a"), image(2, pose, 4, b"a")]);
    assert_says(&message, &["image entry 2", "`NAME` is \"a\" again", "export it again"]);
    let message = images(&[image(1, pose, 4, b"a"), image(2, pose, 5, b"b")]);
    assert_says(
        &message,
        &["image entry 2", "`CAMERA_ID` is 5 (of image \"b\")", "3 cameras in", "cameras.bin", "export"],
    );
    let message = cameras(&[camera(4, 1, [40, 30], &GOOD), camera(4, 1, [40, 30], &GOOD)]);
    assert_says(&message, &["camera entry 2", "`CAMERA_ID` is 4 again", "export it again"]);
}

#[test]
fn bad_positions_are_refused() {
    for (slot, field) in ["X", "Y", "Z"].into_iter().enumerate() {
        // The last value is finite in f64, but not as an f32.
        for value in [f64::NAN, f64::NEG_INFINITY, 1e300] {
            let mut xyz = [0.0; 3];
            xyz[slot] = value;
            let message = points(&[point([0.0; 3], [0; 3], 1), point(xyz, [0; 3], 1)]);
            assert_says(&message, &["point entry 2", &format!("`{field}`"), "a finite number", "export it again"]);
        }
    }
}

#[test]
fn left_over_bytes_are_refused() {
    for (name, mut bytes) in small_model() {
        bytes.push(0);
        assert_says(&message_with(name, &bytes), &["1 bytes follow the last of", "expected none", "model_converter"]);
    }
}

#[test]
fn every_shorter_file_is_refused() {
    for (name, bytes) in small_model() {
        for length in 0..bytes.len() {
            let message = message_with(name, &bytes[..length]);
            assert_says(&message, &["cut short", "copy or export it again"]);
        }
    }
}

/// Counts that would exhaust the memory, or wrap to a small number when multiplied by the size of an entry.
#[test]
fn hostile_counts_allocate_nothing() {
    let started = Instant::now();
    for count in [1_000_000_000, 1 << 61, u64::MAX / 24 + 1, u64::MAX] {
        for (name, mut bytes) in small_model() {
            bytes[..8].copy_from_slice(&count.to_le_bytes());
            let message = message_with(name, &bytes);
            assert_says(&message, &["the number of", &count.to_string(), "bytes, but only", "copy or export it again"]);
        }
    }
    for count in [3, 1_000_000_000, 1 << 61, u64::MAX / 24 + 1, u64::MAX] {
        let inner = |mut entry: Vec<u8>, from_end: usize| {
            let at = entry.len() - from_end;
            entry[at..at + 8].copy_from_slice(&count.to_le_bytes());
            entry
        };
        let image = inner(image(1, looking_from([0.0; 3]), 4, b"a"), 8 + 48);
        assert_says(&images(&[image]), &["POINTS2D in image entry 1", &count.to_string(), "only 48 bytes follow"]);
        let point = inner(point([0.0; 3], [0; 3], 2), 8 + 16);
        assert_says(&points(&[point]), &["TRACK in point entry 1", &count.to_string(), "only 16 bytes follow"]);
    }
    assert!(started.elapsed() < Duration::from_secs(10));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let file = Path::new("random.bin");
        let _ = binary::cameras(file, &bytes);
        let _ = binary::images(file, &bytes);
        let _ = binary::points(file, &bytes);
    }

    /// Damaged files are closer to valid ones than random bytes, and so test deeper parts of the readers.
    #[test]
    fn damaged_files_never_panic(
        which in 0_usize..3,
        damage in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut files = small_model();
        let bytes = &mut files[which].1;
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let folder = folder("sparse/0", &files);
        if let Ok(capture) = load(folder.path()) {
            prop_assert!(capture.points.positions.iter().flatten().all(|x| x.is_finite()));
            prop_assert!(capture.views.iter().all(|view| view.cam_from_world.is_finite()));
        }
    }
}
