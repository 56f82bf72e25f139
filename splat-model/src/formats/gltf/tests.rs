use std::fs;
use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use proptest::prelude::*;
use serde_json::{Value, json};
use splat_op::sh::harmonics;
use tempfile::TempDir;

use super::{EXTENSION, harmonic};
use crate::formats::testing::{fixture, rows};
use crate::formats::{self, Format, QuantisationError, SceneFile};
use crate::gaussians::GaussianRows;

fn write(path: &Path, rows: &GaussianRows, format: Format) {
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    formats::write(path, &scene, format).unwrap();
}

fn read(path: &Path) -> GaussianRows {
    formats::read(path).unwrap().0.rows
}

/// What `exp`, the logistic function and normalisation round in f32; everything else is the same to the last bit.
fn assert_same(written: &GaussianRows, read: &GaussianRows) {
    assert_eq!((&written.means, &written.sh_dc, &written.sh_rest), (&read.means, &read.sh_dc, &read.sh_rest));
    let loss = QuantisationError::between(written, read);
    assert!(loss.scale.largest < 2e-6 && loss.opacity.largest < 3e-7 && loss.rotation.largest < 1e-4, "{loss:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn nothing_is_lost_but_the_rounding_of_functions(rows in (0_usize..=3, 1_usize..20).prop_flat_map(|(degree, count)| rows(count, degree, 1e3))) {
        let folder = TempDir::new().unwrap();
        for format in [Format::Glb, Format::Gltf] {
            let path = folder.path().join("scene");
            write(&path, &rows, format);
            prop_assert_eq!(formats::detect(&path).unwrap(), format);
            assert_same(&rows, &read(&path));
        }
    }
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
    write(&path, &given, Format::Glb);
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
    let back = read(&path);
    assert_eq!((back.log_scales[1][0], back.len()), (-87.0, given.len()));
    assert!(back.logit_opacities[1].is_finite() && back.logit_opacities[1] > 17.0, "{}", back.logit_opacities[1]);
}

/// `splat-transform` wrote the file from `given.ply` (see `tests/scenes/README.md`).
#[test]
fn files_of_splat_transform_are_read() {
    let given = formats::read(&fixture("given.ply")).unwrap().0.rows;
    let (scene, format) = formats::read(&fixture("splat-transform.glb")).unwrap();
    assert_eq!(format, Format::Glb);
    // It turns a Gaussian with its axes, which leaves another quaternion for the same ellipsoid.
    let ellipsoid = |rows: &GaussianRows, i: usize| {
        let [w, x, y, z] = rows.rotations[i].map(f64::from);
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scales = DVec3::from_array(rows.log_scales[i].map(|log| f64::from(log).exp()));
        (axes * DMat3::from_diagonal(scales * scales) * axes.transpose(), scales.max_element())
    };
    for i in 0..given.len() {
        let ((ours, size), (theirs, _)) = (ellipsoid(&given, i), ellipsoid(&scene.rows, i));
        assert!((ours - theirs).to_cols_array().iter().all(|x| x.abs() < 1e-5 * size * size), "{i}: {ours} {theirs}");
    }
    assert_same(&given, &GaussianRows { rotations: given.rotations.clone(), ..scene.rows });
}

/// A document whose data is in a file beside it, with one primitive of one Gaussian in quantised attributes, 20 bytes apart.
fn quantised(folder: &Path, node: &Value) -> std::path::PathBuf {
    let mut data: Vec<u8> = Vec::new();
    data.extend([1.0_f32, -2.0, 3.0].map(f32::to_le_bytes).concat());
    data.extend([0.5_f32, 0.25, -0.125].map(f32::to_le_bytes).concat());
    data.extend([0_i16, 0, i16::MIN, 0].map(i16::to_le_bytes).concat());
    data.extend([2_u8, 1, 3, 204]);
    fs::write(folder.join("a b.bin"), &data).unwrap();
    let accessor = |at: usize, kind: u32, shape: &str, normalized: bool| json!({ "bufferView": 0, "byteOffset": at, "componentType": kind, "type": shape, "count": 1, "normalized": normalized });
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsRequired": [EXTENSION, "KHR_mesh_quantization"],
        "scenes": [{ "nodes": [1] }],
        "nodes": [node, { "children": [0], "translation": [10, 0, 0] }],
        "meshes": [{ "primitives": [{ "attributes": {} }, { "mode": 0, "attributes": {
            "POSITION": 0, "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0": 1, "KHR_gaussian_splatting:ROTATION": 2,
            "KHR_gaussian_splatting:SCALE": 3, "KHR_gaussian_splatting:OPACITY": 4
        }, "extensions": { EXTENSION: { "kernel": "ellipse", "colorSpace": "srgb_rec709_display" } } }] }],
        "accessors": [
            accessor(0, 5126, "VEC3", false), accessor(12, 5126, "VEC3", false), accessor(24, 5122, "VEC4", true),
            accessor(32, 5121, "VEC3", false), accessor(35, 5121, "SCALAR", true)
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 36, "byteStride": 40 }],
        "buffers": [{ "byteLength": 36, "uri": "a%20b.bin" }]
    });
    let path = folder.join("scene.gltf");
    fs::write(&path, document.to_string()).unwrap();
    path
}

