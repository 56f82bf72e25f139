//! Reading of both containers.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use super::document::{Document, Primitive};
use super::{
    CHUNKS, COLOUR_SPACE, DEGREE_MAX, EXTENSION, KERNEL, MAGIC, OPACITY, POSITION, ROTATION, SCALE, VERSION, attribute,
    buffers, harmonic, nodes,
};
use crate::formats::frame::HalfTurn;
use crate::formats::{Format, FormatError, SceneFile, extras, opacity};
use crate::gaussians::GaussianRows;
use crate::ply::{WorldFrame, brief};

/// Least number of bytes of buffers for each Gaussian, of which 28 are usual at the least. Several nodes may show one mesh, so that without this a
/// small file could ask for any number of Gaussians.
const BYTES_PER_GAUSSIAN: usize = 16;

/// Extensions that a file may require: the reader does what they ask for.
const REQUIRED: [&str; 2] = [EXTENSION, "KHR_mesh_quantization"];

/// Reads a binary container.
pub fn read_binary(path: &Path) -> Result<SceneFile, FormatError> {
    let broken = |detail: String| FormatError::broken(path, Format::Glb, detail);
    let file = File::open(path).map_err(FormatError::io(path, "open the scene (is the path right?)"))?;
    let bytes = file.metadata().map_err(FormatError::io(path, "read the size of the file"))?.len();
    let mut file = BufReader::with_capacity(1 << 20, file);
    let mut next = |name: &str, bytes: u64| {
        let mut found = Vec::new();
        let read = (&mut file).take(bytes).read_to_end(&mut found);
        read.map_err(|error| broken(format!("{name}: {error}")))?;
        match found.len() as u64 == bytes {
            true => Ok(found),
            false => Err(broken(format!("{name}: {} bytes, expected {bytes}; it is truncated", found.len()))),
        }
    };
    let word = |bytes: &[u8], at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let header = next("header", 12)?;
    let (version, length) = (word(&header, 4), u64::from(word(&header, 8)));
    if header[..4] != MAGIC || version != VERSION || length > bytes {
        return Err(broken(format!(
            "a header of version {version} and {length} bytes, expected version {VERSION} and at most the {bytes} bytes of the file"
        )));
    }
    let mut chunks = [None, None];
    let mut at = 12;
    while at < length && chunks.iter().any(Option::is_none) {
        let head = next("header of a chunk", 8)?;
        let content = next("chunk", u64::from(word(&head, 0)))?;
        at += 8 + content.len() as u64;
        // Chunks of other types are skipped, as the format says.
        if let Some(known) = CHUNKS.iter().position(|kind| *kind == head[4..8]) {
            chunks[known].get_or_insert(content);
        }
    }
    let [json, binary] = chunks;
    let json = json.ok_or_else(|| broken("no JSON chunk".into()))?;
    scene(path, &json, binary).map_err(broken)
}

/// Reads a document whose JSON is `json`.
pub fn read_text(path: &Path, json: &[u8]) -> Result<SceneFile, FormatError> {
    scene(path, json, None).map_err(|detail| FormatError::broken(path, Format::Gltf, detail))
}

fn scene(path: &Path, json: &[u8], binary: Option<Vec<u8>>) -> Result<SceneFile, String> {
    let document: Document =
        serde_json::from_slice(json).map_err(|error| format!("its JSON: {}", brief(&error.to_string())))?;
    if !document.asset.version.starts_with("2.") {
        return Err(format!("glTF of version `{}`, expected 2.0", brief(&document.asset.version)));
    }
    if let Some(unknown) = document.extensions_required.iter().find(|name| !REQUIRED.contains(&name.as_str())) {
        return Err(format!(
            "it requires the extension `{}`, expected at most {}",
            brief(unknown),
            REQUIRED.join(" and ")
        ));
    }
    let shown = nodes::meshes(&document)?;
    let primitives = |mesh: usize| {
        document.meshes[mesh].primitives.iter().filter(|primitive| primitive.extensions.splatting.is_some())
    };
    let mut count = 0_usize;
    let mut sh_degree = 0;
    for primitive in shown.iter().flat_map(|(mesh, _)| primitives(*mesh)) {
        check(primitive)?;
        count = count.saturating_add(attribute::count(&document, primitive)?);
        sh_degree = sh_degree.max(degree(primitive));
    }
    // A document of an empty scene has no mesh, because accessors have at least one element.
    let empty = document.meshes.is_empty() && document.extensions_used.iter().any(|name| name == EXTENSION);
    if !empty && !shown.iter().any(|(mesh, _)| primitives(*mesh).next().is_some()) {
        return Err(format!("no primitive of its scene has the extension `{EXTENSION}`, expected at least one"));
    }
    let loaded = buffers::load(&document, path, binary)?;
    let bytes = loaded.values().map(Vec::len).sum::<usize>();
    if count.saturating_mul(BYTES_PER_GAUSSIAN) > bytes {
        return Err(format!("{count} Gaussians, more than its {bytes} bytes of buffers can hold"));
    }
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    for (mesh, world_from_mesh) in &shown {
        for primitive in primitives(*mesh) {
            let mut more = rows_of(&document, &loaded, primitive, sh_degree)?;
            nodes::transform(&mut more, world_from_mesh)?;
            append(&mut rows, more);
        }
    }
    HalfTurn::Z.turn(&mut rows);
    let extras = &document.asset.extras;
    let WorldFrame { origin, metres_per_unit } = extras::world(extras);
    Ok(SceneFile { rows, origin, metres_per_unit, antialiased: extras["antialiased"] == true })
}

