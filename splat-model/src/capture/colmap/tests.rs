//! Tests of the three readers, on small models and on real captures.

mod binary_files;
mod real;
mod text_files;

use std::fs;

use glam::DVec3;

use super::*;
use crate::capture::PointCloud;
use crate::capture::testing::assert_says;

fn load(folder: &Path) -> Result<Capture, CaptureError> {
    Capture::load(folder)
}

/// A camera as `cameras.bin` holds it: 64 bytes for PINHOLE.
fn camera(id: u32, model: i32, size_px: [u64; 2], parameters: &[f64]) -> Vec<u8> {
    let mut bytes = [id.to_le_bytes(), model.to_le_bytes()].concat();
    bytes.extend(size_px.iter().flat_map(|side| side.to_le_bytes()));
    bytes.extend(parameters.iter().flat_map(|number| number.to_le_bytes()));
    bytes
}

/// An image as `images.bin` holds it, with one matched and one unmatched keypoint.
fn image(id: u32, pose: [f64; 7], camera_id: u32, name: &[u8]) -> Vec<u8> {
    let mut bytes = id.to_le_bytes().to_vec();
    bytes.extend(pose.iter().flat_map(|number| number.to_le_bytes()));
    bytes.extend(camera_id.to_le_bytes());
    bytes.extend(name);
    bytes.push(0);
    bytes.extend(2_u64.to_le_bytes());
    for point in [7, u64::MAX] {
        bytes.extend([1.5_f64.to_le_bytes(), 2.5_f64.to_le_bytes(), point.to_le_bytes()].concat());
    }
    bytes
}

/// A point as `points3D.bin` holds it, with `track` observations.
fn point(xyz: [f64; 3], colour: [u8; 3], track: u64) -> Vec<u8> {
    let mut bytes = 7_u64.to_le_bytes().to_vec();
    bytes.extend(xyz.iter().flat_map(|number| number.to_le_bytes()));
    bytes.extend(colour);
    bytes.extend(0.5_f64.to_le_bytes());
    bytes.extend(track.to_le_bytes());
    bytes.extend((0..track).flat_map(|_| [0; 8]));
    bytes
}

/// A file of `entries`.
fn file(entries: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = (entries.len() as u64).to_le_bytes().to_vec();
    bytes.extend(entries.concat());
    bytes
}

/// Pose of a camera at `centre` that looks along the world's z.
fn looking_from(centre: [f64; 3]) -> [f64; 7] {
    let [x, y, z] = centre;
    [1.0, 0.0, 0.0, 0.0, -x, -y, -z]
}

