//! `splat pareto`, and the options that use its results.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use serde_json::Value;

use crate::run::{DEMO, TRAINED, end, fresh, refuse, splat, succeed};
use crate::{files, json, text};

/// Output of the command for the trained demo scene.
static MEASURED: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("pareto");
    let scene = TRAINED.join("scene.ply");
    let arguments = ["pareto", text(&DEMO), "--scene", text(&scene), "--max-side", "64", "--budget", "0"];
    let ended = succeed(splat(&arguments).arg("--out").arg(&folder));
    for part in ["the frontier of renders", "pareto.md", "pareto.csv", "pareto.png"] {
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
fn every_setting_is_measured_and_drawn() {
    let out = MEASURED.as_path();
    let expected = ["pareto.csv", "pareto.json", "pareto.md", "pareto.png", "pareto.svg"];
    let formats = ["pareto_formats.png", "pareto_formats.svg"];
    assert_eq!(files(out), expected.into_iter().chain(formats).map(String::from).collect());
    let rows = rows(out);
    let named = |name: &str| rows.iter().find(|row| row["name"] == name).unwrap_or_else(|| panic!("no {name}"));
    for row in &rows {
        for column in ["forward_ms", "backward_ms", "step_ms", "memory_mib", "psnr_db", "ssim"] {
            assert!(number(row, column) > 0.0, "{column}: {row:?}");
        }
        assert!(number(row, "forward_ms_lower") <= number(row, "forward_ms_upper"));
        assert_eq!(row["judged_by"] == "photographs", row["error_db"].is_empty(), "{row:?}");
    }
    // The order that the dials exist for.
    let db = |name: &str| number(named(name), "error_db");
    assert!(db("all accurate") > 90.0 && db("all accurate") > db("standard"), "{}", db("all accurate"));
    assert!(db("standard") > db("all coarse"));
    assert!(number(named("all accurate"), "gradient_error") < number(named("all coarse"), "gradient_error"));
    assert!(number(named("all accurate"), "gradient_cosine") > 0.999_99);
    assert_eq!(named("fast")["turned"], "alpha_min 4/255, transmittance_min 1e-3");
    assert!(rows.iter().any(|row| row["on_frontier"] == "1") && rows.iter().any(|row| row["role"] == "dial blur"));

    let svg = fs::read_to_string(out.join("pareto.svg")).unwrap();
    assert!(svg.contains("<circle") && svg.contains("standard") && svg.contains("ms (median and quartiles)"));
    let picture = image::open(out.join("pareto.png")).unwrap().into_rgb8();
    assert!(picture.pixels().filter(|pixel| pixel.0 != [255; 3]).count() > 5000, "the picture is blank");
}

#[test]
fn the_page_says_what_was_measured() {
    let page = fs::read_to_string(MEASURED.join("pareto.md")).unwrap();
    for part in [
        "on flex",
        "measured every setting 3 times",
        "- `alpha_min`: to render, ",
        "; to train, ",
        "- `blur`, by photographs: ",
        "### `transmittance_min`",
        "![Time of a frame against error](pareto.svg)",
        "The frontier of renders",
        "Alone, with every other numerical dial at its most accurate:",
        "## Formats",
        "| **SPZ** | ",
    ] {
        assert!(page.contains(part), "{part:?} is not in {page}");
    }
    assert!(!page.contains("accumulation"), "it does nothing on a CPU");
    assert!(!page.contains("Training dials"), "nothing was trained");
    let tables = page.lines().filter(|line| line.starts_with('|'));
    let cells = |line: &str| line.matches(" | ").count();
    for line in tables.filter(|line| !line.starts_with("|---")) {
        assert!([4, 6, 10].contains(&cells(line)), "{line}");
    }
}

#[test]
fn targets_choose_from_what_was_measured() {
    let frontier = MEASURED.join("pareto.json");
    let measured = json(&frontier);
    let error = |name: &str| {
        let settings = measured["settings"].as_array().unwrap();
        settings.iter().find(|setting| setting["name"] == name).unwrap()["error_db"].as_f64().unwrap()
    };
    let (folder, scene) = (tempfile::tempdir().unwrap(), TRAINED.join("scene.ply"));
    let out = folder.path();
    let eval = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(out), "--max-side", "64"];
    let with = |options: &[&str]| splat(&[&eval[..], options].concat());
    let (accurate, frontier) = (format!("{:.3}", error("all accurate") - 0.2), text(&frontier));
    let ended = succeed(&mut with(&["--frontier", frontier, "--target-error", &accurate]));
    assert!(ended.stderr.contains("accuracy: ") && ended.stderr.contains("dB against the exact render"));
    let dials = &json(&out.join("metrics.json"))["options"]["dials"];
    assert_eq!((&dials["alpha_min"], &dials["transmittance_min"]), (&"2^-26".into(), &"0".into()), "{dials}");
    refuse(&mut with(&["--frontier", frontier, "--target-error", "250"]), &["reaches 250 dB", "dB in "]);
    refuse(&mut with(&["--frontier", frontier, "--target-ms", "1e-6"]), &["takes at most", "for a frame"]);
    refuse(&mut with(&["--frontier", frontier]), &["--target-error"]);
    refuse(&mut with(&["--target-ms=-1"]), &["--target-ms", "positive"]);
    let none = ["--frontier", "nowhere/pareto.json", "--target-ms", "5"];
    refuse(&mut with(&none), &["nowhere/pareto.json", "splat pareto"]);
    let mut other = with(&["--frontier", frontier, "--target-ms", "5", "--device", "ndarray"]);
    refuse(&mut other, &["measured on flex", "this is ndarray"]);
    let both = end(&mut with(&["--accuracy", "fast", "--target-ms", "5"]));
    assert_eq!(both.code, Some(2), "{}", both.stderr);
}