/// Checks that a primitive's Gaussians are those of scenes here.
fn check(primitive: &Primitive) -> Result<(), String> {
    let Some(splatting) = &primitive.extensions.splatting else { return Ok(()) };
    let known = [("kernel", &splatting.kernel, KERNEL), ("colorSpace", &splatting.color_space, COLOUR_SPACE)];
    for (name, found, expected) in known {
        // Drafts of the extension had defaults.
        if let Some(found) = found.as_deref().filter(|found| *found != expected) {
            return Err(format!("`{name}` is `{}`, expected `{expected}`", brief(found)));
        }
    }
    match splatting.extensions.keys().next() {
        Some(name) => {
            Err(format!("its splats are stored as the extension `{}` says, expected plain attributes", brief(name)))
        }
        None => Ok(()),
    }
}

/// The highest degree of which a primitive has a coefficient; that none is missing is checked where they are read.
fn degree(primitive: &Primitive) -> usize {
    let has = |degree: &usize| {
        (degree * degree..(degree + 1) * (degree + 1)).any(|k| primitive.attributes.contains_key(&harmonic(k)))
    };
    (1..=DEGREE_MAX).rev().find(has).unwrap_or(0)
}

/// The Gaussians of a primitive in glTF's frame, with zeros for harmonics above its degree.
fn rows_of(
    document: &Document,
    buffers: &BTreeMap<usize, Vec<u8>>,
    primitive: &Primitive,
    sh_degree: usize,
) -> Result<GaussianRows, String> {
    let count = attribute::count(document, primitive)?;
    let three = |name: &str| attribute::read::<3>(document, buffers, primitive, name, count);
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    rows.means = three(POSITION)?;
    rows.log_scales = three(SCALE)?.into_iter().map(|scale| scale.map(log_scale)).collect();
    rows.rotations = attribute::read::<4>(document, buffers, primitive, ROTATION, count)?;
    for rotation in &mut rows.rotations {
        // The scalar comes first here.
        rotation.rotate_right(1);
    }
    let opacities = attribute::read::<1>(document, buffers, primitive, OPACITY, count)?;
    rows.logit_opacities = opacities.into_iter().map(|[opacity]| opacity::logit_of(opacity)).collect();
    rows.sh_dc = three(&harmonic(0))?;
    let per_row = rows.rest_per_row();
    rows.sh_rest = vec![0.0; count * per_row];
    for k in 1..(degree(primitive) + 1) * (degree(primitive) + 1) {
        let coefficients = three(&harmonic(k))?;
        for (row, coefficient) in rows.sh_rest.chunks_exact_mut(per_row).zip(coefficients) {
            row[3 * (k - 1)..3 * k].copy_from_slice(&coefficient);
        }
    }
    Ok(rows)
}

/// The logarithm of a standard deviation. Zero, which has none, counts as the least positive number.
fn log_scale(scale: f32) -> f32 {
    // Comparison keeps NaN.
    if scale <= f32::MIN_POSITIVE { f32::MIN_POSITIVE.ln() } else { scale.ln() }
}

fn append(rows: &mut GaussianRows, mut more: GaussianRows) {
    rows.means.append(&mut more.means);
    rows.rotations.append(&mut more.rotations);
    rows.log_scales.append(&mut more.log_scales);
    rows.logit_opacities.append(&mut more.logit_opacities);
    rows.sh_dc.append(&mut more.sh_dc);
    rows.sh_rest.append(&mut more.sh_rest);
}
