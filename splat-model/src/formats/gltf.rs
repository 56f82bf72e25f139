//! glTF 2.0 with the extension `KHR_gaussian_splatting`, as ratified by Khronos
//! (<https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_gaussian_splatting>; glTF 2.0, §3.6 to §3.7 for buffers and
//! meshes, §4.4 for the binary container).
//!
//! A scene is a mesh primitive of points whose attributes have one element per Gaussian:
//!
//! | attribute | written as | holds |
//! |---|---|---|
//! | `POSITION` | 3 floats | the centre |
//! | `COLOR_0` | 4 normalised bytes | colour and opacity for programs that draw points |
//! | `KHR_gaussian_splatting:ROTATION` | 4 floats | a unit quaternion, `x y z w` |
//! | `KHR_gaussian_splatting:SCALE` | 3 floats | standard deviations, not their logarithms |
//! | `KHR_gaussian_splatting:OPACITY` | 1 float | the opacity, 0 to 1 |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | 3 floats each | the harmonic of degree `l`, order `n − l`, of the three channels; `l` to 3 |
//!
//! Attributes are written as floats, so that conversion loses nothing but the rounding of `exp` and the logistic function. The format is
//! written for other programs, and not read.
//!
//! **Frame.** glTF is left-up-front: half a turn about `z` from the frame of scenes here. `asset.extras` stores the origin, in the frame of
//! scenes here, and the mark of antialiasing; the format itself has no place for them.
//!
//! The binary container is written; its JSON twin would be a third larger.
//!
//! **Crates.** `gltf` 1.4 refuses attributes whose names have a colon, as those of the extension do.

use std::io::{self, Write};
use std::path::Path;

use serde_json::{Map, Value, json};

use super::frame::HalfTurn;
use super::{SceneFile, extras, opacity};
use crate::FileError;
use crate::gaussians::{DC, GaussianRows, sigmoid};
use crate::replace::{WRITE, replace};

#[cfg(test)]
mod tests;

pub(super) const DEGREE_MAX: usize = 3;

const EXTENSION: &str = "KHR_gaussian_splatting";

const POSITION: &str = "POSITION";

/// Name of the attribute of harmonic `k` in the order of the coefficients, `k = l² + n`.
fn harmonic(k: usize) -> String {
    let l = k.isqrt();
    format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{}", k - l * l)
}

/// Codes of component types and of buffers for vertices.
const UNSIGNED_BYTE: u32 = 5121;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34_962;

/// Range of the logarithms of standard deviations that are positive, finite floats.
const LOG_SCALES: (f32, f32) = (-87.0, 88.0);

/// Writes rows that fit the format ([`super::fit`]). `scene` gives the origin and the mark of antialiasing.
pub(super) fn write(path: &Path, rows: &GaussianRows, scene: &SceneFile) -> Result<(), FileError> {
    replace(path, |out| write_to(out, rows, scene)).map_err(FileError::io(path, WRITE))
}

fn write_to(out: &mut impl Write, rows: &GaussianRows, scene: &SceneFile) -> io::Result<()> {
    let attributes = attributes(rows);
    let bytes: usize = attributes.iter().map(|attribute| attribute.bytes.len()).sum();
    let mut json = serde_json::to_vec(&document(rows, &attributes, scene))?;
    // Chunks end at multiples of four bytes.
    json.resize(json.len().next_multiple_of(4), b' ');
    let word = |bytes: usize| {
        let word = u32::try_from(bytes)
            .map_err(|_| io::Error::other("more than 4 GiB, the most of a .glb: write another format"));
        word.map(u32::to_le_bytes)
    };
    let length = 20 + json.len() + 8 + bytes;
    // The second word is the version of the container.
    out.write_all(&[*b"glTF", 2_u32.to_le_bytes(), word(length)?, word(json.len())?, *b"JSON"].concat())?;
    out.write_all(&json)?;
    out.write_all(&[word(bytes)?, *b"BIN\0"].concat())?;
    attributes.iter().try_for_each(|attribute| out.write_all(&attribute.bytes))
}

