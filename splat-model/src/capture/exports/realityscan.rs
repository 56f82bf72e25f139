//! "Internal/External camera parameters" of RealityScan and RealityCapture: a CSV file with a line for each photograph.
//!
//! Format: `calibration.xml` of RealityScan 2.2, which defines the export, Epic's "RealityCapture XMP Camera Math", and nerfstudio's
//! `process_data/realitycapture_utils.py`. The header, in which newer versions say `yaw`, `f_35mm`, `px_norm` and `py_norm`, is
//!
//! ```text
//! #name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2
//! ```
//!
//! `f` is for a film of 36 mm along the longer side; `px` and `py` are the principal point from the middle, in parts of that side. Angles are in
//! degrees. Without any, a camera looks down with north, +y, at the top of its picture: `world_from_cam = Rz(−heading) Rx(pitch) Ry(roll)` with
//! OpenGL's axes. `t1` is OpenCV's p2 and `t2` its p1, as the export "OpenCV-compliant" has them. `k4` has no equal here. Positions have to be
//! lengths: those in degrees, of a geographic system, cannot be told apart.

use std::path::Path;

use glam::{DMat4, DVec3};

use super::{Format, Photographs, frame, with_lens};
use crate::capture::read::{Place, PlaceInFile, quoted};
use crate::capture::transforms::{Fields, holds, text};
use crate::capture::{Result, image};

pub(super) const FORMAT: Format =
    Format { name: "RealityScan", is: |file| holds(file, "csv", &["#name,", ",alt,", ",pitch,roll,f"]), frames };

fn frames(file: &Path, photographs: &mut Photographs) -> Result<Vec<Fields>> {
    let (mut columns, mut frames, text) = (Vec::new(), Vec::new(), text(file)?);
    for (line, number) in String::from_utf8_lossy(&text).lines().zip(1..) {
        let values: Vec<&str> = line.split(',').map(str::trim).collect();
        // A first line may count the cameras.
        if line.starts_with('#') {
            columns = values.iter().map(|name| name.trim_start_matches('#').to_owned()).collect();
        } else if !line.trim().is_empty() {
            let place = Place::new(file, PlaceInFile::Line("camera", number));
            frames.push(of_line(&place, &columns, &values, photographs)?);
        }
    }
    Ok(frames)
}

fn of_line(place: &Place, columns: &[String], values: &[&str], photographs: &mut Photographs) -> Result<Fields> {
    let fix = "Export \"Internal/External camera parameters\" again";
    if values.len() != columns.len() {
        let expected = format!("{}, as in the header", columns.len());
        return Err(place.refuse_with("values", values.len(), expected, fix));
    }
    let value = |names: [&str; 2]| columns.iter().zip(values).find(|(column, _)| names.contains(&column.as_str()));
    let number = |field, newer, default: Option<f64>| {
        let found = value([field, newer]);
        found.map_or(default, |(_, found)| found.parse().ok()).ok_or_else(|| {
            let found = found.map_or("missing".into(), |(_, found)| quoted(found));
            place.refuse_with(field, found, "a number below the header", fix)
        })
    };
    let (number, optional) =
        (|field, newer| number(field, newer, None), |field, newer| number(field, newer, Some(0.0)));
    let name = photographs.find(value(["name"; 2]).map_or("", |(_, name)| name));
    let path = photographs.folder.join(&name);
    // Who reads the frames says how many photographs are missing.
    let size = if path.is_file() { Some(image::size(&path)?.map(|side| side as f64)) } else { None };
    let [width, height] = size.unwrap_or_default();
    let side = width.max(height);
    let turns = [number("heading", "yaw")?, number("pitch", "")?, number("roll", "")?].map(f64::to_radians);
    let pose = DMat4::from_translation(DVec3::new(number("x", "")?, number("y", "")?, number("alt", "")?))
        * DMat4::from_rotation_z(-turns[0])
        * DMat4::from_rotation_x(turns[1])
        * DMat4::from_rotation_y(turns[2]);
    let focal = number("f", "f_35mm")? * side / 36.0;
    let [cx, cy] = [optional("px", "px_norm")? * side + 0.5 * width, optional("py", "py_norm")? * side + 0.5 * height];
    let [k1, k2, k3] = [optional("k1", "")?, optional("k2", "")?, optional("k3", "")?];
    let [k4, p1, p2] = [optional("k4", "")?, optional("t2", "")?, optional("t1", "")?];
    Ok(with_lens(frame(name, pose, [focal, focal, cx, cy], size), "OPENCV", [k1, k2, p1, p2, k3, k4]))
}
