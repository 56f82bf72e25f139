//! Running the program, and the capture and the scene that most tests share.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

/// Arguments of a training run, without the capture and `--out DIR`.
pub const TRAIN: [&str; 7] = ["train", "--steps", "16", "--max-side", "64", "--seed", "7"];

/// A demo capture of 8 views, 64 × 48 px.
pub static DEMO: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("demo");
    let size = ["--views", "8", "--width", "64", "--height", "48"];
    succeed(splat(&["demo", "--out"]).arg(&folder).args(size));
    folder
});

/// Output of a training run on [`DEMO`].
pub static TRAINED: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("trained");
    succeed(splat(&TRAIN).arg(DEMO.as_path()).arg("--out").arg(&folder));
    folder
});

/// Returns a folder below `target/` without files of an earlier run: statics are never dropped, and so could not clean
/// up.
pub fn fresh(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cli").join(name);
    if folder.exists() {
        fs::remove_dir_all(&folder).unwrap();
    }
    folder
}

/// Output and exit code of a run.
#[derive(Debug)]
pub struct Ended {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// Returns the program with some arguments. It computes on the CPU unless they name a device, so that a test is the
/// same on every machine.
pub fn splat(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_splat"));
    command.args(arguments);
    if matches!(arguments, ["train" | "eval" | "render" | "pareto" | "clean" | "mesh", ..])
        && !arguments.contains(&"--device")
    {
        command.args(["--device", "cpu"]);
    }
    command
}

pub fn end(command: &mut Command) -> Ended {
    let output = command.output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ended { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

#[track_caller]
pub fn succeed(command: &mut Command) -> Ended {
    let ended = end(command);
    assert_eq!(ended.code, Some(0), "{command:?}\n{}", ended.stderr);
    ended
}

/// Checks that the program refuses: exit code 1, no panic, nothing on standard output, and an error that holds all
/// `parts`.
#[track_caller]
pub fn refuse(command: &mut Command, parts: &[&str]) {
    let ended = end(command);
    assert_eq!(ended.code, Some(1), "{command:?}\n{ended:?}");
    assert!(ended.stderr.contains("error: "), "{}", ended.stderr);
    assert!(!ended.stderr.contains("panicked"), "{}", ended.stderr);
    assert_eq!(ended.stdout, "");
    for part in parts {
        assert!(ended.stderr.contains(part), "{part:?} is not in: {}", ended.stderr);
    }
}
