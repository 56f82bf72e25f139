//! A program with a loss, a strategy and an effect of its own: `examples/own_program.rs`.

#[path = "../examples/own_program.rs"]
#[allow(dead_code, reason = "its `main` is not called")]
mod own_program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

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
    let parts = ["--loss", "squares", "--strategy", "still", "--effects=none,+dim"];
    let options = ["--steps", "12", "--checkpoint-every", "5", "--max-side", "48", "--device", "cpu"];
    succeed(&[&["train", demo, "--out", out][..], &parts, &options].concat());
    let read = |folder: &Path, name: &str| fs::read(folder.join(name)).unwrap();
    let (toml, metrics) = (read(&folders[1], "run.toml"), read(&folders[1], "metrics.json"));
    let toml = String::from_utf8(toml).unwrap();
    for line in ["loss = \"squares\"", "strategy = \"still\"", "effects = \"dim\""] {
        assert!(toml.contains(line), "{line} is not in\n{toml}");
    }
    let metrics: serde_json::Value = serde_json::from_slice(&metrics).unwrap();
    assert_eq!(metrics["effects"]["registered"][0], "dim");
    // The file gives the same run again, in this program alone.
    let config = folders[1].join("run.toml");
    let config = config.to_str().unwrap();
    succeed(&["train", "--config", config, "--out", again]);
    assert_eq!(read(&folders[2], "scene.ply"), read(&folders[1], "scene.ply"));
    let refused = Command::new(env!("CARGO_BIN_EXE_splat")).args(["train", "--config", config]).output().unwrap();
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(!refused.status.success() && said.contains("there is no effect \"dim\""), "{said}");
}
