//! A program with a loss, a strategy and an effect of its own: `examples/own_program.rs`.

#[path = "../examples/own_program.rs"]
#[allow(dead_code, reason = "its `main` is not called")]
mod own_program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use splat_model::capture::{Capture, View};
use splat_model::formats;
use splat_train::registry::main_of;

fn fresh(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("registry").join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    folder
}

/// Runs the program of one's own.
#[track_caller]
fn succeed(words: &[&str]) {
    let code = main_of(own_program::registry(), ["splat"].iter().chain(words).map(|word| word.into()));
    assert_eq!(format!("{code:?}"), format!("{:?}", ExitCode::SUCCESS), "{words:?}");
}

#[test]
fn registered_parts_are_chosen_by_their_names() {
    let folders = ["demo", "once", "again"].map(fresh);
    let [demo, out, again] = folders.each_ref().map(|folder| folder.to_str().unwrap());
    succeed(&["demo", "--out", demo, "--views", "8", "--width", "64", "--height", "48"]);
    let parts = ["--loss", "squares", "--strategy", "budget", "--effects=none,+filter"];
    let options = ["--steps", "12", "--checkpoint-every", "5", "--max-side", "48", "--device", "cpu"];
    succeed(&[&["train", demo, "--out", out][..], &parts, &options].concat());
    let read = |folder: &Path, name: &str| fs::read(folder.join(name)).unwrap();
    let (toml, metrics) = (read(&folders[1], "run.toml"), read(&folders[1], "metrics.json"));
    let toml = String::from_utf8(toml).unwrap();
    for line in ["loss = \"squares\"", "strategy = \"budget\"", "effects = \"filter\""] {
        assert!(toml.contains(line), "{line} is not in\n{toml}");
    }
    let metrics: serde_json::Value = serde_json::from_slice(&metrics).unwrap();
    assert_eq!(metrics["effects"]["registered"][0], "filter");
    // The file gives the same run again, in this program alone.
    let config = folders[1].join("run.toml");
    let config = config.to_str().unwrap();
    succeed(&["train", "--config", config, "--out", again]);
    assert_eq!(read(&folders[2], "scene.ply"), read(&folders[1], "scene.ply"));
    let refused = Command::new(env!("CARGO_BIN_EXE_splat")).args(["train", "--config", config]).output().unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && said.contains("there is no effect \"filter\""), "{said}");
}

/// A capture in a format of one's own trains, with a loss that brings a group of its own.
#[test]
fn a_registered_format_and_a_loss_with_a_group() {
    let folders = ["written", "trained"].map(fresh);
    let [capture, out] = folders.each_ref().map(|folder| folder.to_str().unwrap());
    succeed(&["demo", "--out", capture, "--views", "8", "--width", "64", "--height", "48"]);
    let demo = Capture::load(&folders[0]).unwrap();
    let line = |view: &View| {
        let (lens, pose) = (&view.intrinsics, &view.cam_from_world);
        let (_, turn, at) = pose.to_scale_rotation_translation();
        let numbers = [lens.width as f64, lens.height as f64, lens.fx].into_iter().chain(turn.to_array());
        let numbers: Vec<String> = numbers.chain(at.to_array()).map(|number| number.to_string()).collect();
        format!("{},{}\n", view.name, numbers.join(","))
    };
    fs::write(folders[0].join("cameras.csv"), demo.views.iter().map(line).collect::<String>()).unwrap();
    fs::remove_dir_all(folders[0].join("sparse")).unwrap();
    let table = Capture::load(&folders[0]).unwrap();
    assert_eq!((demo.format, table.format, table.views.len()), ("COLMAP", "table", 8));
    for (found, expected) in table.views.iter().zip(&demo.views) {
        assert_eq!(found.image_path, expected.image_path);
        assert!(found.cam_from_world.abs_diff_eq(expected.cam_from_world, 1e-9), "{}", found.name);
    }
    let options =
        ["--effects", "none", "--steps", "8", "--checkpoint-every", "4", "--max-side", "48", "--device", "cpu"];
    succeed(&[&["train", capture, "--out", out, "--loss", "brightness"][..], &options].concat());
    let (scene, _) = formats::read(&folders[1].join("scene.ply")).unwrap();
    let group = &scene.rows.groups[0];
    assert_eq!((&*group.name, group.width, group.values.len()), ("brightness", 1, scene.rows.len()));
    assert!(group.values.iter().any(|value| *value > 0.01), "it learnt nothing");
}
