//! The binary container of glTF (§4.4), with one primitive in it.

use std::io::{self, Write};
use std::path::Path;

use glam::Vec3;
use serde_json::{Map, Value, json};

use super::HalfTurn;
use crate::FileError;
use crate::replace::{WRITE, replace};

/// Codes of component types and of buffers.
pub(super) const UNSIGNED_BYTE: u32 = 5121;
pub(super) const UNSIGNED_SHORT: u32 = 5123;
pub(super) const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;

/// An array of the buffer with its accessor: an attribute of vertices, or the indices of triangles if it has no name.
pub(super) struct Attribute {
    name: String,
    accessor: Value,
    bytes: Vec<u8>,
}

impl Attribute {
    /// An array of numbers of a type, `width` for each element. Elements begin at multiples of four bytes.
    pub fn new(name: impl Into<String>, component: u32, width: usize, count: usize, bytes: Vec<u8>) -> Self {
        let shape = if width == 1 { "SCALAR".to_owned() } else { format!("VEC{width}") };
        let name = name.into();
        let normalized = component != FLOAT && !name.is_empty();
        let accessor = json!({ "componentType": component, "normalized": normalized, "type": shape, "count": count });
        Self { name, accessor, bytes }
    }
}

pub(super) fn floats<const N: usize>(
    name: impl Into<String>,
    values: impl ExactSizeIterator<Item = [f32; N]>,
) -> Attribute {
    let count = values.len();
    let mut bytes = Vec::with_capacity(4 * N * count);
    values.for_each(|value| value.iter().for_each(|number| bytes.extend(number.to_le_bytes())));
    Attribute::new(name, FLOAT, N, count, bytes)
}

/// Positions of scenes here in the frame of glTF.
pub(super) fn turned(vectors: &[[f32; 3]]) -> impl ExactSizeIterator<Item = [f32; 3]> {
    let axes = HalfTurn::Z.axes();
    vectors.iter().map(move |vector| [0, 1, 2].map(|axis| axes[axis] * vector[axis]))
}

/// The attribute of positions, with their bounds, which the format asks for.
pub(super) fn positions(means: &[[f32; 3]]) -> Attribute {
    let low = turned(means).map(Vec3::from).fold(Vec3::INFINITY, Vec3::min);
    let high = turned(means).map(Vec3::from).fold(Vec3::NEG_INFINITY, Vec3::max);
    let mut found = floats("POSITION", turned(means));
    found.accessor["min"] = json!(low.as_dvec3().to_array());
    found.accessor["max"] = json!(high.as_dvec3().to_array());
    found
}

/// Writes a primitive. `extras` go to the asset, `root` to the document.
pub(super) fn write(
    path: &Path,
    attributes: &[Attribute],
    primitive: Value,
    extras: Map<String, Value>,
    root: Value,
) -> Result<(), FileError> {
    let document = document(attributes, primitive, extras, root);
    replace(path, |out| write_to(out, attributes, &document)).map_err(FileError::io(path, WRITE))
}

fn write_to(out: &mut impl Write, attributes: &[Attribute], document: &Value) -> io::Result<()> {
    let bytes: usize = attributes.iter().map(|attribute| attribute.bytes.len()).sum();
    let mut json = serde_json::to_vec(document)?;
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

fn document(attributes: &[Attribute], mut primitive: Value, extras: Map<String, Value>, mut root: Value) -> Value {
    let mut asset = json!({ "version": "2.0", "generator": concat!("splat ", env!("CARGO_PKG_VERSION")) });
    if !extras.is_empty() {
        asset["extras"] = extras.into();
    }
    let mut at = 0;
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    for (i, Attribute { name, accessor, bytes }) in attributes.iter().enumerate() {
        let target = if name.is_empty() { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER };
        views.push(json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes.len(), "target": target }));
        at += bytes.len();
        let mut accessor = accessor.clone();
        accessor["bufferView"] = json!(i);
        accessors.push(accessor);
        if name.is_empty() { primitive["indices"] = json!(i) } else { primitive["attributes"][name] = json!(i) }
    }
    root["asset"] = asset;
    root["scene"] = json!(0);
    root["scenes"] = json!([{ "nodes": [0] }]);
    root["nodes"] = json!([{ "mesh": 0 }]);
    root["meshes"] = json!([{ "primitives": [primitive] }]);
    root["accessors"] = accessors.into();
    root["bufferViews"] = views.into();
    root["buffers"] = json!([{ "byteLength": at }]);
    root
}
