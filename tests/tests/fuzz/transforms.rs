//! The reader of captures in JSON, and checks of its results.

use std::collections::HashSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

use glam::{DMat3, DVec3};
use splat_demo::{self as demo, DemoOptions};
use splat_model::capture::{Capture, Split};
use splat_model::effects::masks;

use super::engine::{FuzzTarget, folder};
use super::split;
use super::targets::{bucket, judge_message, shape};

/// A folder with `transforms.json` and a file of points: one of the two is the input, the other is valid. The first byte of the
/// input says which.
pub struct Transforms {
    name: &'static str,
    folder: PathBuf,
    /// Index of the file that holds the input; 2 if both are valid.
    changed: usize,
}

const FILES: [&str; 2] = ["transforms.json", "points.ply"];

const JSON: &str = r#"{"camera_model": "OPENCV", "fl_x": 50.0, "cx": 20, "k1": 0.01, "p2": -1e-3, "w": 40, "h": 30,
 "ply_file_path": "points.ply", "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]],
 "train_filenames": ["./images/0000.png"], "test_filenames": ["images/0001"],
 "frames": [
  {"file_path": "./images/0000.png", "transform_matrix": [[0, 0, 1, 4e6], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]]},
  {"file_path": "images/0001", "fl_x": 51, "mask_path": "masks/01.png", "depth_file_path": "d.png", "colmap_im_id": 7,
   "transform_matrix": [[0.6, -0.8, 0, 4000001], [0.8, 0.6, 0, 0], [0, 0, 1, -2]]}
 ]}"#;

const BLENDER: &str = r#"{"camera_angle_x": 0.6911112070083618, "frames": [
  {"file_path": "./images/0001", "rotation": 0.01, "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]}]}"#;

const POINTS: &str = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty float y\nproperty int z\n\
                      property uchar red\nproperty float green\nproperty ushort blue\nend_header\n\
                      4000001.5 2 3 255 0.5 7\n1e3 -0.5 0 0 0 65535\n";

impl Transforms {
    pub fn new(name: &'static str) -> Self {
        let folder = folder(name);
        let options = DemoOptions { width: 40, height: 30, views: 2, points: 1, ..DemoOptions::default() };
        demo::write(&folder, &options).expect("the target folder can be written to");
        // The reader would prefer a COLMAP model.
        fs::remove_dir_all(folder.join("sparse")).expect("written by the line above");
        let mut target = Self { name, folder, changed: 2 };
        (0..2).for_each(|part| target.write(part, Self::valid(part)));
        target
    }

    fn valid(part: usize) -> &'static [u8] {
        [JSON, POINTS][part].as_bytes()
    }

    fn write(&mut self, part: usize, bytes: &[u8]) {
        fs::write(self.folder.join(FILES[part]), bytes).expect("the target folder can be written to");
    }

    fn part(input: &[u8]) -> usize {
        usize::from(input.first().copied().unwrap_or_default()) % 2
    }
}

/// Checks that a capture is consistent.
pub fn judge(capture: &Capture) -> Result<(), String> {
    let below = |path: &Path| {
        let below = path.strip_prefix(&capture.folder);
        below.is_ok_and(|path| path.components().all(|part| matches!(part, Component::Normal(_))))
    };
    let poses = capture.views.iter().all(|view| {
        let rotation = view.cam_from_world.matrix3;
        let strays = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
        view.cam_from_world.is_finite() && strays.iter().all(|value| value.abs() < 1e-12)
    });
    let lenses = capture.views.iter().all(|view| {
        let camera = view.intrinsics;
        let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
        numbers.iter().chain(&camera.distortion).all(|value| value.is_finite()) && camera.fx > 0.0 && camera.fy > 0.0
    });
    let names: HashSet<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    let points = capture.points.positions.as_flattened().iter().all(|value| value.is_finite());
    let Split { train, test } = Split::of(capture, None);
    let mut split = [train, test].concat();
    split.sort_unstable();
    match () {
        () if capture.views.is_empty() => Err("no views".into()),
        // Six views of a panorama have its name in common.
        () if !capture.views.windows(2).all(|pair| pair[0].photograph() <= pair[1].photograph()) => {
            Err("names are not sorted".into())
        }
        () if names.len() != capture.views.len() => Err("names are not unique".into()),
        () if !(poses && lenses && points && capture.origin.is_finite()) => Err("a number is invalid".into()),
        () if !capture.views.iter().all(|view| below(&view.image_path)) => Err("a picture outside".into()),
        () if !masks::find(capture).iter().flatten().all(|path| below(path)) => Err("a mask outside".into()),
        () if capture.masks.len() != capture.views.len() => Err("masks of other views".into()),
        () if !split.windows(2).all(|pair| pair[0] < pair[1]) => Err("a view occurs twice in the split".into()),
        () if split.last().is_some_and(|&last| last >= capture.views.len()) => Err("no such view".into()),
        () if capture.points.positions.len() != capture.points.colours.len() => Err("points without colours".into()),
        () => Ok(()),
    }
}

