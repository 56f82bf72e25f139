//! Tests of exports: a scene is written in each format by the format's own equations, and read back.

mod metashape;
mod phones;
mod realityscan;

use std::fs;

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3, DVec4};

use super::*;
use crate::capture::testing::assert_says;

const SIZE: [f64; 2] = [80.0, 60.0];

/// World-from-camera of three cameras, with OpenGL's axes: right, up, back.
fn poses() -> [DMat4; 3] {
    [0.0, 1.0, 2.0].map(|i| {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0 - i, -0.5).normalize(), 0.7 + i);
        DMat4::from_rotation_translation(turn, DVec3::new(3.0 - i, 0.2, 0.3 * i))
    })
}

/// Points of the frame of a camera with OpenCV's axes, up to the corners of a picture of focal length 70 px.
fn points() -> impl Iterator<Item = DVec3> {
    let steps = [-0.5, -0.2, 0.1, 0.4];
    steps.into_iter().flat_map(move |x| steps.map(|y| DVec3::new(x, 0.8 * y, 1.0) * (2.0 + x)))
}

/// OpenCV's axes in OpenGL's, and the other way round.
fn flip() -> DMat4 {
    DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0))
}

/// Checks the cameras of a capture: where each shows `points()` of its pose. `expected` has OpenCV's axes.
fn assert_shows(capture: &Capture, expected: impl Fn(usize, DVec3) -> DVec2) {
    assert_eq!(capture.views.len(), 3);
    for (i, (view, pose)) in capture.views.iter().zip(poses()).enumerate() {
        for cam in points() {
            let world = (pose * flip()).transform_point3(cam) - capture.origin;
            let px = view.intrinsics.projector().px_from_cam(view.cam_from_world.transform_point3(world)).unwrap();
            assert!(px.distance(expected(i, cam)) < 1e-6, "{}: {px} instead of {}", view.name, expected(i, cam));
        }
    }
}

/// The same scene in `transforms.json`, with the fields `lens`.
fn reference(lens: &str) -> Capture {
    let frame = |(i, pose): (usize, DMat4)| {
        let rows = pose.transpose().to_cols_array_2d();
        format!(r#"{{"file_path": "{i}.png", "transform_matrix": {rows:?}}}"#)
    };
    let frames: Vec<String> = poses().into_iter().enumerate().map(frame).collect();
    let text = format!(r#"{{"w": 80, "h": 60, {lens} "frames": [{}]}}"#, frames.join(", "));
    Capture::load(folder(&[("transforms.json", &text)]).path()).unwrap()
}

/// Checks that two captures have the same cameras.
fn assert_same(capture: &Capture, reference: &Capture) {
    let camera = |view: &crate::capture::View| (view.intrinsics, view.cut.clone());
    let [of, by] = [capture, reference].map(|capture| capture.views.iter().map(camera).collect::<Vec<_>>());
    assert_eq!(of.iter().map(|of| of.0.model).collect::<Vec<_>>(), by.iter().map(|by| by.0.model).collect::<Vec<_>>());
    assert_shows(capture, |i, cam| by[i].0.projector().px_from_cam(cam).unwrap());
}

/// A folder with these files. One with an empty text is a picture of [`SIZE`].
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        match text.is_empty() {
            true => ::image::RgbImage::new(80, 60).save(&path).unwrap(),
            false => fs::write(&path, text).unwrap(),
        }
    }
    folder
}

fn names(capture: &Capture) -> Vec<&str> {
    capture.views.iter().map(|view| view.name.as_str()).collect()
}

/// Checks the message for a changed file of a capture: `from` in its text becomes `to`.
fn assert_refused(files: &[(&str, &str)], file: usize, from: &str, to: &str, parts: &[&str]) {
    let (name, text) = files[file];
    assert!(text.contains(from), "{from} is not in {text}");
    let changed = text.replacen(from, to, 1);
    let mut files = files.to_vec();
    files[file].1 = &changed;
    let message = Capture::load(folder(&files).path()).map(|capture| capture.views.len()).unwrap_err().to_string();
    assert_says(&message, &[&[name.split('/').next().unwrap()], parts].concat());
    assert!(message.len() < 1_500 && !message.contains(char::is_control), "{message}");
}