fn document(rows: &GaussianRows, attributes: &[Attribute], scene: &SceneFile) -> Value {
    let mut asset = json!({ "version": "2.0", "generator": concat!("splat ", env!("CARGO_PKG_VERSION")) });
    let mut extras = extras::of(scene.world());
    if scene.trained.antialias {
        extras.insert("antialiased".into(), json!(true));
    }
    if !extras.is_empty() {
        asset["extras"] = extras.into();
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for mean in turned(rows) {
        low = [0, 1, 2].map(|axis| low[axis].min(mean[axis]));
        high = [0, 1, 2].map(|axis| high[axis].max(mean[axis]));
    }
    let mut at = 0;
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), Map::new());
    for (i, attribute) in attributes.iter().enumerate() {
        let (name, mut accessor, bytes) = (attribute.name.clone(), attribute.accessor.clone(), attribute.bytes.len());
        views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes, "target": ARRAY_BUFFER }));
        at += bytes;
        accessor["count"] = json!(rows.len());
        accessor["bufferView"] = json!(i);
        if name == POSITION {
            accessor["min"] = json!(low.map(f64::from));
            accessor["max"] = json!(high.map(f64::from));
        }
        accessors.push(accessor);
        names.insert(name, json!(i));
    }
    let splatting = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective", "sortingMethod": "cameraDistance"
    });
    let primitive = json!({ "mode": 0, "attributes": names, "extensions": { EXTENSION: splatting } });
    json!({
        "asset": asset,
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive] }],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{ "byteLength": at }],
    })
}

/// An attribute, and its accessor without the place of its bytes.
struct Attribute {
    name: String,
    accessor: Value,
    bytes: Vec<u8>,
}

fn floats<const N: usize>(name: impl Into<String>, values: impl ExactSizeIterator<Item = [f32; N]>) -> Attribute {
    let shape = if N == 1 { "SCALAR".to_owned() } else { format!("VEC{N}") };
    let accessor = json!({ "componentType": FLOAT, "type": shape });
    let mut bytes = Vec::with_capacity(4 * N * values.len());
    values.for_each(|value| value.iter().for_each(|number| bytes.extend(number.to_le_bytes())));
    Attribute { name: name.into(), accessor, bytes }
}

fn turned(rows: &GaussianRows) -> impl ExactSizeIterator<Item = [f32; 3]> {
    let axes = HalfTurn::Z.axes();
    rows.means.iter().map(move |mean| [0, 1, 2].map(|axis| axes[axis] * mean[axis]))
}

fn attributes(rows: &GaussianRows) -> Vec<Attribute> {
    let turn = HalfTurn::Z;
    let axes = turn.axes();
    let colour = |i: usize| {
        // The cast clamps.
        let [r, g, b] = rows.sh_dc[i].map(|dc| (255.0 * (0.5 + DC * f64::from(dc))).round() as u8);
        [r, g, b, opacity::level(rows.logit_opacities[i])]
    };
    let colours = Attribute {
        name: "COLOR_0".into(),
        accessor: json!({ "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4" }),
        bytes: (0..rows.len()).flat_map(colour).collect(),
    };
    let rotations = rows.rotations.iter().map(|rotation| {
        let [w, x, y, z] = rotation.map(f64::from);
        let length = [w, x, y, z].iter().map(|value| value * value).sum::<f64>().sqrt();
        let unit = [x, y, z, w].map(|value| (value / length) as f32);
        [axes[0] * unit[0], axes[1] * unit[1], axes[2] * unit[2], unit[3]]
    });
    let scales = rows
        .log_scales
        .iter()
        .map(|logs| logs.map(|log| f64::from(log.clamp(LOG_SCALES.0, LOG_SCALES.1)).exp() as f32));
    let opacities = rows.logit_opacities.iter().map(|&logit| [sigmoid(logit) as f32]);
    let mut attributes = vec![
        floats(POSITION, turned(rows)),
        colours,
        floats(format!("{EXTENSION}:ROTATION"), rotations),
        floats(format!("{EXTENSION}:SCALE"), scales),
        floats(format!("{EXTENSION}:OPACITY"), opacities),
        floats(harmonic(0), rows.sh_dc.iter().copied()),
    ];
    let per_row = rows.rest_per_row();
    attributes.extend((1..1 + per_row / 3).map(|k| {
        let of = |row: &[f32]| [0, 1, 2].map(|channel| turn.sign(k) * row[3 * (k - 1) + channel]);
        floats(harmonic(k), rows.sh_rest.chunks_exact(per_row).map(of))
    }));
    attributes
}
