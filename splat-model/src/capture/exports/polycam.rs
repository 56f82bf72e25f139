//! Raw data of Polycam: `keyframes/` with a JSON file for each photograph.
//!
//! Format: <https://github.com/PolyCam/polyform>, and nerfstudio's `process_data/polycam_utils.py`. `t_ij` is row `i` and column `j` of the pose,
//! world-from-camera with ARKit's axes, which are OpenGL's. The world's +y is up, its unit a metre. Poses that the app has optimised are in
//! `corrected_cameras`, with the undistorted `corrected_images`, and others in `cameras`, with `images`.

use std::path::{Path, PathBuf};

use glam::DMat4;
use serde_json::{Map, Value};

use super::{Format, Photographs, frame};
use crate::capture::Result;
use crate::capture::names::entries;
use crate::capture::read::{Place, PlaceInFile};
use crate::capture::transforms::{Fields, holds, read_json};

pub(super) const FORMAT: Format = Format { name: "Polycam", is, frames };

const FIELDS: [&str; 18] = [
    "t_00", "t_01", "t_02", "t_03", "t_10", "t_11", "t_12", "t_13", "t_20", "t_21", "t_22", "t_23", "fx", "fy", "cx",
    "cy", "width", "height",
];

/// The folder of the photographs of a folder of cameras; `None` if it is none, or if there are better poses.
fn images(cameras: &Path) -> Option<&'static str> {
    match cameras.file_name()?.to_str()? {
        "corrected_cameras" => Some("corrected_images"),
        "cameras" if !cameras.with_file_name("corrected_cameras").is_dir() => Some("images"),
        _ => None,
    }
}

fn is(cameras: &Path) -> bool {
    let has_images = images(cameras).is_some_and(|images| cameras.with_file_name(images).is_dir());
    has_images && files(cameras).first().is_some_and(|file| holds(file, "json", &["\"t_00\""]))
}

/// The JSON files of a folder, without those that macOS adds to archives.
fn files(folder: &Path) -> Vec<PathBuf> {
    let is_hidden = |file: &Path| file.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    let is_camera = |file: &PathBuf| file.extension().is_some_and(|kind| kind == "json") && !is_hidden(file);
    let mut files: Vec<PathBuf> = entries(folder).filter(is_camera).collect();
    files.sort();
    files
}

fn frames(cameras: &Path, photographs: &mut Photographs) -> Result<Vec<Fields>> {
    let images = images(cameras).unwrap_or_default();
    let one = |file: PathBuf| {
        let of: Map<String, Value> = read_json(&file)?;
        let (place, mut numbers) = (Place::new(&file, PlaceInFile::Whole), [0.0; FIELDS.len()]);
        for (number, field) in numbers.iter_mut().zip(FIELDS) {
            let value = of.get(field).and_then(Value::as_f64);
            *number = value.ok_or_else(|| place.refuse(field, "missing or not a number", "a number"))?;
        }
        let [pose @ .., fx, fy, cx, cy, width, height] = numbers;
        let mut rows = DMat4::IDENTITY.to_cols_array();
        rows[..12].copy_from_slice(&pose);
        let name = photographs.find(&format!("{images}/{}", file.file_stem().unwrap_or_default().to_string_lossy()));
        let pose = DMat4::from_cols_array(&rows).transpose();
        Ok(frame(name, pose, [fx, fy, cx, cy], Some([width, height])))
    };
    files(cameras).into_iter().map(one).collect()
}
