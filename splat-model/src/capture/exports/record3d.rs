//! Exports of Record3D: an unpacked `.r3d`, with `metadata` and `rgbd/0.jpg` and so on, or EXR and JPG, with `metadata.json` and `rgb/`.
//!
//! Format: nerfstudio's `process_data/record3d_utils.py`, and the author in <https://github.com/marek-simonik/record3d/issues/27>, 36, 64, 83
//! and 99. `poses` has a quaternion, xyzw, and a position for each picture, world-from-camera with OpenGL's axes, in metres. `K` is the first
//! picture's matrix of intrinsics, column by column; `perFrameIntrinsicCoeffs` of newer versions has fx, fy, cx and cy of each.

use std::path::Path;

use glam::DMat4;
use serde::Deserialize;

use super::{Format, Photographs, frame};
use crate::capture::Result;
use crate::capture::read::{Place, PlaceInFile};
use crate::capture::transforms::{Fields, holds, read_json};

pub(super) const FORMAT: Format = Format { name: "Record3D", is, frames };

#[derive(Deserialize)]
#[serde(expecting = "an object")]
struct Metadata {
    #[serde(rename = "K")]
    matrix: [f64; 9],
    w: f64,
    h: f64,
    poses: Vec<[f64; 7]>,
    #[serde(rename = "perFrameIntrinsicCoeffs")]
    lenses: Option<Vec<[f64; 4]>>,
}

fn images(file: &Path) -> Option<&'static str> {
    ["rgbd", "rgb"].into_iter().find(|name| file.with_file_name(name).is_dir())
}

fn is(file: &Path) -> bool {
    let kind = if file.ends_with("metadata") { Some("") } else { file.ends_with("metadata.json").then_some("json") };
    kind.is_some_and(|kind| images(file).is_some() && holds(file, kind, &["\"K\"", "\"poses\""]))
}

fn frames(file: &Path, photographs: &mut Photographs) -> Result<Vec<Fields>> {
    let Metadata { matrix: [fx, _, _, _, fy, _, cx, cy, _], w, h, poses, lenses } = read_json(file)?;
    let images = images(file).unwrap_or_default();
    let one = |(index, [qx, qy, qz, qw, x, y, z]): (usize, [f64; 7])| {
        let pose = Place::new(file, PlaceInFile::Frame(index)).pose([qw, qx, qy, qz], [x, y, z])?;
        let lens = lenses.as_ref().and_then(|lenses| lenses.get(index));
        let name = photographs.find(&format!("{images}/{index}.jpg"));
        Ok(frame(name, DMat4::from(pose), lens.copied().unwrap_or([fx, fy, cx, cy]), Some([w, h])))
    };
    poses.into_iter().enumerate().map(one).collect()
}
