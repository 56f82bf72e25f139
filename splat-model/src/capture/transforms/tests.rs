//! Tests of files in every variant, of refused files, and of a real capture.

mod lenses;
mod refused;

use std::fs;

use glam::{DMat3, DVec2, DVec3};
use splat_op::CameraModel;

use super::*;
use crate::capture::image as photos;
use crate::capture::masks;
use crate::capture::testing::real_capture;

/// A camera at (1, 2, 3) that looks along −x, with the world's y to its right and the world's z up.
const LOOKING_BACK: &str = "[[0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]";

/// A folder with these files. A file with an empty text is a picture of 8 × 6 px.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        match text.is_empty() {
            true => ::image::RgbImage::new(8, 6).save(&path).unwrap(),
            false => fs::write(&path, text).unwrap(),
        }
    }
    folder
}

fn frame(path: &str) -> String {
    format!(r#"{{"file_path": "{path}", "transform_matrix": {LOOKING_BACK}}}"#)
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.views.iter().map(|view| view.name.as_str()).collect()
}

/// Loads a capture of one `transforms.json`, which states the size of every picture that it names.
fn single(text: &str) -> Result<Capture, CaptureError> {
    Capture::load(folder(&[(SINGLE, text)]).path())
}

#[test]
fn a_pose_is_what_was_worked_out_by_hand() {
    let text = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame("a.png"));
    let capture = single(&text).unwrap();
    let pose = capture.views[0].cam_from_world;
    // Rows: right, down and forward in the world. Translation: −R (1, 2, 3).
    let rows = [DVec3::Y, DVec3::NEG_Z, DVec3::NEG_X];
    assert_eq!([0, 1, 2].map(|row| pose.matrix3.row(row)), rows);
    assert_eq!(pose.translation, DVec3::new(-2.0, 3.0, 1.0));
    // Five ahead, one to the right, half a unit up.
    assert_eq!(pose.transform_point3(DVec3::new(-4.0, 3.0, 3.5)), DVec3::new(1.0, -0.5, 5.0));
}

#[test]
fn a_camera_that_looks_at_a_point_has_it_in_the_middle_of_its_picture() {
    let (eye, target) = (DVec3::new(0.3, -2.0, 1.7), DVec3::new(0.1, 0.4, 0.9));
    let back = (eye - target).normalize();
    let right = DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    // Some exporters round to three digits; the reader must restore a rotation.
    let row = |axis: usize| format!("[{:.3}, {:.3}, {:.3}, {}]", right[axis], up[axis], back[axis], eye[axis]);
    let matrix = format!("[{}, {}, {}]", row(0), row(1), row(2));
    let text = format!(
        r#"{{"w": 80, "h": 60, "fl_x": 100, "frames": [{{"file_path": "a.png", "transform_matrix": {matrix}}}]}}"#
    );
    let view = &single(&text).unwrap().views[0];
    let rotation = view.cam_from_world.matrix3;
    let strays = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    assert!(strays.iter().all(|value| value.abs() < 1e-14), "{strays:?}");
    assert!((view.cam_from_world.inverse().translation - eye).length() < 1e-14);
    let px =
        |world: DVec3| view.intrinsics.projector().px_from_cam(view.cam_from_world.transform_point3(world)).unwrap();
    let depth = eye.distance(target);
    for (world, expected) in [
        (target, DVec2::new(40.0, 30.0)),
        (target + right * (0.1 * depth), DVec2::new(50.0, 30.0)),
        (target + up * (0.1 * depth), DVec2::new(40.0, 20.0)),
    ] {
        assert!(px(world).distance(expected) < 0.15, "{} instead of {expected}", px(world));
    }
}