/// A frontier is used for the scene, the size and the model choices that it was measured with. Otherwise the program
/// measures, or refuses.
#[test]
fn a_frontier_of_something_else_is_not_used() {
    let (frontier, folder) = (MEASURED.join("pareto.json"), tempfile::tempdir().unwrap());
    let (scene, out) = (TRAINED.join("scene.ply"), folder.path().join("out"));
    let with = |capture: &Path, scene: &Path, options: &[&str]| {
        let mut eval = splat(&["eval", text(capture), "--scene", text(scene), "--out", text(&out)]);
        eval.args(["--frontier", text(&frontier), "--target-error", "10"]).args(options);
        eval
    };
    refuse(
        &mut with(&DEMO, &scene, &["--antialias"]),
        &["pareto.json", "nothing turned", "antialias on", "--antialias"],
    );
    refuse(&mut with(&DEMO, &scene, &["--projection", "ray-max"]), &["projection ray-max"]);
    assert!(!out.exists(), "no folder is made for a run that cannot start");
    let measures = |mut command: std::process::Command, why: &str| {
        let said = succeed(&mut command).stderr;
        for part in
            [&format!("pareto.json was measured on {why}, and is not used"), "measuring what accuracy costs here"]
        {
            assert!(said.contains(part), "{part:?} is not in {said}");
        }
    };
    // One value of one splat differs.
    let other = folder.path().join("other.ply");
    let mut bytes = fs::read(&scene).unwrap();
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&0.125_f32.to_le_bytes());
    fs::write(&other, bytes).unwrap();
    measures(with(&DEMO, &other, &[]), "another scene");
    measures(with(&DEMO, &scene, &["--max-side", "32"]), "frames of 3072 pixels, and these have 768");
    let capture = fresh("another-capture");
    let size = ["--views", "8", "--width", "65", "--height", "48"];
    succeed(splat(&["demo", "--out"]).arg(&capture).args(size));
    measures(with(&capture, &scene, &[]), "another capture");
    // A scene that is yet to be trained is not another scene.
    let train = ["train", text(&DEMO), "--steps", "2", "--frontier", text(&frontier), "--target-error", "10"];
    let ended = succeed(splat(&train).args(["--effects", "none", "--out", text(&out)]));
    assert!(ended.stderr.contains("accuracy: ") && !ended.stderr.contains("is not used"), "{}", ended.stderr);
    // Files from before the provenance was written.
    let mut old = json(&frontier);
    old.as_object_mut().unwrap().remove("provenance");
    let path = folder.path().join("old.json");
    fs::write(&path, old.to_string()).unwrap();
    let mut eval = splat(&["eval", text(&DEMO), "--scene", text(&scene), "--out", text(&out), "--target-ms", "5"]);
    refuse(eval.args(["--frontier", text(&path)]), &["old.json", "provenance", "measure again"]);
}

