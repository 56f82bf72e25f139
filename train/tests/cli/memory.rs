//! Photographs that do not stay in memory.

use std::fs;

use crate::json;
use crate::run::{DEMO, TRAIN, TRAINED, splat, succeed};

#[test]
fn a_run_without_room_for_photographs_is_the_same() {
    let out = tempfile::tempdir().unwrap();
    let ended = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(["--cache-mb", "0", "--out"]).arg(out.path()));
    assert!(ended.stderr.contains("memory: about 0.1 GB, and "), "{}", ended.stderr);
    let scene = |folder: &std::path::Path| fs::read(folder.join("scene.ply")).unwrap();
    assert!(scene(out.path()) == scene(&TRAINED), "another scene");
    let test = |folder: &std::path::Path| json(&folder.join("metrics.json"))["test"].clone();
    assert_eq!(test(out.path()), test(&TRAINED));
}

/// jemalloc prints its options at the end of a program where its variable asks for them.
#[cfg(target_os = "linux")]
#[test]
fn the_allocator_has_the_options_of_the_program() {
    let ended = succeed(splat(&["--version"]).env("_RJEM_MALLOC_CONF", "stats_print:true"));
    // It does not print all of them, but says which it does not know.
    assert!(!ended.stderr.contains("Invalid conf"), "{}", ended.stderr);
    for option in ["opt.narenas: 1", "opt.oversize_threshold: 67108864"] {
        assert!(ended.stderr.lines().any(|line| line.trim().split(" (").next() == Some(option)), "{}", ended.stderr);
    }
}

#[test]
fn a_run_that_would_not_fit_names_the_option() {
    let out = tempfile::tempdir().unwrap();
    let huge = ["--max-splats", "1000000000000"];
    let ended = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(huge).arg("--out").arg(out.path()));
    assert!(ended.stderr.contains("lower `--max-splats` first"), "{}", ended.stderr);
}
