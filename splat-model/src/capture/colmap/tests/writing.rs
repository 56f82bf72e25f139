use glam::{DAffine3, DMat3, DQuat};
use splat_op::CameraModel;

use super::*;

fn small_capture() -> Capture {
    let folder = folder("sparse/0", &small_model());
    load(folder.path()).unwrap()
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
    write_binary(folder.path(), &written.views, &written.points).unwrap();
    assert_same(&load(folder.path()).unwrap(), &written);
    let mut names: Vec<_> =
        fs::read_dir(folder.path().join("sparse/0")).unwrap().map(|f| f.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["cameras.bin", "images.bin", "points3D.bin"], "no temporary file is left");
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
        write_binary(folder.path(), &written.views, &written.points).unwrap();
        assert_same(&load(folder.path()).unwrap(), &written);
    }
}

#[test]
fn coefficients_that_a_model_has_not_are_not_dropped_in_silence() {
    let mut written = small_capture();
    written.views[0].intrinsics.distortion[0] = 0.1;
    let folder = tempfile::tempdir().unwrap();
    let error = write_binary(folder.path(), &written.views, &written.points).unwrap_err().to_string();
    assert!(error.contains("distortion") && error.contains("0.1") && error.contains("Set them to zero"), "{error}");
}

#[test]
fn tracks_read_as_they_were_written() {
    let written = small_capture();
    let observation = |view, x| Observation { view, at_px: [x, 2.5] };
    let mut tracks = Tracks::default();
    tracks.push([observation(1, 0.5), observation(0, 7.25)], 0.75);
    tracks.push([observation(1, 3.0)], -1.0);
    let folder = tempfile::tempdir().unwrap();
    write_binary_with_tracks(folder.path(), &written.views, &written.points, &tracks).unwrap();
    let read = load(folder.path()).unwrap();
    assert_same(&read, &written);
    assert_eq!(read.tracks, tracks);
}

#[test]
fn writing_again_replaces() {
    let written = small_capture();
    let folder = tempfile::tempdir().unwrap();
    write_binary(folder.path(), &written.views, &written.points).unwrap();
    write_binary(folder.path(), &written.views[..1], &PointCloud::default()).unwrap();
    let read = load(folder.path()).unwrap();
    assert_eq!((read.views.len(), read.points), (1, PointCloud::default()));
}

#[test]
fn equal_intrinsics_share_a_camera() {
    let mut written = small_capture();
    written.views[0].intrinsics = written.views[1].intrinsics;
    let folder = tempfile::tempdir().unwrap();
    write_binary(folder.path(), &written.views, &written.points).unwrap();
    assert_eq!(fs::metadata(folder.path().join("sparse/0/cameras.bin")).unwrap().len(), 8 + 56);
    assert_same(&load(folder.path()).unwrap(), &written);
}

#[test]
fn any_rotation_survives() {
    let mut written = small_capture();
    for i in 0..200 {
        let angle_rad = f64::from(i) * 0.11;
        let axis = DVec3::new(angle_rad.sin(), angle_rad.cos(), 0.3).normalize();
        let pose = DAffine3::from_rotation_translation(DQuat::from_axis_angle(axis, angle_rad), axis * 5.0);
        written.views[0].cam_from_world = pose;
        let folder = tempfile::tempdir().unwrap();
        write_binary(folder.path(), &written.views, &written.points).unwrap();
        assert_same(&load(folder.path()).unwrap(), &written);
    }
}

/// The error message of a refused model. Checks that nothing is written.
fn refusal(views: &[View], points: &PointCloud) -> String {
    let folder = tempfile::tempdir().unwrap();
    let message = write_binary(folder.path(), views, points).unwrap_err().to_string();
    assert!(!folder.path().join("sparse").exists(), "{message}");
    message
}

#[test]
fn what_could_not_be_read_is_not_written() {
    let good = small_capture();
    let with = |change: &dyn Fn(&mut View)| {
        let mut views = good.views.clone();
        change(&mut views[1]);
        refusal(&views, &good.points)
    };
    assert_says(&with(&|view| view.name = "../a".into()), &["images.bin", "image entry 2", "neither absolute"]);
    assert_says(&with(&|view| view.name = "a\0b".into()), &["images.bin", "`NAME`"]);
    assert_says(&with(&|view| view.name = "a one.jpg".into()), &["images.bin", "image entry 2", "again"]);
    assert_says(&with(&|view| view.intrinsics.fx = f64::NAN), &["cameras.bin", "`PARAMS` is NaN"]);
    assert_says(&with(&|view| view.intrinsics.width = 0), &["cameras.bin", "`WIDTH` is 0"]);
    let scaled = DAffine3::from_scale(DVec3::splat(2.0));
    assert_says(&with(&|view| view.cam_from_world = scaled), &["image entry 2", "expected a rotation", "rigid pose"]);
    let mirrored = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)));
    assert_says(&with(&|view| view.cam_from_world = mirrored), &["image entry 2", "expected a rotation", "rigid pose"]);
    assert_says(&with(&|view| view.cam_from_world.translation.x = f64::NAN), &["`TX` is NaN"]);
    assert_says(&refusal(&[], &good.points), &["images.bin", "no images"]);
}

#[test]
fn uneven_or_broken_clouds_are_not_written() {
    let good = small_capture();
    let mut uneven = good.points.clone();
    uneven.colours.pop();
    assert_says(&refusal(&good.views, &uneven), &["2 positions and 1 colours", "one colour for each"]);
    let mut broken = good.points.clone();
    broken.positions[1][2] = f32::NAN;
    assert_says(&refusal(&good.views, &broken), &["points3D.bin", "point entry 2", "`Z` is NaN"]);
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let good = small_capture();
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("sparse"), "in the way").unwrap();
    let message = write_binary(folder.path(), &good.views, &good.points).unwrap_err().to_string();
    assert_says(&message, &["cannot write", "sparse/0", "Check that the folder can be written to"]);
}

#[test]
fn a_failed_write_leaves_no_temporary_file() {
    let good = small_capture();
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("sparse/0");
    fs::create_dir_all(model.join("cameras.bin")).unwrap();
    let message = write_binary(folder.path(), &good.views, &good.points).unwrap_err().to_string();
    assert_says(&message, &["cannot write", "cameras.bin"]);
    assert_eq!(fs::read_dir(&model).unwrap().count(), 1);
}
