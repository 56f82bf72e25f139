use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tempfile::TempDir;

use super::EXTENSION;
use crate::formats::testing::fixture;
use crate::formats::{self, Format, SceneFile};
use crate::gaussians::GaussianRows;

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
