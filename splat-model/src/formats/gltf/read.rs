//! Reading of both containers.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

use glam::DAffine3;

use super::attribute::Attribute;
use super::buffers::{Buffer, Buffers};
use super::document::{Document, Primitive};
use super::{
    CHUNKS, COLOUR_SPACE, DEGREE_MAX, EXTENSION, KERNEL, MAGIC, OPACITY, POSITION, ROTATION, SCALE, VERSION, attribute,
    buffers, harmonic, nodes,
};
use crate::formats::frame::HalfTurn;
use crate::formats::{Format, FormatError, SceneFile, extras, limits, opacity};
use crate::gaussians::GaussianRows;
use crate::ply::{WorldFrame, brief};

/// Least number of bytes of buffers for each Gaussian, of which 28 are usual at the least. Several nodes may show one mesh, so that without this a
/// small file could ask for any number of Gaussians.
const BYTES_PER_GAUSSIAN: usize = 16;

/// Extensions that a file may require: the reader does what they ask for.
const REQUIRED: [&str; 2] = [EXTENSION, "KHR_mesh_quantization"];

/// The Gaussians of a file, read some at a time. A binary container's are in memory only then.
pub(in crate::formats) struct GltfRows<'a> {
    path: &'a Path,
    /// What the file holds besides its rows.
    pub about: SceneFile,
    primitives: Vec<(PrimitiveRows, DAffine3)>,
    buffers: Buffers,
    count: usize,
    sh_degree: usize,
    next: usize,
}

impl<'a> GltfRows<'a> {
    /// Opens a binary container.
    pub fn open_binary(path: &'a Path) -> Result<Self, FormatError> {
        let broken = |detail: String| FormatError::broken(path, Format::Glb, detail);
        let mut file = File::open(path).map_err(FormatError::io(path, "open the scene (is the path right?)"))?;
        let bytes = file.metadata().map_err(FormatError::io(path, "read the size of the file"))?.len();
        let truncated = |name: &str, found: u64, expected: u64| {
            broken(format!("{name}: {found} bytes, expected {expected}; it is truncated"))
        };
        let next = |file: &mut File, name: &str, bytes: u64| {
            let mut found = Vec::new();
            let read = file.take(bytes).read_to_end(&mut found);
            read.map_err(|error| broken(format!("{name}: {error}")))?;
            match found.len() as u64 == bytes {
                true => Ok(found),
                false => Err(truncated(name, found.len() as u64, bytes)),
            }
        };
        let word =
            |bytes: &[u8], at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let header = next(&mut file, "header", 12)?;
        let (version, length) = (word(&header, 4), u64::from(word(&header, 8)));
        if header[..4] != MAGIC || version != VERSION || length > bytes {
            return Err(broken(format!(
                "a header of version {version} and {length} bytes, expected version {VERSION} and at most the {bytes} bytes of the file"
            )));
        }
        let (mut json, mut binary) = (None, None);
        let mut at = 12;
        while at < length && (json.is_none() || binary.is_none()) {
            let head = next(&mut file, "header of a chunk", 8)?;
            at += 8;
            let (len, left) = (u64::from(word(&head, 0)), bytes.saturating_sub(at));
            if len > left {
                return Err(truncated("chunk", left, len));
            }
            match CHUNKS.iter().position(|kind| *kind == head[4..8]) {
                Some(0) if json.is_none() => json = Some(next(&mut file, "chunk", len)?),
                Some(1) if binary.is_none() => binary = Some((at, len as usize)),
                // Chunks of other types are skipped, as the format says.
                _ => {}
            }
            at += len;
            file.seek(SeekFrom::Start(at)).map_err(|error| broken(format!("chunk: {error}")))?;
        }
        let json = json.ok_or_else(|| broken("no JSON chunk".into()))?;
        let binary = binary.map(|(first, len)| Buffer::InFile { file, first, len });
        Self::of(path, &json, binary).map_err(broken)
    }

    /// Opens a document whose JSON is `json`.
    pub fn open_text(path: &'a Path, json: &[u8]) -> Result<Self, FormatError> {
        Self::of(path, json, None).map_err(|detail| FormatError::broken(path, Format::Gltf, detail))
    }

