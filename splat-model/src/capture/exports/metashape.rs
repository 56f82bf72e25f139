//! Cameras of Metashape ("Export Cameras", Agisoft XML).
//!
//! Format: "Camera models" in the Metashape Pro manual (<https://www.agisoft.com/pdf/metashape-pro_2_3_en.pdf>), and nerfstudio's
//! `process_data/metashape_utils.py`. A camera's `transform` is chunk-from-camera, row by row, with OpenCV's axes. That of its component, or in older
//! files of the chunk, is `x ↦ scale · rotation · x + translation` into the world. A `label` is a photograph's name, mostly without extension.
//!
//! The focal lengths are `f + b1` and `f`; `cx` and `cy` count from the middle. `p1` is OpenCV's p2, and `p2` its p1. Fisheyes have the same
//! coefficients for angles. Neither `k4` of a frame camera nor `b2`, a skew, has an equal here.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DMat4, DVec3, DVec4};
use roxmltree::{Document, Node};

use super::{Format, Photographs, frame, with_lens};
use crate::capture::read::{Place, PlaceInFile, quoted};
use crate::capture::transforms::camera::{EQUIRECTANGULAR, THIN_PRISM_FISHEYE};
use crate::capture::transforms::{Fields, holds, text};
use crate::capture::{CaptureError, Result};

pub(super) const FORMAT: Format = Format {
    name: "Metashape",
    is: |file| holds(file, "xml", &["<document", "<chunk", "<sensors", "<cameras"]),
    frames,
};

/// How far a skew that is ignored may move a pixel at the border, px.
const MOST_SKEW_PX: f64 = 0.1;

fn frames(file: &Path, photographs: &mut Photographs) -> Result<Vec<Fields>> {
    let text = text(file)?;
    let text = String::from_utf8_lossy(&text);
    let document = Document::parse(&text).map_err(|error| {
        CaptureError::content(file, format!("it is no XML: {}. Export it again", quoted(&error.to_string())))
    })?;
    let chunk = child(document.root_element(), "chunk").unwrap_or(document.root_element());
    let all = |list, kind: &'static str| {
        let nodes = child(chunk, list).into_iter().flat_map(|list| list.descendants());
        nodes.filter(move |node| node.has_tag_name(kind))
    };
    let by_id = |list, kind| all(list, kind).filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let [sensors, components]: [HashMap<&str, Node>; 2] =
        [by_id("sensors", "sensor"), by_id("components", "component")];
    let (mut frames, mut left_out) = (Vec::new(), Vec::new());
    for (index, camera) in all("cameras", "camera").enumerate() {
        let (label, of) = (camera.attribute("label").unwrap_or_default(), |name| camera.attribute(name));
        let place = Place { path: label, ..Place::new(file, PlaceInFile::Frame(index)) };
        let is_enabled = !matches!(of("enabled"), Some("false" | "0"));
        let Some(transform) = child(camera, "transform").filter(|_| is_enabled) else {
            left_out.push(label);
            continue;
        };
        let cam = DMat4::from_cols_array(&numbers(&place, "transform", transform)?).transpose();
        let component = of("component_id").and_then(|id| child(*components.get(id)?, "transform"));
        let pose = match component.or(child(chunk, "transform")) {
            Some(to_world) => moved(&place, to_world, cam)?,
            None => cam,
        };
        let pose = pose * DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
        let id = of("sensor_id").unwrap_or_default();
        let sensor = sensors.get(id).ok_or_else(|| place.refuse("sensor_id", quoted(id), "the `id` of a sensor"))?;
        frames.push(of_sensor(&place, *sensor, photographs.find(label), pose)?);
    }
    photographs.remarks.extend(left_out.first().map(|first| {
        let (count, first) = (left_out.len(), quoted(first));
        format!("{count} cameras that are not aligned or not enabled are left out, the first of them {first}")
    }));
    Ok(frames)
}

fn child<'a, 'b>(node: Node<'a, 'b>, name: &str) -> Option<Node<'a, 'b>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn numbers<const N: usize>(place: &Place, field: &'static str, of: Node) -> Result<[f64; N]> {
    let text = of.text().unwrap_or_default();
    let all: Option<Vec<f64>> = text.split_whitespace().take(N + 1).map(|number| number.parse().ok()).collect();
    all.and_then(|all| all.try_into().ok()).ok_or_else(|| place.refuse(field, quoted(text), format!("{N} numbers")))
}

/// A pose in the chunk, moved to the world.
fn moved(place: &Place, to_world: Node, cam: DMat4) -> Result<DMat4> {
    let of = |name| child(to_world, name);
    let rotation = of("rotation").map_or(Ok(DMat3::IDENTITY.to_cols_array()), |of| numbers(place, "rotation", of))?;
    let translation = of("translation").map_or(Ok([0.0; 3]), |of| numbers(place, "translation", of))?;
    let [scale] = of("scale").map_or(Ok([1.0]), |of| numbers(place, "scale", of))?;
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(place.refuse("scale", scale, "a positive number"));
    }
    let turned = DMat4::from_mat3(DMat3::from_cols_array(&rotation).transpose()) * cam;
    let centre = scale * turned.w_axis.truncate() + DVec3::from_array(translation);
    Ok(DMat4 { w_axis: DVec4::from((centre, turned.w_axis.w)), ..turned })
}

fn of_sensor(place: &Place, sensor: Node, name: String, pose: DMat4) -> Result<Fields> {
    let side = |field| {
        let value = child(sensor, "resolution").and_then(|size| size.attribute(field)).unwrap_or_default();
        value.parse().map_err(|_| place.refuse(field, quoted(value), "the `resolution` of the sensor, px"))
    };
    let [w, h]: [f64; 2] = [side("width")?, side("height")?];
    let model = match sensor.attribute("type").unwrap_or("frame") {
        "frame" => "OPENCV",
        "fisheye" | "equidistant_fisheye" => THIN_PRISM_FISHEYE,
        "spherical" => return Ok(with_lens(frame(name, pose, [1.0; 4], Some([w, h])), EQUIRECTANGULAR, [0.0; 6])),
        other => return Err(place.refuse("type", quoted(other), "a sensor that is frame, fisheye or spherical")),
    };
    let all = || sensor.children().filter(|child| child.has_tag_name("calibration"));
    let calibration = all().find(|of| of.attribute("class") == Some("adjusted")).or(all().next());
    let calibration =
        calibration.ok_or_else(|| place.refuse("calibration", "missing", "that of the camera's sensor"))?;
    let number =
        |name| child(calibration, name).map_or(Ok([0.0]), |of| numbers(place, name, of)).map(|[number]| number);
    let [f, b1, b2, cx, cy] = [number("f")?, number("b1")?, number("b2")?, number("cx")?, number("cy")?];
    if !(f > 0.0) {
        return Err(place.refuse("f", f, "a positive focal length in px"));
    }
    let most = MOST_SKEW_PX * f / (0.5 * h);
    for (field, value, most) in [("b2", b2, most), ("p3", number("p3")?, 0.0), ("p4", number("p4")?, 0.0)] {
        if !(value.abs() <= most) {
            let fix =
                "Fix it at 0, optimise the cameras and export them again, or export photographs that are undistorted";
            return Err(place.refuse_with(field, value, "0", fix));
        }
    }
    let [k1, k2, k3, k4] = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
    let coefficients = [k1, k2, number("p2")?, number("p1")?, k3, k4];
    Ok(with_lens(frame(name, pose, [f + b1, f, 0.5 * w + cx, 0.5 * h + cy], Some([w, h])), model, coefficients))
}
