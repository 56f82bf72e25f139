//! Triangle meshes as glTF.
//!
//! `COLOR_0` is linear in glTF (§3.9.2), and viewers take it so: display-referred colours are decoded by sRGB's curve, and take 16 bits,
//! because 8 linear ones show steps in what is dark. The light of the photographs is in the colours: the material has
//! `KHR_materials_unlit`, beside the values of a matte one for programs without it, and both sides show.

use std::path::Path;

use serde_json::json;

use super::container::{self, Attribute, UNSIGNED_INT, UNSIGNED_SHORT, floats, positions, turned};
use super::extras;
use crate::FileError;
use crate::mesh::Mesh;
use crate::ply::WorldFrame;

/// Name of the extension of materials that no light changes.
const UNLIT: &str = "KHR_materials_unlit";

/// Linear light of a display-referred value, as 16 bits (IEC 61966-2-1).
fn linear(value: f32) -> u16 {
    let light = if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
    // The cast clamps.
    (65_535.0 * light).round() as u16
}

/// Writes a mesh as binary glTF (`.glb`): positions, normals, colours and 32-bit indices. `world` gives the origin and the size of a unit, for
/// `asset.extras`. Positions are turned to glTF's left-up-front.
///
/// The file appears under its name only when it is complete; a file that was there before is replaced.
///
/// # Errors
/// If the file cannot be written, or would exceed 4 GiB.
pub fn write_mesh(path: &Path, mesh: &Mesh, world: WorldFrame) -> Result<(), FileError> {
    let count = mesh.positions.len();
    let colour = |&[r, g, b]: &[f32; 3]| [linear(r), linear(g), linear(b), u16::MAX].map(u16::to_le_bytes);
    let colours = mesh.colours.iter().flat_map(colour).flatten().collect();
    let indices = mesh.triangles.iter().flatten().flat_map(|index| index.to_le_bytes()).collect();
    let attributes = [
        positions(&mesh.positions),
        floats("NORMAL", turned(&mesh.normals)),
        Attribute::new("COLOR_0", UNSIGNED_SHORT, 4, count, colours),
        Attribute::new("", UNSIGNED_INT, 1, 3 * mesh.triangles.len(), indices),
    ];
    let surface = json!({ "metallicFactor": 0, "roughnessFactor": 1 });
    let material = json!({ "pbrMetallicRoughness": surface, "doubleSided": true, "extensions": { UNLIT: {} } });
    let root = json!({ "extensionsUsed": [UNLIT], "materials": [material] });
    container::write(path, &attributes, json!({ "mode": 4, "material": 0 }), extras::of(world), root)
}