#[test]
fn quantised_attributes_and_files_beside_the_document_are_read() {
    let folder = TempDir::new().unwrap();
    let path = quantised(folder.path(), &json!({ "mesh": 0 }));
    assert_eq!(crate::formats::files(&path), [path, folder.path().join("a b.bin")]);
    let rows = read(&quantised(folder.path(), &json!({ "mesh": 0 })));
    assert_eq!((rows.len(), rows.means[0]), (1, [-11.0, 2.0, 3.0]));
    assert_eq!((rows.rotations[0], rows.sh_dc[0]), ([0.0, 0.0, 0.0, -1.0], [0.5, 0.25, -0.125]));
    assert_eq!(rows.log_scales[0], [2.0_f32.ln(), 0.0, 3.0_f32.ln()]);
    assert!((rows.logit_opacities[0] - 4.0_f32.ln()).abs() < 1e-6);
    // A node that is turned and twice as large.
    let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 1.1);
    let node = json!({ "mesh": 0, "rotation": turn.to_array(), "scale": [2, 2, 2] });
    let turned = read(&quantised(folder.path(), &node));
    let mean = DVec3::new(10.0, 0.0, 0.0) + 2.0 * (turn * DVec3::new(1.0, -2.0, 3.0));
    let found = DVec3::from_array(turned.means[0].map(f64::from));
    assert!(found.distance(DVec3::new(-mean.x, -mean.y, mean.z)) < 1e-5, "{found} {mean}");
    assert!((turned.log_scales[0][1] - 2.0_f32.ln()).abs() < 1e-6);
}

/// A turned scene has, in the turned direction, the colours that the scene has.
#[test]
fn harmonics_turn_with_their_node() {
    let turn = DQuat::from_axis_angle(DVec3::new(-0.6, 0.48, 0.64), 2.0);
    for sh_degree in 1..=3 {
        let count = (sh_degree + 1) * (sh_degree + 1);
        let before = GaussianRows {
            means: vec![[0.0; 3]; 2],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            log_scales: vec![[0.0; 3]; 2],
            logit_opacities: vec![0.0; 2],
            sh_dc: vec![[0.0; 3]; 2],
            sh_rest: (0..6 * (count - 1)).map(|i| (i as f32).sin()).collect(),
            sh_degree,
        };
        let mut after = before.clone();
        super::nodes::transform(&mut after, &DAffine3::from_quat(turn)).unwrap();
        let colour = |rows: &GaussianRows, d: DVec3| {
            let y = harmonics(d.to_array(), sh_degree);
            let row = &rows.sh_rest[rows.rest_per_row()..];
            (1..count).map(|k| y[k] * f64::from(row[3 * (k - 1) + 1])).sum::<f64>()
        };
        for d in [DVec3::X, DVec3::new(0.48, 0.6, 0.64), DVec3::new(0.0, -0.6, 0.8)] {
            assert!((colour(&before, d) - colour(&after, turn * d)).abs() < 1e-5, "degree {sh_degree}, {d}");
        }
    }
}

#[test]
fn transforms_that_gaussians_do_not_follow_are_refused() {
    let mut rows = GaussianRows::default();
    let mirrored = DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0));
    let stretched = DAffine3::from_scale(DVec3::new(1.0, 1.1, 1.0));
    let sheared = DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.1, 1.0, 0.0), DVec3::Z));
    let nowhere = DAffine3::from_translation(DVec3::new(f64::NAN, 0.0, 0.0));
    for bad in [mirrored, stretched, sheared, nowhere, DAffine3::from_scale(DVec3::ZERO)] {
        let message = super::nodes::transform(&mut rows, &bad).unwrap_err();
        assert!(message.contains("transform"), "{message}");
    }
}