#[test]
fn nerf_synthetic_loads_with_its_split() {
    // f = (8/2) / tan(angle/2) = 8 px.
    let angle = 2.0 * 0.5_f64.atan();
    let file = |frames: &[&str]| {
        let frames: Vec<String> = frames.iter().map(|path| frame(path)).collect();
        format!(r#"{{"camera_angle_x": {angle}, "frames": [{}]}}"#, frames.join(", "))
    };
    let files = [
        (TRAIN, file(&["./train/r_1", "./train/r_0"])),
        ("transforms_test.json", file(&["./test/r_0"])),
        ("transforms_val.json", file(&["./val/r_0"])),
        ("train/r_0.png", String::new()),
        ("train/r_1.jpg", String::new()),
        ("test/r_0.jpeg", String::new()),
        ("val/r_0.png", String::new()),
    ];
    let files = files.each_ref().map(|(name, text)| (*name, text.as_str()));
    let root = folder(&files);
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!(names(&capture), ["test/r_0.jpeg", "train/r_0.png", "train/r_1.jpg"]);
    assert_eq!(capture.files, [TRAIN, "transforms_test.json"].map(|name| root.path().join(name)));
    assert_eq!(capture.split, Some(Split { train: vec![1, 2], test: vec![0] }));
    assert_eq!(capture.views[2].image_path, root.path().join("train/r_1.jpg"));
    let camera = capture.views[0].intrinsics;
    assert_eq!((camera.model, camera.width, camera.height), (CameraModel::Pinhole, 8, 6));
    assert!((camera.fx - 8.0).abs() < 1e-12 && camera.fx == camera.fy && (camera.cx, camera.cy) == (4.0, 3.0));
    assert!(capture.points.positions.is_empty());
    assert_eq!(photos::load_all(&capture.views, None, |_| ()).unwrap().len(), 3);

    // A given interval takes precedence. Without test photographs, the validation photographs are held out.
    assert_eq!(Split::of(&capture, None).test, [0]);
    assert_eq!(Split::of(&capture, Some(2)).test, [0, 2]);
    fs::remove_file(root.path().join("transforms_test.json")).unwrap();
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!(names(&capture), ["train/r_0.png", "train/r_1.jpg", "val/r_0.png"]);
    assert_eq!(capture.split, Some(Split { train: vec![0, 1], test: vec![2] }));
    fs::remove_file(root.path().join("transforms_val.json")).unwrap();
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!((capture.split.as_ref(), Split::of(&capture, None).test), (None, vec![0]), "no split in the files");
}

#[test]
fn the_lists_of_nerfstudio_are_the_split() {
    let split = |lists: &str| {
        let frames = ["images/d.png", "./images/b.png", "images/c.png", "images/a.png"].map(frame).join(", ");
        let text = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, {lists} "frames": [{frames}]}}"#);
        single(&text).map(|capture| capture.split).map_err(|error| error.to_string())
    };
    let made = |train: &[usize], test: &[usize]| Ok(Some(Split { train: train.to_vec(), test: test.to_vec() }));
    assert_eq!(split(""), Ok(None));
    let train = r#""train_filenames": ["images/b.png", "./images/d.png"],"#;
    let (val, test) = (r#""val_filenames": ["images/c.png"],"#, r#""test_filenames": ["images/a.png"],"#);
    assert_eq!(split(&[train, val, test].concat()), made(&[1, 3], &[0]), "c is for validation alone");
    assert_eq!(split(&[train, val].concat()), made(&[1, 3], &[2]));
    assert_eq!(split(&[train, val, r#""test_filenames": [],"#].concat()), made(&[1, 3], &[2]));
    assert_eq!(split(train), made(&[1, 3], &[0, 2]));
    assert_eq!(split(&[val, test].concat()), made(&[1, 3], &[0]));
    let both = split(&[train, r#""test_filenames": ["images/d.png"],"#].concat()).unwrap_err();
    assert!(both.contains("train_filenames") && both.contains("images/d.png"), "{both}");
    let unknown = split(r#""test_filenames": ["images/x.png"],"#).unwrap_err();
    assert!(unknown.contains("test_filenames") && unknown.contains("images/x.png"), "{unknown}");
}

#[test]
fn points_and_masks_come_with_nerfstudio() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
               property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n1 2 3 9 8 7\n4 5 6 1 2 3\n";
    let text = format!(
        r#"{{"w": 8, "h": 6, "fl_x": 8, "ply_file_path": "sparse_pc.ply", "applied_transform": [[1, 0, 0, 0]], "aabb_scale": 16,
            "frames": [{}, {{"file_path": "images/a.png", "colmap_im_id": 7, "mask_path": "./masks_of/a.png",
            "depth_file_path": "depth/a.png", "transform_matrix": {LOOKING_BACK}}}]}}"#,
        frame("images/b.png")
    );
    let root = folder(&[(SINGLE, &text), ("sparse_pc.ply", ply), ("masks_of/a.png", ""), ("masks/images/b.png", "")]);
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!(capture.points.positions, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!(capture.points.colours, [[9, 8, 7], [1, 2, 3]]);
    assert_eq!(names(&capture), ["images/a.png", "images/b.png"]);
    let found = masks::find(&capture);
    assert_eq!(found, ["masks_of/a.png", "masks/images/b.png"].map(|name| Some(root.path().join(name))));
}

#[test]
fn files_are_found_by_the_names_that_other_systems_write() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
    let frames = [frame("images\\\\a.png"), frame(".\\\\IMAGES\\\\B.PNG"), frame("images/c.png"), frame("images\\\\d")];
    let masked = frames.join(", ").replacen("\"transform", "\"mask_path\": \"m\\\\a.png\", \"transform", 1);
    let text = format!(
        r#"{{"w": 8, "h": 6, "fl_x": 8, "ply_file_path": ".\\p.ply", "test_filenames": ["images\\a.png", "images/c.png"], "frames": [{masked}]}}"#
    );
    let pictures =
        [("images/a.png", ""), ("images/b.png", ""), ("images/c.png.png", ""), ("images/d.jpg", ""), ("m/a.png", "")];
    let root = folder(&[&[(SINGLE, text.as_str()), ("p.ply", ply)][..], &pictures].concat());
    // In UTF-16 with a mark, as PowerShell writes it, too.
    let wide: Vec<u8> = format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    for bytes in [text.clone().into_bytes(), format!("\u{feff}{text}").into_bytes(), wide] {
        fs::write(root.path().join(SINGLE), bytes).unwrap();
        let capture = Capture::load(root.path()).unwrap();
        assert_eq!(names(&capture), ["images/a.png", "images/b.png", "images/c.png.png", "images/d.jpg"]);
        assert_eq!(capture.split, Some(Split { train: vec![1, 3], test: vec![0, 2] }));
        assert_eq!(capture.points.positions, [[1.0, 2.0, 3.0]]);
        assert_eq!(masks::find(&capture)[0], Some(root.path().join("m/a.png")));
        assert_eq!(photos::load_all(&capture.views, None, |_| ()).unwrap().len(), 4);
    }
}

#[test]
fn test_frames_without_pictures_are_left_out() {
    let file = |path: &str| format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame(path));
    let files = [
        (TRAIN, file("a.png")),
        ("transforms_test.json", file("test/a.png")),
        ("transforms_val.json", file("val/a.png")),
    ];
    let files = files.each_ref().map(|(name, text)| (*name, text.as_str()));
    let root = folder(&[&files[..], &[("a.png", "")]].concat());
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!((names(&capture), &capture.split), (vec!["a.png"], &None));
    assert_eq!(capture.remarks.len(), 2, "{:?}", capture.remarks);
    for (remark, part) in
        capture.remarks.iter().zip(["transforms_test.json is left out", "transforms_val.json is left out"])
    {
        assert!(remark.contains(part) && remark.contains("none of its 1 pictures"), "{remark}");
    }
    // With the pictures for validation, these are held out.
    fs::create_dir(root.path().join("val")).unwrap();
    fs::copy(root.path().join("a.png"), root.path().join("val/a.png")).unwrap();
    let capture = Capture::load(root.path()).unwrap();
    assert_eq!(capture.split, Some(Split { train: vec![0], test: vec![1] }));
}

#[test]
fn far_away_both_points_and_cameras_move() {
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n\
               end_header\n4000005.25 2 3\n";
    let matrix = LOOKING_BACK.replace("[0, 0, 1, 1]", "[0, 0, 1, 4e6]");
    let text = format!(
        r#"{{"w": 8, "h": 6, "fl_x": 8, "ply_file_path": "p.ply", "frames": [{{"file_path": "a.png", "transform_matrix": {matrix}}}]}}"#
    );
    let capture = Capture::load(folder(&[(SINGLE, &text), ("p.ply", ply)]).path()).unwrap();
    assert_eq!(capture.origin, DVec3::new(4e6, 2.0, 3.0));
    assert_eq!(capture.points.positions, [[5.25, 0.0, 0.0]]);
    assert_eq!(capture.views[0].cam_from_world.inverse().translation, DVec3::ZERO);
}

#[test]
fn a_complete_colmap_model_comes_first() {
    let text = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame("json.png"));
    let cameras = ("sparse/0/cameras.txt", "1 PINHOLE 8 6 8 8 4 3\n");
    let root = folder(&[(SINGLE, &text), cameras]);
    assert_eq!(names(&Capture::load(root.path()).unwrap()), ["json.png"], "a model without images is not used");
    fs::write(root.path().join("sparse/0/images.txt"), "1 1 0 0 0 0 0 0 1 colmap.png\n\n").unwrap();
    assert_eq!(names(&Capture::load(root.path()).unwrap()), ["colmap.png"]);
}

#[test]
fn the_real_lego_has_its_split_and_alpha() {
    let Some(root) = real_capture("lego_alpha") else { return };
    let capture = Capture::load(&root).unwrap();
    let split = capture.split.clone().unwrap();
    assert_eq!((capture.views.len(), split.train.len(), split.test.len()), (100, 88, 12));
    assert!(split.test.iter().all(|&view| capture.views[view].name.starts_with("test/r_")));
    assert!(split.train.iter().all(|&view| capture.views[view].name.starts_with("train/r_")));
    for view in &capture.views {
        let camera = view.intrinsics;
        assert_eq!((camera.width, camera.height), (400, 400));
        // 200 / tan(0.6911112 / 2), half of the usual 1111.11 px for 800 px.
        assert!((camera.fx - 555.555_5).abs() < 1e-3, "{}", camera.fx);
        let middle = view.cam_from_world.transform_point3(DVec3::ZERO);
        assert!((middle.z - 4.031).abs() < 0.01 && middle.truncate().length() < 0.05, "{}: {middle}", view.name);
    }
    let photo = photos::load(&capture.views[split.test[0]], None).unwrap();
    assert!(photo.alpha.is_some_and(|alpha| alpha.contains(&0) && alpha.contains(&255)));
}
