use std::fs;

use super::*;
use crate::capture::testing::assert_says;
use crate::effects::depth;
use splat_demo::{self as demo, DemoOptions};

/// A capture of three photographs, 0000.png to 0002.png, without the mark that it is a demo.
fn capture() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 32, height: 24, views: 3, points: 20, ..DemoOptions::default() };
    demo::write(folder.path(), &options).unwrap();
    let _ = fs::remove_file(folder.path().join("demo.json"));
    folder
}

fn add(folder: &Path, files: &[&str]) {
    for name in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::copy(folder.join("images/0000.png"), path).unwrap();
    }
}

fn remarks_on(folder: &Path) -> Vec<String> {
    Capture::load(folder).unwrap().remarks
}

#[test]
fn a_capture_of_which_all_is_used_has_no_remarks() {
    let folder = capture();
    assert_eq!(remarks_on(folder.path()), [""; 0]);
    add(folder.path(), &["masks/0000.png.png", "masks/0001.png", "masks/0002.PNG", "depth/0001.png"]);
    fs::write(folder.path().join("depth/depth.json"), r#"{"scale": 0.001}"#).unwrap();
    assert_eq!(remarks_on(folder.path()), [""; 0]);
}

#[test]
fn masks_and_depth_maps_of_no_photograph_are_named() {
    let folder = capture();
    add(folder.path(), &["masks/0000_mask.png", "masks/0001_mask.png", "depths/cam/0001.png"]);
    let capture = Capture::load(folder.path()).unwrap();
    let [masks, depth] = &capture.remarks[..] else { panic!("{:?}", capture.remarks) };
    let parts = [
        "masks/ holds 2 pictures",
        "none belongs to a photograph",
        "masks/0000.png.png or masks/0000.png",
        "found 0000_mask.png",
    ];
    assert_says(masks, &parts);
    assert_says(depth, &["depths/ holds 1 pictures", "depths/0000.png.png", "found cam/0001.png"]);
    assert_eq!(depth::folder(&capture), None, "maps of no photograph supervise nothing");
    assert_eq!(depth::from_maps(&capture, &[0], |_| {}).unwrap(), None);
    add(folder.path(), &["masks/0002.png"]);
    assert_says(&remarks_on(folder.path())[0], &["masks/ holds 3 pictures, and 2 of them belong to no photograph"]);
}

#[test]
fn pictures_without_cameras_are_named() {
    let folder = capture();
    add(folder.path(), &["images/0003.png"]);
    let remarks = remarks_on(folder.path());
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert_says(&remarks[0], &["without a camera", "1 in", "images/0003.png"]);
    // What this program wrote is its own.
    fs::write(folder.path().join("reconstruction.json"), "{}").unwrap();
    assert_eq!(remarks_on(folder.path()), [""; 0]);
}

#[test]
fn points_beside_a_model_without_points_are_read() {
    let folder = capture();
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
               property uchar green\nproperty uchar blue\nend_header\n1 2 3 9 8 7\n";
    fs::write(folder.path().join("Input.ply"), ply).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert!(capture.points.positions.len() > 1 && capture.remarks.is_empty(), "{:?}", capture.remarks);
    fs::remove_file(folder.path().join("sparse/0/points3D.bin")).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!(
        (&capture.points.positions[..], &capture.points.colours[..]),
        (&[[1.0, 2.0, 3.0]][..], &[[9, 8, 7]][..])
    );
    assert_says(&capture.remarks[0], &["no points", "1 are read from", "Input.ply"]);
    assert_eq!(capture.remarks.len(), 1);
    fs::write(folder.path().join("Input.ply"), "ply\n").unwrap();
    assert_says(&Capture::load(folder.path()).unwrap_err().to_string(), &["Input.ply"]);
}