/// What a target promises on a scene that was not measured, `splat pareto` finds when it measures every view.
#[test]
fn a_target_is_held_to_on_a_scene_that_was_not_measured() {
    let (folder, scene, capture) = (tempfile::tempdir().unwrap(), TRAINED.join("scene.ply"), fresh("many-views"));
    let size = ["--views", "12", "--width", "40", "--height", "30", "--seed", "5"];
    succeed(splat(&["demo", "--out"]).arg(&capture).args(size));
    let out = folder.path().join("pareto");
    let pareto = ["pareto", text(&capture), "--scene", text(&scene), "--budget", "0", "--background", "white"];
    succeed(splat(&pareto).args(["--test-every", "1", "--views", "12", "--out", text(&out)]));
    let truth = rows(&out);
    for target in [35.0, 60.0, 80.0] {
        let render = ["render", "--capture", text(&capture), "--scene", text(&scene), "--view", "all"];
        let target_db = format!("{target}");
        let options = ["--background", "white", "--target-error", &target_db, "--out", text(folder.path())];
        let said = succeed(splat(&render).args(options)).stderr;
        // `accuracy: NAME (DIALS): X dB against the exact render, ...`
        let choice = said.lines().find_map(|line| line.split_once("accuracy: ")).unwrap_or_else(|| panic!("{said}")).1;
        assert!(choice.contains(" of 12 views were measured"), "{choice}");
        let turned = choice.split_once(" (").unwrap().1.split_once("): ").unwrap();
        let promised: f64 = turned.1.split_once(" dB").unwrap().0.parse().unwrap();
        let found = truth.iter().find(|row| row["turned"] == turned.0).unwrap_or_else(|| panic!("{choice}"));
        let reached = number(found, "error_db");
        assert!(promised >= target - 0.05, "{choice}");
        assert!((reached - promised).abs() <= 3.0, "{reached:.1} dB instead of {choice}");
    }
}

#[test]
fn a_target_without_a_frontier_is_measured_for() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), TRAINED.join("scene.ply"));
    let arguments = ["render", "--scene", text(&scene), "--capture", text(&DEMO), "--view", "0000.png"];
    let render = |options: &[&str], out: &str| {
        let out = folder.path().join(out);
        let ended = succeed(splat(&[&arguments[..], options].concat()).arg("--out").arg(&out));
        (ended.stderr, fs::read(out.join("0000.png")).unwrap())
    };
    let (said, _) = render(&["--target-error", "20"], "measured");
    assert!(said.contains("measuring what accuracy costs here") && said.contains("accuracy: "), "{said}");
    let pictures = ["fast", "standard", "exact"].map(|preset| render(&["--accuracy", preset], preset).1);
    assert!(pictures[0] != pictures[1] && pictures[1] == render(&[], "default").1);
}

#[test]
fn training_turns_dials_too() {
    let folder = tempfile::tempdir().unwrap();
    let train = |options: &[&str]| {
        let always = ["train", text(&DEMO), "--steps", "20", "--max-side", "64", "--out", text(folder.path())];
        let ended = succeed(&mut splat(&[&always[..], options].concat()));
        (ended.stderr, json(&folder.path().join("metrics.json")))
    };
    let (_, metrics) = train(&["--accuracy", "fast"]);
    let dials = serde_json::json!({"alpha_min": "4/255", "transmittance_min": "1e-3"});
    assert_eq!(metrics["options"]["dials"], dials);
    let scene = || fs::read(folder.path().join("scene.ply")).unwrap();
    let fast = scene();
    train(&["--accuracy", "standard"]);
    let standard = scene();
    assert_ne!(fast, standard, "the steps took no notice");
    let (said, metrics) = train(&["--target-error", "15"]);
    for part in ["ms for a frame with its backward pass", "accuracy: the finished scene has ", "at least the 15 dB"] {
        assert!(said.contains(part), "{part:?} is not in {said}");
    }
    assert!(metrics["options"]["dials"].is_object());
    train(&[]);
    assert_eq!(scene(), standard, "it is what is taken without being asked");
}

#[test]
fn training_dials_are_measured_too() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let arguments = ["pareto", text(&DEMO), "--scene", text(&scene), "--max-side", "32", "--budget", "0"];
    let train = ["--views", "1", "--train", "--train-steps", "4", "--out", text(folder.path())];
    succeed(splat(&arguments).args(train));
    let page = fs::read_to_string(folder.path().join("pareto.md")).unwrap();
    for part in
        ["## Training dials", "| half the steps | `--steps 2` |", "| quarters first | `--coarsest 4` |", "| itself |"]
    {
        assert!(page.contains(part), "{part:?} is not in {page}");
    }
    assert!(fs::read_to_string(folder.path().join("pareto_train.svg")).unwrap().contains("training, s"));
    image::open(folder.path().join("pareto_train.png")).unwrap();
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
    let measured: Value = json(&out.join("pareto.json"));
    assert!(measured["settings"].as_array().unwrap().len() > 10);
}
