//! Output for programs: lines of JSON, silence, completions and the manual.

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
fn snapshots_hold_what_evaluations_saw() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    // Files of an earlier run, with a surplus picture, and files of others.
    let old = out.join("snapshots/000004");
    fs::create_dir_all(&old).unwrap();
    fs::write(old.join("0.png"), "").unwrap();
    let seen = r#"{"name": "a", "picture": "0.png", "psnr": 1.0, "ssim": 0.5, "lpips": null}"#;
    fs::write(old.join("snapshot.json"), format!(r#"{{"step": 4, "splats": 1, "shown": 1, "views": [{seen}]}}"#))
        .unwrap();
    fs::write(out.join("snapshots/mine.txt"), "kept").unwrap();
    let run = ["--quiet", "--eval-during", "8", "--snapshots", "--out", text(out)];
    assert_eq!(succeed(splat(&TRAIN).arg(DEMO.as_path()).args(run)).stderr, "");
    let steps = [
        "000008/0.png",
        "000008/scene.ply",
        "000008/snapshot.json",
        "000016/0.png",
        "000016/scene.ply",
        "000016/snapshot.json",
    ];
    let mut found = std::collections::BTreeSet::new();
    for step in ["000008", "000016"] {
        found.extend(files(&out.join("snapshots").join(step)).iter().map(|name| format!("{step}/{name}")));
    }
    assert_eq!(found, steps.map(String::from).into());
    assert!(!old.exists() && out.join("snapshots/mine.txt").exists());
    let run = json(&out.join("snapshots/run.json"));
    assert_eq!(keys(&run), ["steps", "origin", "views"].into());
    let views = run["views"].as_array().unwrap();
    assert_eq!((&run["steps"], views.len()), (&16.into(), 8));
    let camera = ["model", "width", "height", "fx", "fy", "cx", "cy", "cam_from_world"];
    assert_eq!(keys(&views[0]), camera.into_iter().chain(["name", "is_test"]).collect());
    assert_eq!(views.iter().filter(|view| view["is_test"] == true).count(), 1);
    let history = json(&out.join("snapshots/history.json"));
    assert_eq!((history["points"].as_array().unwrap().len(), history["scores"].as_array().unwrap().len()), (16, 2));
    let snapshot = json(&out.join("snapshots/000016/snapshot.json"));
    assert_eq!(keys(&snapshot), ["step", "splats", "shown", "views"].into());
    assert_eq!((&snapshot["step"], &snapshot["shown"]), (&16.into(), &snapshot["splats"]));
    assert_eq!(
        (&snapshot["views"][0]["name"], &snapshot["views"][0]["picture"]),
        (&"0000.png".into(), &"0.png".into())
    );
    let scene = fs::read(out.join("snapshots/000016/scene.ply")).unwrap();
    let header = String::from_utf8_lossy(&scene[..200]);
    assert!(header.contains(&format!("element vertex {}", snapshot["splats"])), "{header}");
    let render = image::open(out.join("snapshots/000016/0.png")).unwrap().into_rgb8();
    let panels = image::open(out.join("views/0000.png")).unwrap().into_rgb8();
    let middle = |x: u32, y: u32| panels.get_pixel(x + render.width(), y);
    // The final scene, rendered once more; a level may differ by 1 through rounding.
    let near = |(x, y, pixel): (u32, u32, &image::Rgb<u8>)| (0..3).all(|c| pixel.0[c].abs_diff(middle(x, y).0[c]) <= 1);
    assert!(render.enumerate_pixels().all(near));
    assert_eq!(end(splat(&TRAIN).arg(DEMO.as_path()).args(["--snapshots", "--out", "out"])).code, Some(2));
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
fn the_manual_has_a_page_for_each_subcommand() {
    let folder = tempfile::tempdir().unwrap();
    let said = succeed(&mut splat(&["man", "--out", text(folder.path())])).stdout;
    let pages = files(folder.path());
    for page in ["splat.1", "splat-train.1", "splat-view.1", "splat-convert.1", "splat-hard-cases.1", "splat-man.1"] {
        assert!(pages.contains(page) && said.contains(page), "{pages:?}");
    }
    let page = fs::read_to_string(folder.path().join("splat-train.1")).unwrap();
    for part in [".TH splat-train 1", ".SH SYNOPSIS", "\\-\\-eval\\-during", "Training steps"] {
        assert!(page.contains(part), "{part}");
    }
    let page = fs::read_to_string(folder.path().join("splat.1")).unwrap();
    assert!(page.contains("130") && page.contains("Exit codes"), "{page}");
    let file = folder.path().join("splat.1");
    refuse(&mut splat(&["man", "--out", text(&file)]), &[text(&file), "--out"]);
}

#[test]
fn help_ends_with_the_exit_codes() {
    let help = succeed(&mut splat(&["--help"])).stdout;
    for part in ["Exit codes:", "\n  0 ", "\n  1 ", "\n  2 ", "\n  130 ", "\n  143 "] {
        assert!(help.contains(part), "{part}: {help}");
    }
}