/// The files of a small valid model: two images in reverse order of their names, a camera that no image uses, and a point with
/// an empty track.
fn small_model() -> [(&'static str, Vec<u8>); 3] {
    let cameras = [
        camera(4, 1, [40, 30], &[50.0, 51.0, 20.5, 15.5]),
        camera(9, 0, [80, 60], &[100.0, 40.0, 30.0]),
        camera(10, 1, [8, 6], &[10.0, 10.0, 4.0, 3.0]),
    ];
    // Rotated by half a turn about x, and of length two.
    let turned = [0.0, 2.0, 0.0, 0.0, 1.0, 2.0, 3.0];
    let images = [image(2, looking_from([1.0, 2.0, 3.0]), 4, b"b/two.jpg"), image(8, turned, 9, b"a one.jpg")];
    let points = [point([1.0, -2.0, 3.5], [255, 0, 7], 3), point([0.25, 0.5, 0.75], [1, 2, 3], 0)];
    [("cameras.bin", file(&cameras)), ("images.bin", file(&images)), ("points3D.bin", file(&points))]
}

fn small_model_as_text() -> [(&'static str, String); 3] {
    let cameras = "# Camera list\n4 PINHOLE 40 30 50 51 20.5 15.5\n9 SIMPLE_PINHOLE 80 60 100 40 30\r\n\n\
                   10 PINHOLE 8 6 10 10 4 3\n";
    let images = "# Image list\n2 1 0 0 0 -1 -2 -3 4 b/two.jpg\n1.5 2.5 7 1.5 2.5 -1\n8 0 2 0 0 1 2 3 9 a one.jpg\n\n";
    let points = "# Points\n7 1.0 -2.0 3.5 255 0 7 0.5 1 0 1 0 1 0\n8 0.25 0.5 0.75 1 2 3 0.5\n";
    [("cameras.txt", cameras.into()), ("images.txt", images.into()), ("points3D.txt", points.into())]
}

/// A capture folder with these files in `model` below it.
fn folder<B: AsRef<[u8]>>(model: &str, files: &[(&str, B)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join(model)).unwrap();
    for (name, bytes) in files {
        fs::write(folder.path().join(model).join(name), bytes).unwrap();
    }
    folder
}

/// The error message of a small model with one file replaced; it must name that file.
fn message_with(name: &str, bytes: &[u8]) -> String {
    let folder = folder("sparse/0", &small_model());
    let replaced = folder.path().join("sparse/0").join(name);
    fs::write(&replaced, bytes).unwrap();
    let message = load(folder.path()).unwrap_err().to_string();
    assert!(message.contains(&replaced.display().to_string()), "{message}");
    message
}

fn check_small(capture: &Capture, root: &Path) {
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a one.jpg", "b/two.jpg"]);
    assert_eq!(capture.views[1].image_path, root.join("images/b/two.jpg"));
    assert_eq!(capture.views[1].intrinsics.fy, 51.0);
    assert_eq!(capture.views[0].intrinsics.fy, 100.0);
    assert_eq!((capture.views[0].intrinsics.width, capture.views[0].intrinsics.height), (80, 60));
    let seen = capture.views[0].cam_from_world.transform_point3(DVec3::new(5.0, 6.0, 7.0));
    assert!(seen.distance(DVec3::new(6.0, -4.0, -4.0)) < 1e-12, "half a turn about x, then t: {seen}");
    assert_eq!(capture.points.positions, [[1.0, -2.0, 3.5], [0.25, 0.5, 0.75]]);
    assert_eq!(capture.points.colours, [[255, 0, 7], [1, 2, 3]]);
    assert_eq!(capture.origin, DVec3::ZERO);
}

#[test]
fn a_binary_model_loads() {
    let folder = folder("sparse/0", &small_model());
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn a_text_model_loads_to_the_same() {
    let folder = folder("sparse/0", &small_model_as_text());
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn a_model_may_lie_directly_in_sparse() {
    let folder = folder("sparse", &small_model());
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn of_several_models_the_largest_is_taken_and_said() {
    let single = [image(3, looking_from([9.0; 3]), 4, b"other.jpg")];
    let put = |root: &Path, model: &str, images: Option<&[Vec<u8>]>| {
        let model = root.join("sparse").join(model);
        fs::create_dir_all(&model).unwrap();
        for (name, bytes) in small_model() {
            let bytes = images.filter(|_| name == "images.bin").map_or(bytes, file);
            fs::write(model.join(name), bytes).unwrap();
        }
    };
    let root = tempfile::tempdir().unwrap();
    put(root.path(), "0", Some(&single));
    put(root.path(), "10", None);
    put(root.path(), "2", None);
    // The first is not a model, the second is incomplete.
    fs::create_dir_all(root.path().join("sparse/geo")).unwrap();
    fs::create_dir_all(root.path().join("sparse/1")).unwrap();
    let capture = load(root.path()).unwrap();
    check_small(&capture, root.path());
    let remark = capture.remarks.join("");
    assert!(remark.contains("3 models: sparse/2, the largest, is taken, with 2 photographs"), "{remark}");
    assert!(remark.contains("sparse/10 has 2") && remark.contains("sparse/0 has 1"), "{remark}");
    fs::remove_dir_all(root.path().join("sparse/2")).unwrap();
    fs::remove_dir_all(root.path().join("sparse/10")).unwrap();
    let capture = load(root.path()).unwrap();
    assert_eq!((capture.views.len(), capture.remarks.len()), (1, 0));
    // An unreadable model is not skipped.
    put(root.path(), "2", None);
    fs::write(root.path().join("sparse/2/images.bin"), [1, 2]).unwrap();
    assert!(load(root.path()).unwrap_err().to_string().contains("sparse/2"));
}

#[test]
fn a_model_need_not_have_the_number_zero() {
    let folder = folder("sparse/3", &small_model());
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn binary_comes_before_text_but_half_a_binary_model_does_not() {
    let folder = folder("sparse/0", &small_model());
    let model = folder.path().join("sparse/0");
    fs::write(model.join("cameras.txt"), "nonsense").unwrap();
    fs::write(model.join("images.txt"), "nonsense").unwrap();
    check_small(&load(folder.path()).unwrap(), folder.path());
    for (name, text) in small_model_as_text() {
        fs::write(model.join(name), text).unwrap();
    }
    fs::remove_file(model.join("images.bin")).unwrap();
    fs::write(model.join("cameras.bin"), "nonsense").unwrap();
    fs::write(model.join("points3D.bin"), "nonsense").unwrap();
    check_small(&load(folder.path()).unwrap(), folder.path());
}

#[test]
fn without_points_the_cloud_is_empty() {
    let folder = folder("sparse/0", &small_model()[..2]);
    let capture = load(folder.path()).unwrap();
    assert_eq!((capture.views.len(), capture.points), (2, PointCloud::default()));
}

/// Image 2 is the second view by name, image 8 the first; both have two keypoints.
#[test]
fn tracks_lead_to_views_and_keypoints() {
    let mut seen = point([1.0, -2.0, 3.5], [255, 0, 7], 0);
    seen.truncate(seen.len() - 8);
    seen.extend(5_u64.to_le_bytes());
    // The track includes an image and a keypoint that do not exist.
    seen.extend([2_u32, 1, 8, 0, 3, 0, 8, 2, 2, 0].map(u32::to_le_bytes).concat());
    let [cameras, images, _] = small_model();
    let points = ("points3D.bin", file(&[point([0.25, 0.5, 0.75], [1, 2, 3], 0), seen]));
    let binary = folder("sparse/0", &[cameras, images, points]);
    let [cameras, images, _] = small_model_as_text();
    let points = "8 0.25 0.5 0.75 1 2 3 -1\n7 1 -2 3.5 255 0 7 0.5 2 1 8 0 3 0 8 2 2 0\n";
    let keypoints = "\n1.5 2.5 7 1.5 2.5 -1\n";
    let images = (images.0, images.1.replace("a one.jpg\n\n", &format!("a one.jpg{keypoints}")));
    let text = folder("sparse/0", &[cameras, images, ("points3D.txt", points.into())]);
    for (root, unknown) in [(&binary, Some(0.5)), (&text, None)] {
        let Capture { tracks, .. } = load(root.path()).unwrap();
        let observation = |view| Observation { view, at_px: [1.5, 2.5] };
        assert_eq!(tracks.of(1), [1, 0, 1].map(observation));
        assert!(tracks.of(0).is_empty() && tracks.of(2).is_empty());
        assert_eq!(tracks.observations(), 3);
        assert_eq!([0, 1].map(|point| tracks.stated_error_px(point)), [unknown, Some(0.5)]);
    }
}

#[test]
fn tracks_that_are_no_numbers_are_refused() {
    for (track, found) in [("2 x", "\"x\""), ("2", "missing"), ("2 -1", "\"-1\""), ("2 0 7", "missing")] {
        let folder = folder("sparse/0", &small_model_as_text());
        fs::write(folder.path().join("sparse/0/points3D.txt"), format!("7 1 2 3 4 5 6 0.5 {track}\n")).unwrap();
        let message = load(folder.path()).unwrap_err().to_string();
        assert_says(&message, &["points3D.txt", "point on line 1", "`TRACK`", found]);
    }
}

#[test]
fn missing_files_are_named_in_both_encodings() {
    for (kept, absent) in [(0, "images"), (1, "cameras")] {
        let folder = folder("sparse/0", &small_model()[kept..=kept]);
        let message = load(folder.path()).unwrap_err().to_string();
        let path = |extension| folder.path().join("sparse/0").join(absent).with_extension(extension);
        let (bin, txt) = (path("bin").display().to_string(), path("txt").display().to_string());
        assert_says(&message, &[&bin, &txt, "model_converter"]);
        assert_says(&message, &[&format!("no {absent} found")]);
    }
    let message = load(Path::new("/nowhere")).unwrap_err().to_string();
    assert_says(&message, &["/nowhere/sparse/cameras.bin", "/nowhere/sparse/images.txt", "`images/` and `sparse/0/`"]);
}

#[test]
fn cameras_and_images_of_different_encodings_are_refused() {
    let folder = folder("sparse/0", &small_model()[..1]);
    fs::write(folder.path().join("sparse/0/images.txt"), &small_model_as_text()[1].1).unwrap();
    let message = load(folder.path()).unwrap_err().to_string();
    assert_says(&message, &["of one encoding", "images.bin", "cameras.txt"]);
}

#[test]
fn a_folder_in_a_files_place_is_refused() {
    let folder = folder("sparse/0", &small_model());
    let file = folder.path().join("sparse/0/points3D.bin");
    fs::remove_file(&file).unwrap();
    fs::create_dir(&file).unwrap();
    let message = load(folder.path()).unwrap_err().to_string();
    assert_says(&message, &[&file.display().to_string(), "not a regular file", "ordinary file"]);
}

#[test]
fn a_model_without_images_is_refused() {
    assert_says(&message_with("images.bin", &file(&[])), &["no images", "Run the reconstruction again"]);
}

/// The same capture, offset like a geo-referenced one.
#[test]
fn a_capture_far_from_zero_is_moved_next_to_it() {
    let offset = DVec3::new(6.4e6, -2.5e5, 1.25e5);
    let centres = [[1.25, 0.0, 0.0], [-1.0, 2.0, 0.5], [0.0, -2.0, 0.25]];
    let make = |offset: DVec3| {
        let entry = |(i, centre): (u32, &[f64; 3])| {
            let centre = (DVec3::from_array(*centre) + offset).to_array();
            image(i, looking_from(centre), 4, format!("{i}.jpg").as_bytes())
        };
        let images: Vec<Vec<u8>> = (0..).zip(&centres).map(entry).collect();
        let position = (DVec3::new(0.125, -0.375, 4.5) + offset).to_array();
        let [cameras, _, _] = small_model();
        folder(
            "sparse/0",
            &[cameras, ("images.bin", file(&images)), ("points3D.bin", file(&[point(position, [1, 2, 3], 0)]))],
        )
    };
    let (near, far) = (make(DVec3::ZERO), make(offset));
    let (near, far) = (load(near.path()).unwrap(), load(far.path()).unwrap());
    assert_eq!(near.origin, DVec3::ZERO);
    assert_eq!(far.origin, offset, "the mean of the centres rounds to zero");
    assert_eq!(far.points, near.points, "these positions are exact in f64 and in f32");
    for (near, far) in near.views.iter().zip(&far.views) {
        assert!(far.cam_from_world.abs_diff_eq(near.cam_from_world, 1e-9), "{far:?}");
    }
}
