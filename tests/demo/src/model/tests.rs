use std::fs;

use glam::{DAffine3, DVec3};
use splat_model::capture::Capture;

use super::*;
use crate::{DemoOptions, write};

/// Views and points of a demo without tracks.
fn small_capture() -> Capture {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 32, height: 24, views: 3, points: 20, ..DemoOptions::PLAIN };
    write(folder.path(), &options).unwrap();
    Capture { tracks: Tracks::default(), ..Capture::load(folder.path()).unwrap() }
}

fn read(folder: &Path) -> Capture {
    fs::create_dir_all(folder.join("images")).unwrap();
    Capture::load(folder).unwrap()
}

fn assert_same(read: &Capture, written: &Capture) {
    assert_eq!(read.points, written.points);
    assert_eq!(read.views.len(), written.views.len());
    for (read, written) in read.views.iter().zip(&written.views) {
        assert_eq!((&read.name, read.intrinsics), (&written.name, written.intrinsics));
        assert!(read.cam_from_world.abs_diff_eq(written.cam_from_world, 1e-12), "{read:?} {written:?}");
    }
}

#[test]
fn what_was_written_reads_the_same() {
    let written = small_capture();
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path(), &written.views, &written.points, &written.tracks).unwrap();
    assert_same(&read(folder.path()), &written);
    let mut names: Vec<_> =
        fs::read_dir(folder.path().join("sparse/0")).unwrap().map(|f| f.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["cameras.bin", "images.bin", "points3D.bin"], "no temporary file is left");
    assert_eq!(fs::metadata(folder.path().join("sparse/0/cameras.bin")).unwrap().len(), 8 + 56, "one camera");
}

#[test]
fn every_lens_survives() {
    let mut written = small_capture();
    for model in [CameraModel::OpenCv, CameraModel::FullOpenCv, CameraModel::Fisheye, CameraModel::ThinPrismFisheye] {
        let mut distortion = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
        distortion[model.coefficients()..].fill(0.0);
        let intrinsics = &mut written.views[0].intrinsics;
        (intrinsics.model, intrinsics.distortion) = (model, distortion);
        let folder = tempfile::tempdir().unwrap();
        write_model(folder.path(), &written.views, &written.points, &written.tracks).unwrap();
        assert_same(&read(folder.path()), &written);
    }
}

#[test]
fn any_rotation_survives() {
    let mut written = Capture { points: PointCloud::default(), ..small_capture() };
    for i in 0..50 {
        let angle_rad = f64::from(i) * 0.44;
        let axis = DVec3::new(angle_rad.sin(), angle_rad.cos(), 0.3).normalize();
        let pose = DAffine3::from_rotation_translation(DQuat::from_axis_angle(axis, angle_rad), axis * 5.0);
        written.views.truncate(1);
        written.views[0].cam_from_world = pose;
        let folder = tempfile::tempdir().unwrap();
        write_model(folder.path(), &written.views, &written.points, &written.tracks).unwrap();
        assert_same(&read(folder.path()), &written);
    }
}

#[test]
fn tracks_read_as_they_were_written() {
    let mut written = small_capture();
    written.points.truncate(2);
    let observation = |view, x| Observation { view, at_px: [x, 2.5] };
    written.tracks.push([observation(1, 0.5), observation(0, 7.25)], 0.75);
    written.tracks.push([observation(1, 3.0)], -1.0);
    let folder = tempfile::tempdir().unwrap();
    write_model(folder.path(), &written.views, &written.points, &written.tracks).unwrap();
    let read = read(folder.path());
    assert_same(&read, &written);
    assert_eq!(read.tracks, written.tracks);
}