impl FuzzTarget for Transforms {
    fn name(&self) -> &'static str {
        self.name
    }

    fn seeds(&self) -> Vec<Vec<u8>> {
        // Files of Windows: backslashes, a byte order mark, UTF-16; pictures in another letter case; colours of other names.
        let backslashes = JSON.replace("images/", "images\\\\").replace("masks/", "masks\\\\");
        let marked = format!("\u{feff}{}", BLENDER.replace("./images/0001", "Images/0001.PNG"));
        let wide: Vec<u8> = format!("\u{feff}{BLENDER}").encode_utf16().flat_map(u16::to_le_bytes).collect();
        let renamed =
            POINTS.replace("uchar red", "float r").replace("float green", "float g").replace("ushort blue", "float b");
        let texts = [(0, JSON), (0, BLENDER), (0, &backslashes), (0, &marked), (1, POINTS), (1, &renamed)];
        let texts = texts.map(|(part, text)| [&[part], text.as_bytes()].concat());
        texts.into_iter().chain([[vec![0], wide].concat()]).collect()
    }

    fn words(&self) -> &'static [&'static str] {
        &[
            "{",
            "}",
            "[",
            "]",
            "[[[[[[[[[[[[[[[[",
            ":",
            ",",
            "\"",
            "\\u0000",
            "\\ud800",
            "null",
            "true",
            "NaN",
            "1e999",
            "1e308",
            "-1",
            "0",
            "\"frames\"",
            "\"file_path\"",
            "\"transform_matrix\"",
            "\"mask_path\"",
            "\"camera_angle_x\"",
            "\"camera_model\"",
            "\"FULL_OPENCV\"",
            "\"OPENCV_FISHEYE\"",
            "\"is_fisheye\"",
            "\"k4\"",
            "\"val_filenames\"",
            "\"../../x.png\"",
            "\"/etc/passwd\"",
            "\"images/0000.png\"",
            "\"\"",
            "\u{feff}",
            "element vertex 18446744073709551615\n",
            "property list uchar int i\n",
            "property double red\n",
            "inf",
            "format binary_little_endian 1.0\n",
        ]
    }

    fn split(&self, input: &[u8]) -> Vec<Vec<u8>> {
        let Some((first, rest)) = input.split_first() else { return Vec::new() };
        let fields = if Self::part(input) == 0 { split::text(rest) } else { split::ply(rest) };
        // The first byte is part of the first field.
        let mut fields = fields.into_iter();
        let head = [&[*first], &fields.next().unwrap_or_default()[..]].concat();
        std::iter::once(head).chain(fields).collect()
    }

    fn place(&mut self, input: &[u8]) {
        let changed = Self::part(input);
        if self.changed != changed && self.changed < 2 {
            self.write(self.changed, Self::valid(self.changed));
        }
        self.write(changed, input.get(1..).unwrap_or_default());
        self.changed = changed;
    }

    fn read(&mut self) -> Result<String, String> {
        match Capture::load(&self.folder) {
            Ok(capture) => {
                judge(&capture)?;
                let (views, points) = (bucket(capture.views.len()), bucket(capture.points.positions.len()));
                let (own, far) = (capture.split.is_some(), capture.origin != DVec3::ZERO);
                let model = capture.views[0].intrinsics.model;
                Ok(format!("accepted: 2^{views} views ({model:?}), 2^{points} points, split {own}, origin {far}"))
            }
            Err(error) => {
                let message = error.to_string();
                judge_message(&message, &self.folder)?;
                Ok(shape(&message, &self.folder))
            }
        }
    }
}
