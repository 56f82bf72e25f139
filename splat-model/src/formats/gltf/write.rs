//! Writing of both containers.

use std::io::{self, Write};
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Map, Value, json};

use super::{CHUNKS, COLOUR_SPACE, EXTENSION, KERNEL, MAGIC, OPACITY, POSITION, ROTATION, SCALE, VERSION, harmonic};
use crate::formats::frame::HalfTurn;
use crate::formats::{DC, Format, FormatError, SceneFile, extras, opacity};
use crate::gaussians::{GaussianRows, sigmoid};
use crate::replace::{WRITE, replace};

/// Codes of component types and of buffers for vertices.
const UNSIGNED_BYTE: u32 = 5121;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34_962;

/// Range of the logarithms of standard deviations that are positive, finite floats.
const LOG_SCALES: (f32, f32) = (-87.0, 88.0);

/// Bytes that are encoded as base64 at once; a multiple of three, so that the pieces join.
const PIECE: usize = 3 << 18;

/// Writes rows that fit the format ([`crate::formats::fit`]), in the binary container or, for [`Format::Gltf`], as JSON that holds the data as base64.
/// `scene` gives the origin and the mark of antialiasing.
pub fn write(path: &Path, rows: &GaussianRows, scene: &SceneFile, format: Format) -> Result<(), FormatError> {
    let attributes = attributes(rows);
    let document = document(rows, &attributes, scene);
    replace(path, |out| match format {
        Format::Glb => binary(out, document, &attributes),
        _ => text(out, &document, &attributes),
    })
    .map_err(FormatError::io(path, WRITE))
}

fn bytes_of(attributes: &[Attribute]) -> usize {
    attributes.iter().map(|attribute| attribute.bytes.len()).sum()
}

fn binary(out: &mut impl Write, mut document: Map<String, Value>, attributes: &[Attribute]) -> io::Result<()> {
    let bytes = bytes_of(attributes);
    document.insert("buffers".into(), json!([{ "byteLength": bytes }]));
    let mut json = serde_json::to_vec(&document)?;
    // Chunks end at multiples of four bytes.
    json.resize(json.len().next_multiple_of(4), b' ');
    let word = |bytes: usize| {
        let word = u32::try_from(bytes)
            .map_err(|_| io::Error::other("more than 4 GiB, the most of a .glb: write another format"));
        word.map(u32::to_le_bytes)
    };
    let length = 20 + json.len() + 8 + bytes;
    out.write_all(&[MAGIC, VERSION.to_le_bytes(), word(length)?, word(json.len())?, CHUNKS[0]].concat())?;
    out.write_all(&json)?;
    out.write_all(&[word(bytes)?, CHUNKS[1]].concat())?;
    attributes.iter().try_for_each(|attribute| out.write_all(&attribute.bytes))
}

/// The document without its buffer.
fn document(rows: &GaussianRows, attributes: &[Attribute], scene: &SceneFile) -> Map<String, Value> {
    let mut asset = object(json!({ "version": "2.0", "generator": concat!("splat ", env!("CARGO_PKG_VERSION")) }));
    let mut extras = extras::of(scene.world());
    if scene.antialiased {
        extras.insert("antialiased".into(), json!(true));
    }
    if !extras.is_empty() {
        asset.insert("extras".into(), extras.into());
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
        accessor.insert("count".into(), json!(rows.len()));
        accessor.insert("bufferView".into(), json!(i));
        if name == POSITION {
            accessor.extend([("min".into(), json!(low.map(f64::from))), ("max".into(), json!(high.map(f64::from)))]);
        }
        accessors.push(accessor);
        names.insert(name, json!(i));
    }
    let splatting = json!({
        "kernel": KERNEL, "colorSpace": COLOUR_SPACE, "projection": "perspective", "sortingMethod": "cameraDistance"
    });
    let primitive = json!({ "mode": 0, "attributes": names, "extensions": { EXTENSION: splatting } });
    object(json!({
        "asset": asset,
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive] }],
        "accessors": accessors,
        "bufferViews": views,
    }))
}

fn text(out: &mut impl Write, document: &Map<String, Value>, attributes: &[Attribute]) -> io::Result<()> {
    let (json, bytes) = (serde_json::to_string(document)?, bytes_of(attributes));
    // The data is too long for a string in memory: the document is left open, and closed behind it.
    write!(
        out,
        "{},\"buffers\":[{{\"byteLength\":{bytes},\"uri\":\"data:application/octet-stream;base64,",
        &json[..json.len() - 1]
    )?;
    let mut rest: Vec<u8> = Vec::new();
    for attribute in attributes {
        rest.extend(&attribute.bytes);
        let whole = rest.len() / PIECE * PIECE;
        rest[..whole].chunks(PIECE).try_for_each(|piece| out.write_all(STANDARD.encode(piece).as_bytes()))?;
        rest.drain(..whole);
    }
    out.write_all(STANDARD.encode(&rest).as_bytes())?;
    out.write_all(b"\"}]}")
}

/// An attribute, and its accessor without the place of its bytes.
struct Attribute {
    name: String,
    accessor: Map<String, Value>,
    bytes: Vec<u8>,
}

fn floats<const N: usize>(name: impl Into<String>, values: impl ExactSizeIterator<Item = [f32; N]>) -> Attribute {
    let shape = if N == 1 { "SCALAR".to_owned() } else { format!("VEC{N}") };
    let accessor = object(json!({ "componentType": FLOAT, "type": shape }));
    let mut bytes = Vec::with_capacity(4 * N * values.len());
    values.for_each(|value| value.iter().for_each(|number| bytes.extend(number.to_le_bytes())));
    Attribute { name: name.into(), accessor, bytes }
}

fn object(value: Value) -> Map<String, Value> {
    value.as_object().cloned().unwrap_or_default()
}

/// Centres in glTF's frame.
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
        accessor: object(json!({ "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4" })),
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
        floats(ROTATION, rotations),
        floats(SCALE, scales),
        floats(OPACITY, opacities),
        floats(harmonic(0), rows.sh_dc.iter().copied()),
    ];
    let per_row = rows.rest_per_row();
    attributes.extend((1..1 + per_row / 3).map(|k| {
        let of = |row: &[f32]| [0, 1, 2].map(|channel| turn.sign(k) * row[3 * (k - 1) + channel]);
        floats(harmonic(k), rows.sh_rest.chunks_exact(per_row).map(of))
    }));
    attributes
}
