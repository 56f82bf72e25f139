//! Output for programs: lines of JSON, silence, and completions.

use std::fs;

use serde_json::Value;

use crate::run::{DEMO, TRAIN, end, refuse, splat, succeed};
use crate::{files, json, keys, text};

/// Parses the output of a run with `--json`.
fn lines(stdout: &str) -> Vec<Value> {
    stdout.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))).collect()
}

#[test]
fn a_run_tells_programs_how_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let run = ["--json", "--quiet", "--eval-during", "8", "--out", text(folder.path())];
    let ended = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(run));
    assert_eq!(ended.stderr, "");
    let lines = lines(&ended.stdout);
    let events: Vec<&str> = lines.iter().map(|line| line["event"].as_str().unwrap()).collect();
    let mut expected = vec!["start"];
    for step in 1..=16 {
        expected.extend((step % 8 == 0).then_some("evaluation"));
        expected.push("progress");
    }
    expected.push("done");
    assert_eq!(events, expected);
    let start = &lines[0];
    assert_eq!(keys(start), ["event", "steps", "train_views", "test_views", "splats", "device", "version"].into());
    assert_eq!((&start["steps"], &start["train_views"], &start["test_views"]), (&16.into(), &7.into(), &1.into()));
    let progress = &lines[1];
    assert_eq!(keys(progress), ["event", "step", "seconds", "loss", "splats"].into());
    assert!(progress["loss"].as_f64().unwrap() > 0.0 && progress["splats"].as_u64().unwrap() > 100);
    let evaluations: Vec<&Value> = lines.iter().filter(|line| line["event"] == "evaluation").collect();
    assert_eq!(keys(evaluations[0]), ["event", "step", "seconds", "psnr", "ssim", "lpips", "views"].into());
    assert_eq!((&evaluations[0]["step"], &evaluations[0]["views"]), (&8.into(), &1.into()));
    let done = lines.last().unwrap();
    assert_eq!(done["metrics"], json(&folder.path().join("metrics.json")));
    // There is one test view, and both score the scene of the last step: the scores are equal.
    for score in ["psnr", "ssim"] {
        let (during, after) = (&evaluations[1][score], &done["metrics"]["test"][score]);
        assert!((during.as_f64().unwrap() - after.as_f64().unwrap()).abs() < 1e-4, "{score}: {during} {after}");
    }
}

#[test]
fn scenes_are_exported_on_the_way() {
    let folder = tempfile::tempdir().unwrap();
    succeed(splat(&TRAIN).arg(DEMO.as_path()).args(["--export-every", "7", "--out", text(folder.path())]));
    let scenes: Vec<String> = files(folder.path()).into_iter().filter(|name| name.starts_with("scene")).collect();
    assert_eq!(scenes, ["scene-000007.ply", "scene-000014.ply", "scene.ply"]);
    let rows = |name: &str| splat_model::ply::read(&folder.path().join(name)).unwrap().0;
    assert!(rows("scene-000007.ply") != rows("scene-000014.ply"));
    // No export replaces what the run started from.
    let start = folder.path().join("scene-000007.ply");
    let before = fs::read(&start).unwrap();
    let again = ["--start", text(&start), "--export-every", "7", "--out", text(folder.path())];
    let said = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(again)).stderr;
    assert!(said.contains("scene-000007.ply was not written") && fs::read(&start).unwrap() == before, "{said}");
}

#[test]
fn quiet_says_nothing_but_errors() {
    let folder = tempfile::tempdir().unwrap();
    let ended = succeed(splat(&TRAIN).arg(DEMO.as_path()).args(["--quiet", "--out", text(folder.path())]));
    assert_eq!((ended.stdout.as_str(), ended.stderr.as_str()), ("", ""));
    assert!(files(folder.path()).contains("report.html"));
    let missing = folder.path().join("nowhere");
    refuse(splat(&TRAIN).arg(&missing).args(["--quiet", "--out", text(folder.path())]), &[text(&missing)]);
    refuse(splat(&TRAIN).arg(&missing).args(["--json", "--out", text(folder.path())]), &[text(&missing)]);
}

#[test]
fn shells_get_completions() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = succeed(&mut splat(&["completions", shell])).stdout;
        for part in ["splat", "train", "max-side", "hard-cases", "convert"] {
            assert!(script.contains(part), "{shell}: {part}");
        }
    }
    assert_eq!(end(&mut splat(&["completions", "csh"])).code, Some(2));
}

#[test]
fn help_ends_with_the_exit_codes() {
    let help = succeed(&mut splat(&["--help"])).stdout;
    for part in ["Exit codes:", "\n  0 ", "\n  1 ", "\n  2 ", "\n  130 ", "\n  143 "] {
        assert!(help.contains(part), "{part}: {help}");
    }
}
