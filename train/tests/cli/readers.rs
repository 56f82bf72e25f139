//! Our files in other projects' readers, which run under node. `npm ci --prefix tests/readers` installs them; without them these tests say
//! so and pass, and with `SPLAT_READERS=require` they fail.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use splat_model::formats::{self, Format, QuantisationError, SceneFile};
use splat_model::gaussians::GaussianRows;
use splat_model::ply::TrainedAs;

use crate::run::{DEMO, TRAINED, splat, succeed};
use crate::text;

/// The folder of the readers, if they can run.
fn readers() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/readers");
    let runs = Command::new("node").arg("--version").output().is_ok_and(|output| output.status.success());
    if runs && folder.join("node_modules").is_dir() {
        return Some(folder);
    }
    let lacking = "no node, or no `npm ci --prefix tests/readers`";
    assert!(std::env::var("SPLAT_READERS").as_deref() != Ok("require"), "SPLAT_READERS=require, and {lacking}");
    // Written past the test harness, which swallows the output of passing tests.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {lacking} (SPLAT_READERS=require makes that a failure)");
    None
}

/// Runs a script of the readers and returns what it writes.
fn node(folder: &Path, arguments: &[&str]) -> String {
    let output = Command::new("node").current_dir(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The trained scene with harmonics of degree 3, which training to a lower degree leaves at zero.
fn scene() -> GaussianRows {
    let mut rows = formats::read(&TRAINED.join("scene.ply")).unwrap().0.rows;
    rows.sh_degree = 3;
    rows.sh_rest = (0..45 * rows.len()).map(|i| 0.5 * (i as f32 * 0.7).sin()).collect();
    rows
}

/// PlayCanvas' converter reads our SPZ of version 4, with the reference's own code, and our SOG to the numbers that we read.
#[test]
fn splat_transform_reads_our_files_as_we_do() {
    let Some(folder) = readers() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let given = scratch.path().join("given.ply");
    formats::write(&given, &SceneFile { rows: scene(), ..SceneFile::default() }, Format::Ply).unwrap();
    for format in [Format::Spz, Format::Sog] {
        let ours = scratch.path().join(format!("scene{}", format.extension()));
        let theirs = scratch.path().join("theirs.ply");
        succeed(&mut splat(&["convert", text(&given), text(&ours)]));
        node(&folder, &["node_modules/@playcanvas/splat-transform/bin/cli.mjs", "-w", text(&ours), text(&theirs)]);
        let [ours, theirs] = [&ours, &theirs].map(|path| formats::read(path).unwrap().0.rows);
        assert_eq!((theirs.len(), theirs.sh_degree), (ours.len(), 3), "{format}");
        let loss = QuantisationError::between(&ours, &theirs);
        assert!(
            loss.position.largest < 1e-5 && loss.scale.largest < 1e-5 && loss.colour.largest < 1e-5,
            "{format}: {loss:?}"
        );
        // Opacities of 0 and 1 are read a quarter of a level inside here.
        assert!(
            loss.opacity.largest < 2e-3 && loss.rotation.largest < 1e-2 && loss.harmonics.largest < 1e-5,
            "{format}: {loss:?}"
        );
    }
}

/// three.js reads every value of our glTF, its extension for Gaussians accepts the file, and Khronos' validator finds no error.
#[test]
fn three_and_the_validator_of_khronos_accept_our_gltf() {
    let Some(folder) = readers() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("scene.glb");
    let scene = SceneFile {
        rows: scene(),
        origin: [1e6, 0.0, 0.0].into(),
        metres_per_unit: Some(0.5),
        trained: TrainedAs { antialias: true, ..TrainedAs::default() },
    };
    formats::write(&path, &scene, Format::Glb).unwrap();
    let found: Value = serde_json::from_str(&node(&folder, &["glb.mjs", text(&path)])).unwrap();
    assert_eq!((&found["splats"], &found["problems"]), (&scene.rows.len().into(), &Value::Array(Vec::new())));
    let theirs: Vec<Vec<f64>> = serde_json::from_value(found["rows"].clone()).unwrap();
    assert_eq!(theirs.len(), scene.rows.len());
    // Half a turn about z: harmonics of odd order change their sign. In the order of names, which is that of degrees.
    let rows = &scene.rows;
    let signs: Vec<f64> =
        (0..16_i32).map(|k| k - k.isqrt() * (k.isqrt() + 1)).map(|m| if m % 2 == 0 { 1.0 } else { -1.0 }).collect();
    for (i, row) in theirs.iter().enumerate() {
        let near = |at: usize, expected: f64| {
            assert!(
                (row[at] - expected).abs() <= 2e-6 * expected.abs().max(1.0),
                "splat {i}, {at}: {}, expected {expected}",
                row[at]
            );
        };
        let [w, x, y, z] = rows.rotations[i].map(f64::from);
        let length = [w, x, y, z].iter().map(|q| q * q).sum::<f64>().sqrt();
        for axis in 0..3 {
            near(axis, [-1.0, -1.0, 1.0][axis] * f64::from(rows.means[i][axis]));
            near(3 + axis, f64::from(rows.log_scales[i][axis]).exp());
            near(11 + axis, f64::from(rows.sh_dc[i][axis]));
        }
        for (at, expected) in [-x, -y, z, w].into_iter().enumerate() {
            near(6 + at, expected / length);
        }
        near(10, (1.0 + f64::from(-rows.logit_opacities[i]).exp()).recip());
        for k in 3..48 {
            near(11 + k, signs[k / 3] * f64::from(rows.sh_rest[45 * i + k - 3]));
        }
    }
}

/// Khronos' validator finds nothing wrong with a mesh, and three.js reads its triangles.
#[test]
fn three_and_the_validator_of_khronos_accept_our_meshes() {
    let Some(folder) = readers() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let (scene, path) = (TRAINED.join("scene.ply"), scratch.path().join("mesh.glb"));
    succeed(&mut splat(&["mesh", text(&scene), "--capture", text(&DEMO), "--out", text(&path)]));
    let found: Value = serde_json::from_str(&node(&folder, &["glb.mjs", text(&path)])).unwrap();
    assert_eq!(found["problems"], Value::Array(Vec::new()));
    assert!(found["triangles"].as_u64().is_some_and(|triangles| triangles > 500), "{}", found["triangles"]);
}