#[test]
fn what_is_wrong_in_a_document_is_named() {
    let folder = TempDir::new().unwrap();
    let path = quantised(folder.path(), &json!({ "mesh": 0 }));
    let whole = fs::read_to_string(&path).unwrap();
    let cases = [
        ("\"ellipse\"", "\"customShape\"", "`kernel` is `customShape`, expected `ellipse`"),
        ("\"srgb_rec709_display\"", "\"lin_rec709_display\"", "`colorSpace`"),
        (
            "\"kernel\"",
            "\"extensions\":{\"KHR_gaussian_splatting_compression_spz_2\":{}},\"kernel\"",
            "compression_spz_2",
        ),
        (
            "\"KHR_mesh_quantization\"",
            "\"EXT_meshopt_compression\"",
            "requires the extension `EXT_meshopt_compression`",
        ),
        ("\"version\":\"2.0\"", "\"version\":\"1.0\"", "version `1.0`, expected 2.0"),
        ("\"children\":[0]", "\"children\":[1]", "node 1 has two parents"),
        ("\"children\":[0]", "\"children\":[7]", "no node 7"),
        ("\"mesh\":0", "\"mesh\":3", "no mesh 3"),
        ("\"mesh\":0", "\"mesh\":-3", "JSON"),
        (
            "KHR_gaussian_splatting:OPACITY",
            "KHR_gaussian_splatting:SH_DEGREE_1_COEF_0",
            "without `KHR_gaussian_splatting:OPACITY`",
        ),
        ("\"POSITION\":0", "\"POSITION\":9", "no accessor 9"),
        ("\"VEC4\"", "\"VEC3\"", "elements `VEC3`, expected 1 elements `VEC4`"),
        ("\"componentType\":5122", "\"componentType\":5125", "components of type 5125"),
        ("\"byteStride\":40", "\"byteStride\":1", "1 bytes apart"),
        ("\"byteOffset\":24", "\"byteOffset\":30", "are not all within"),
        ("\"bufferView\":0", "\"count\":1", "JSON"),
        ("\"byteLength\":36,\"uri\"", "\"byteLength\":37,\"uri\"", "36 bytes, expected `byteLength` 37"),
        ("a%20b.bin", "../a.bin", "expected the name of a file in the folder"),
        ("a%20b.bin", "%2e%2e/a.bin", "expected the name of a file in the folder"),
        ("a%20b.bin", "none.bin", "`none.bin` beside the document cannot be read"),
        ("a%20b.bin", "data:text/plain,abc", "expected base64"),
        ("a%20b.bin", "data:;base64,!", "not base64"),
        (&format!("\"{EXTENSION}\":{{\""), "\"other\":{\"", "has the extension `KHR_gaussian_splatting`"),
    ];
    for (from, to, part) in cases {
        assert!(whole.contains(from), "{from}");
        fs::write(&path, whole.replace(from, to)).unwrap();
        let message = formats::read(&path).unwrap_err().to_string();
        assert!(
            message.contains(part) && message.contains("scene.gltf") && message.contains("export it again"),
            "{part}: {message}"
        );
    }
    // A coefficient of a degree without the others.
    let extra = format!("\"POSITION\":0,\"{}\":0", harmonic(6));
    fs::write(&path, whole.replace("\"POSITION\":0", &extra)).unwrap();
    let message = formats::read(&path).unwrap_err().to_string();
    assert!(message.contains("SH_DEGREE_1_COEF_0"), "{message}");
    // Other JSON.
    fs::write(&path, "{\"steps\": 5}").unwrap();
    assert!(formats::read(&path).unwrap_err().to_string().contains("not a scene"));
}

/// Many nodes may show one mesh, and would ask for memory without bound.
#[test]
fn a_mesh_that_is_shown_too_often_is_refused() {
    let folder = TempDir::new().unwrap();
    let path = quantised(folder.path(), &json!({ "mesh": 0 }));
    let text = fs::read_to_string(&path).unwrap();
    let mut document: Value = serde_json::from_str(&text).unwrap();
    document["nodes"] = json!(vec![json!({ "mesh": 0 }); 50]);
    document["scenes"] = json!([{ "nodes": (0..50).collect::<Vec<usize>>() }]);
    fs::write(&path, document.to_string()).unwrap();
    let message = formats::read(&path).unwrap_err().to_string();
    assert!(message.contains("50 Gaussians, more than its 36 bytes"), "{message}");
}

#[test]
fn containers_are_not_believed() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.glb");
    let given = formats::read(&fixture("given.ply")).unwrap().0.rows;
    write(&path, &given, Format::Glb);
    let bytes = fs::read(&path).unwrap();
    let refuse = |bytes: &[u8], part: &str| {
        fs::write(&path, bytes).unwrap();
        let message = formats::read(&path).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("scene.glb"), "{part}: {message}");
    };
    let changed = |at: usize, word: u32| {
        let mut changed = bytes.clone();
        changed[at..at + 4].copy_from_slice(&word.to_le_bytes());
        changed
    };
    refuse(&changed(4, 1), "version 1");
    refuse(&changed(8, u32::MAX), "4294967295 bytes");
    refuse(&changed(12, u32::MAX), "truncated");
    refuse(&changed(16, 0), "no JSON chunk");
    // Without its second chunk.
    let json = u32::from_le_bytes(bytes[12..16].try_into().unwrap());
    refuse(&changed(8, 20 + json), "no binary chunk");
    let short = changed(20 + json as usize, 8);
    refuse(&short, "8 bytes, expected `byteLength`");
    // Its data is read later, and has to be there.
    let data = u32::from_le_bytes(bytes[20 + json as usize..24 + json as usize].try_into().unwrap());
    refuse(&changed(20 + json as usize, data + 1), "truncated");
}
