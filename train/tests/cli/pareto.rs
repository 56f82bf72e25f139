//! `splat pareto`, and the presets of `--accuracy`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::run::{DEMO, TRAINED, end, fresh, refuse, splat, succeed};
use crate::{files, json, text};

/// Output of the command for the trained demo scene.
static MEASURED: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("pareto");
    let scene = TRAINED.join("scene.ply");
    let arguments = ["pareto", text(&DEMO), "--scene", text(&scene), "--max-side", "64", "--budget", "0"];
    let ended = succeed(splat(&arguments).arg("--out").arg(&folder));
    for part in ["measured every setting 3 times", "the frontier of renders", "pareto.csv"] {
        assert!(ended.stdout.contains(part), "{part}: {}", ended.stdout);
    }
    folder
});

/// The fields of a line of RFC 4180.
fn fields(line: &str) -> Vec<String> {
    let (mut found, mut quoted) = (vec![String::new()], false);
    for character in line.chars() {
        match character {
            '"' => quoted = !quoted,
            ',' if !quoted => found.push(String::new()),
            other => found.last_mut().unwrap().push(other),
        }
    }
    assert!(!quoted, "{line}");
    found
}

/// Returns the table, by name of the setting and then of the column.
fn rows(folder: &Path) -> Vec<std::collections::BTreeMap<String, String>> {
    let table = fs::read_to_string(folder.join("pareto.csv")).unwrap();
    let mut lines = table.split("\r\n").filter(|line| !line.is_empty());
    let header = fields(lines.next().unwrap());
    let row = |line: &str| {
        let fields = fields(line);
        assert_eq!(fields.len(), header.len(), "{line}");
        header.iter().cloned().zip(fields).collect()
    };
    lines.map(row).collect()
}

fn number(row: &std::collections::BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column}: {row:?}"))
}

#[test]
fn every_setting_is_measured() {
    let out = MEASURED.as_path();
    assert_eq!(files(out), ["pareto.csv".to_string()].into());
    let rows = rows(out);
    let named = |name: &str| rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("no {name}"));
    for row in &rows {
        for column in ["forward_ms", "backward_ms", "step_ms", "psnr_db", "ssim"] {
            assert!(number(row, column) > 0.0, "{column}: {row:?}");
        }
        assert!(number(row, "forward_ms_lower") <= number(row, "forward_ms_upper"));
        assert_eq!(row["judged_by"] == "photographs", row["error_db"].is_empty(), "{row:?}");
    }
    // The order that the dials exist for.
    let db = |name: &str| number(named(name), "error_db");
    assert!(db("exact") > 90.0 && db("exact") > db("standard"), "{}", db("exact"));
    assert!(db("standard") > db("all coarse"));
    assert!(number(named("exact"), "gradient_error") < number(named("all coarse"), "gradient_error"));
    assert!(number(named("exact"), "gradient_cosine") > 0.999_99);
    assert_eq!(named("fast")["turned"], "alpha_min 4/255, transmittance_min 1e-3");
    assert!(!rows.iter().any(|row| row["name"].contains("accumulation")), "it does nothing on a CPU");
    assert!(rows.iter().any(|row| row["on_frontier"] == "1") && rows.iter().any(|row| row["role"] == "dial sh_degree"));
}

#[test]
fn presets_change_the_pictures() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), TRAINED.join("scene.ply"));
    let arguments = ["render", "--scene", text(&scene), "--capture", text(&DEMO), "--view", "0000.png"];
    let render = |options: &[&str], out: &str| {
        let out = folder.path().join(out);
        succeed(splat(&[&arguments[..], options].concat()).arg("--out").arg(&out));
        fs::read(out.join("0000.png")).unwrap()
    };
    let pictures = ["fast", "standard", "exact"].map(|preset| render(&["--accuracy", preset], preset));
    assert!(pictures[0] != pictures[1] && pictures[1] == render(&[], "default"));
}

#[test]
fn training_turns_dials_too() {
    let folder = tempfile::tempdir().unwrap();
    let train = |options: &[&str]| {
        let always = ["train", text(&DEMO), "--steps", "20", "--max-side", "64", "--out", text(folder.path())];
        succeed(&mut splat(&[&always[..], options].concat()));
        json(&folder.path().join("metrics.json"))
    };
    let metrics = train(&["--accuracy", "fast"]);
    let dials = serde_json::json!({"alpha_min": "4/255", "transmittance_min": "1e-3"});
    assert_eq!(metrics["options"]["dials"], dials);
    let scene = || fs::read(folder.path().join("scene.ply")).unwrap();
    let fast = scene();
    train(&["--accuracy", "standard"]);
    let standard = scene();
    assert_ne!(fast, standard, "the steps took no notice");
    train(&[]);
    assert_eq!(scene(), standard, "it is what is taken without being asked");
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (TRAINED.join("scene.ply"), folder.path().join("out"));
    let pareto = |scene: &Path, options: &[&str]| {
        let mut command = splat(&["pareto", text(&DEMO), "--scene", text(scene), "--out", text(&out)]);
        command.args(options);
        command
    };
    let missing = folder.path().join("none.ply");
    refuse(&mut pareto(&missing, &[]), &[text(&missing), "--scene"]);
    refuse(&mut pareto(&scene, &["--test-every", "0"]), &["8 views", "--test-every"]);
    assert!(!out.exists(), "no folder is made for a run that cannot start");
    let unknown = end(&mut splat(&["pareto", "capture", "--scene", "a", "--out", "b", "--device", "abacus"]));
    assert!(unknown.code == Some(2) && unknown.stderr.contains("abacus"), "{unknown:?}");
    assert_eq!(end(&mut pareto(&scene, &["--views", "0"])).code, Some(2));
    fs::write(&out, "a file").unwrap();
    refuse(&mut pareto(&scene, &[]), &[text(&out), "--out"]);
    let nowhere = folder.path().join("nowhere");
    refuse(
        &mut splat(&["pareto", text(&nowhere), "--scene", text(&scene), "--out", text(&out)]),
        &[text(&nowhere), "no capture folder"],
    );
}

#[test]
fn a_scene_that_fell_apart_is_said_to_have() {
    // One Gaussian of it cannot be rendered; the others are measured.
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ply");
    let mut bytes = fs::read(TRAINED.join("scene.ply")).unwrap();
    let header = b"end_header\n";
    let start = bytes.windows(header.len()).position(|window| window == header).unwrap() + header.len();
    bytes[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&scene, bytes).unwrap();
    let out = folder.path().join("out");
    let arguments =
        ["pareto", text(&DEMO), "--scene", text(&scene), "--max-side", "32", "--budget", "0", "--views", "1"];
    let ended = succeed(splat(&arguments).arg("--out").arg(&out));
    assert!(ended.stderr.contains("1 of "), "{}", ended.stderr);
    assert!(rows(&out).len() > 10);
}