    fn of(path: &'a Path, json: &[u8], binary: Option<Buffer>) -> Result<Self, String> {
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
        let buffers = buffers::load(&document, path, binary)?;
        let bytes = buffers.values().map(Buffer::len).sum::<usize>();
        if count.saturating_mul(BYTES_PER_GAUSSIAN) > bytes {
            return Err(format!("{count} Gaussians, more than its {bytes} bytes of buffers can hold"));
        }
        let mut found = Vec::new();
        for (mesh, world_from_mesh) in shown {
            // Whether its transform is one of Gaussians is known without them.
            nodes::transform(&mut GaussianRows::default(), &world_from_mesh)?;
            for primitive in primitives(mesh) {
                found.push((PrimitiveRows::find(&document, &buffers, primitive)?, world_from_mesh));
            }
        }
        let extras = &document.asset.extras;
        let WorldFrame { origin, metres_per_unit, trained } = extras::world(extras);
        let antialiased = extras["antialiased"] == true;
        let about = SceneFile { origin, metres_per_unit, antialiased, trained, ..SceneFile::default() };
        Ok(Self { path, about, primitives: found, buffers, count, sh_degree, next: 0 })
    }

    /// Number of Gaussians and degree of their harmonics.
    pub fn size(&self) -> (usize, usize) {
        (self.count, self.sh_degree)
    }

    /// Begins anew.
    pub fn rewind(&mut self) {
        self.next = 0;
    }

    /// The next Gaussians, at most so many; none at the end.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn next_rows(&mut self, most: usize) -> Result<GaussianRows, FormatError> {
        let which = self.next..self.count.min(self.next.saturating_add(most));
        self.next = which.end;
        let mut rows = GaussianRows { sh_degree: self.sh_degree, ..GaussianRows::default() };
        let mut first = 0;
        for (primitive, world_from_mesh) in &self.primitives {
            let own = first..first + primitive.count;
            first = own.end;
            let (start, end) = (which.start.max(own.start), which.end.min(own.end));
            if start >= end {
                continue;
            }
            let mut more = primitive
                .rows(&self.buffers, start - own.start..end - own.start, self.sh_degree)
                .map_err(FormatError::io(self.path, "read the scene (did it change?)"))?;
            nodes::transform(&mut more, world_from_mesh).expect("checked when the file was opened");
            append(&mut rows, more);
        }
        HalfTurn::Z.turn(&mut rows);
        Ok(rows)
    }
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

/// The attributes of a primitive's Gaussians.
struct PrimitiveRows {
    count: usize,
    means: Attribute<3>,
    scales: Attribute<3>,
    rotations: Attribute<4>,
    opacities: Attribute<1>,
    harmonics: Vec<Attribute<3>>,
}

impl PrimitiveRows {
    fn find(document: &Document, buffers: &Buffers, primitive: &Primitive) -> Result<Self, String> {
        let count = attribute::count(document, primitive)?;
        let three = |name: &str| Attribute::find(document, buffers, primitive, name, count);
        let coefficients = (degree(primitive) + 1) * (degree(primitive) + 1);
        Ok(Self {
            count,
            means: three(POSITION)?,
            scales: three(SCALE)?,
            rotations: Attribute::find(document, buffers, primitive, ROTATION, count)?,
            opacities: Attribute::find(document, buffers, primitive, OPACITY, count)?,
            harmonics: (0..coefficients).map(|k| three(&harmonic(k))).collect::<Result<_, _>>()?,
        })
    }

    /// Some Gaussians in glTF's frame, with zeros for harmonics above the primitive's degree.
    fn rows(&self, buffers: &Buffers, which: Range<usize>, sh_degree: usize) -> io::Result<GaussianRows> {
        let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
        rows.means = self.means.read(buffers, which.clone())?;
        rows.log_scales = self.scales.read(buffers, which.clone())?;
        rows.log_scales.as_flattened_mut().iter_mut().for_each(|scale| *scale = limits::log_of(*scale));
        rows.rotations = self.rotations.read(buffers, which.clone())?;
        for rotation in &mut rows.rotations {
            // The scalar comes first here.
            rotation.rotate_right(1);
        }
        let opacities = self.opacities.read(buffers, which.clone())?;
        rows.logit_opacities = opacities.into_iter().map(|[opacity]| opacity::logit_of(opacity)).collect();
        rows.sh_dc = self.harmonics[0].read(buffers, which.clone())?;
        let per_row = rows.rest_per_row();
        rows.sh_rest = vec![0.0; which.len() * per_row];
        for (k, attribute) in self.harmonics.iter().enumerate().skip(1) {
            let coefficients = attribute.read(buffers, which.clone())?;
            for (row, coefficient) in rows.sh_rest.chunks_exact_mut(per_row).zip(coefficients) {
                row[3 * (k - 1)..3 * k].copy_from_slice(&coefficient);
            }
        }
        Ok(rows)
    }
}

fn append(rows: &mut GaussianRows, mut more: GaussianRows) {
    rows.means.append(&mut more.means);
    rows.rotations.append(&mut more.rotations);
    rows.log_scales.append(&mut more.log_scales);
    rows.logit_opacities.append(&mut more.logit_opacities);
    rows.sh_dc.append(&mut more.sh_dc);
    rows.sh_rest.append(&mut more.sh_rest);
}
