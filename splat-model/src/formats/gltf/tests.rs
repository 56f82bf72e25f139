use std::fs;
use std::path::Path;

use glam::DVec3;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::EXTENSION;
use crate::formats::testing::fixture;
use crate::formats::{self, Format, SceneFile};
use crate::gaussians::GaussianRows;
use crate::mesh::Mesh;
use crate::ply::WorldFrame;

fn write(path: &Path, rows: &GaussianRows) {
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    formats::write(path, &scene, Format::Glb).unwrap();
}

/// The document of a binary container and its data.
fn parts(path: &Path) -> (Value, Vec<u8>) {
    let bytes = fs::read(path).unwrap();
    let json = 20 + u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    (serde_json::from_slice(&bytes[20..json]).unwrap(), bytes[json + 8..].to_vec())
}

/// The file as the extension describes it, read without the code of this folder.
#[test]
fn files_are_as_the_extension_says() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.glb");
    let mut given = formats::read(&fixture("given.ply")).unwrap().0.rows;
    given.log_scales[1][0] = -1e30;
    given.logit_opacities[1] = 90.0;
    write(&path, &given);
    let (document, data) = parts(&path);
    let primitive = &document["meshes"][0]["primitives"][0];
    assert_eq!((&primitive["mode"], &document["extensionsUsed"]), (&json!(0), &json!([EXTENSION])));
    let splatting = &primitive["extensions"][EXTENSION];
    assert_eq!((&splatting["kernel"], &splatting["colorSpace"]), (&json!("ellipse"), &json!("srgb_rec709_display")));
    let floats = |name: &str, width: usize| {
        let accessor = &document["accessors"][primitive["attributes"][name].as_u64().unwrap() as usize];
        assert_eq!((&accessor["count"], &accessor["componentType"]), (&json!(given.len()), &json!(5126)), "{name}");
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let at = view["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!((at % 4, &view["byteLength"]), (0, &json!(4 * width * given.len())), "{name}");
        let numbers = data[at..].as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        numbers.take(width * given.len()).collect::<Vec<f32>>()
    };
    let position = floats("POSITION", 3);
    let [x, y, z] = given.means[0];
    assert_eq!(position[..3], [-x, -y, z]);
    let least = position.iter().step_by(3).copied().fold(f32::INFINITY, f32::min);
    assert_eq!(document["accessors"][0]["min"][0], json!(f64::from(least)));
    let scale = floats("KHR_gaussian_splatting:SCALE", 3);
    assert!((scale[2] / given.log_scales[0][2].exp() - 1.0).abs() < 1e-6);
    let opacity = floats("KHR_gaussian_splatting:OPACITY", 1);
    assert!((opacity[0] - 1.0 / (1.0 + (-given.logit_opacities[0]).exp())).abs() < 1e-6);
    // Out of the range of floats.
    assert!(scale[3] > 0.0 && scale[3] < 1e-37 && opacity[1] == 1.0, "{} {}", scale[3], opacity[1]);
    let rotation = floats("KHR_gaussian_splatting:ROTATION", 4);
    assert!((rotation[..4].iter().map(|q| q * q).sum::<f32>() - 1.0).abs() < 1e-6);
    assert!((rotation[3] / rotation[2] - given.rotations[0][0] / given.rotations[0][3]).abs() < 1e-4);
    // Degree 2, order 1: the fourth of the second degree, which half a turn about z negates.
    let coefficient = floats("KHR_gaussian_splatting:SH_DEGREE_2_COEF_3", 3);
    assert_eq!(coefficient[..3], [18, 19, 20].map(|i| -given.sh_rest[i]));
    // The container's lengths.
    let length = |at: usize| u32::from_le_bytes(fs::read(&path).unwrap()[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((length(8), length(20 + length(12))), (fs::read(&path).unwrap().len(), data.len()));
}

/// A triangle as glTF has it: turned, wound as before, its colours in linear light.
#[test]
fn meshes_are_as_the_format_says() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("mesh.glb");
    let mesh = Mesh {
        positions: vec![[1.0, 2.0, 3.0], [4.0, 2.0, 3.0], [1.0, 6.0, 3.5]],
        normals: vec![[0.6, 0.0, 0.8]; 3],
        colours: vec![[0.0, 0.5, 1.0], [0.02, 0.5, 0.5], [1.0; 3]],
        triangles: vec![[0, 1, 2]],
    };
    let world = WorldFrame { metres_per_unit: Some(0.5), ..DVec3::new(1e6, 0.0, -7.0).into() };
    formats::write_mesh(&path, &mesh, world).unwrap();
    let (document, data) = parts(&path);
    assert_eq!(document["asset"]["extras"], json!({ "origin": [1e6, 0.0, -7.0], "metres_per_unit": 0.5 }));
    let primitive = &document["meshes"][0]["primitives"][0];
    assert_eq!(primitive["mode"], json!(4));
    assert_eq!(document["materials"][0]["extensions"], json!({ "KHR_materials_unlit": {} }));
    let bytes = |accessor: &Value, component: u32, shape: &str, count: usize| {
        let accessor = &document["accessors"][accessor.as_u64().unwrap() as usize];
        let found = (&accessor["componentType"], &accessor["type"], &accessor["count"]);
        assert_eq!(found, (&json!(component), &json!(shape), &json!(count)));
        let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [at, length] = ["byteOffset", "byteLength"].map(|name| view[name].as_u64().unwrap() as usize);
        data[at..at + length].to_vec()
    };
    let attributes = &primitive["attributes"];
    let floats =
        |bytes: Vec<u8>| bytes.as_chunks::<4>().0.iter().map(|of| f32::from_le_bytes(*of)).collect::<Vec<f32>>();
    let positions = floats(bytes(&attributes["POSITION"], 5126, "VEC3", 3));
    assert_eq!(positions, [-1.0, -2.0, 3.0, -4.0, -2.0, 3.0, -1.0, -6.0, 3.5]);
    assert_eq!(floats(bytes(&attributes["NORMAL"], 5126, "VEC3", 3))[..3], [-0.6, 0.0, 0.8]);
    let colours = bytes(&attributes["COLOR_0"], 5123, "VEC4", 3);
    let colours: Vec<u16> = colours.as_chunks::<2>().0.iter().map(|of| u16::from_le_bytes(*of)).collect();
    // Half of display-referred white is 21.4% of its light, 0.02 a thirteenth of itself.
    assert_eq!(colours[..5], [0, 14_027, 65_535, 65_535, 101]);
    assert_eq!(bytes(&primitive["indices"], 5125, "SCALAR", 3), [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
    assert_eq!(document["accessors"][0]["min"], json!([-4.0, -6.0, 3.0]));
}
