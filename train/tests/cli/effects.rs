//! `splat inspect` and `--effects`.

use std::path::Path;

use image::GrayImage;
use serde_json::Value;

use crate::run::{DEMO, refuse, splat, succeed};
use crate::{json, text};

/// A demo capture in which every photograph has its own exposure.
fn exposed(folder: &Path) {
    let size = ["--views", "12", "--width", "64", "--height", "48"];
    succeed(splat(&["demo", "--exposure", "--out", text(folder)]).args(size));
}

fn decision<'a>(report: &'a Value, name: &str) -> &'a Value {
    let decisions = report["plan"]["decisions"].as_array().unwrap();
    decisions.iter().find(|decision| decision["name"] == name).unwrap()
}

#[test]
fn inspect_says_what_a_capture_calls_for() {
    let folder = tempfile::tempdir().unwrap();
    exposed(folder.path());
    let said = succeed(&mut splat(&["inspect", text(folder.path())])).stdout;
    for part in ["exposure            ON: ", "masks               off", "0003.png"] {
        assert!(said.contains(part), "{part:?} is not in {said}");
    }
    let report = succeed(&mut splat(&["inspect", text(folder.path()), "--json"])).stdout;
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(decision(&report, "exposure")["verdict"], "on");
    assert_eq!(decision(&report, "antialias")["verdict"], "off");
    assert_eq!(decision(&report, "pose-refinement")["verdict"], "off");
    assert_eq!(report["survey"]["exposure"]["views"].as_array().unwrap().len(), 12);
}

#[test]
fn auto_simulates_nothing_where_nothing_shows() {
    let (auto, none) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let train = |effects: &str, out: &Path| {
        let arguments = ["train", text(&DEMO), "--steps", "12", "--effects", effects, "--out", text(out)];
        succeed(&mut splat(&arguments));
        json(&out.join("metrics.json"))
    };
    let (auto_metrics, none_metrics) = (train("auto", auto.path()), train("none", none.path()));
    assert_eq!(auto_metrics["effects"]["on"], Value::Array(Vec::new()));
    assert_eq!(auto_metrics["test"], none_metrics["test"], "not the same bits");
    assert!(auto_metrics["effects"]["plan"].is_object() && none_metrics["effects"]["plan"].is_null());
    let scene = |out: &Path| std::fs::read(out.join("scene.ply")).unwrap();
    assert_eq!(scene(auto.path()), scene(none.path()));
}

#[test]
fn effects_are_adjusted_recorded_and_measured() {
    let folder = tempfile::tempdir().unwrap();
    let (capture, out) = (folder.path().join("capture"), folder.path().join("out"));
    exposed(&capture);
    std::fs::create_dir(capture.join("masks")).unwrap();
    let mask = GrayImage::from_fn(64, 48, |x, _| [if x < 20 { 0 } else { 255 }].into());
    (0..12).for_each(|view| mask.save(capture.join(format!("masks/{view:04}.png.png"))).unwrap());
    let train = |effects: &str| {
        let arguments = ["train", text(&capture), "--steps", "6", "--out", text(&out), "--effects", effects];
        succeed(&mut splat(&arguments));
        json(&out.join("metrics.json"))
    };
    let metrics = train("+exposure");
    assert_eq!(metrics["effects"]["on"], serde_json::json!(["exposure", "masks"]));
    assert!(metrics["options"]["exposure"]["rate"]["from"].is_number());
    // The scores exclude the masked pixels, and those of `eval` can do the same.
    let scene = out.join("scene.ply");
    let evaluated = folder.path().join("evaluated");
    let arguments = ["eval", text(&capture), "--scene", text(&scene), "--out", text(&evaluated)];
    let psnr = |arguments: &[&str]| {
        succeed(splat(arguments).args(["--test-every", "8"]));
        json(&evaluated.join("metrics.json"))["test"]["psnr"].as_f64().unwrap()
    };
    let trained = metrics["test"]["psnr"].as_f64().unwrap();
    assert!((psnr(&[&arguments[..], &["--masks"]].concat()) - trained).abs() < 1e-4);
    assert!((psnr(&arguments) - trained).abs() > 1e-3, "the mask makes no difference");

    let metrics = train("-exposure,+antialias");
    assert_eq!(metrics["effects"]["on"], serde_json::json!(["antialias", "masks"]));
    assert_eq!((&metrics["options"]["antialias"], &metrics["options"]["exposure"]), (&true.into(), &Value::Null));
}

#[test]
fn masks_that_cannot_be_used_stop_only_those_who_use_them() {
    let folder = tempfile::tempdir().unwrap();
    let (capture, out) = (folder.path().join("capture"), folder.path().join("out"));
    exposed(&capture);
    let masks = capture.join("masks");
    std::fs::create_dir(&masks).unwrap();
    GrayImage::new(10, 10).save(masks.join("0003.png")).unwrap();
    let train = |effects: &str| {
        let arguments = ["train", text(&capture), "--steps", "2", "--out", text(&out), "--effects", effects];
        splat(&arguments)
    };
    refuse(&mut train("auto"), &["a mask cannot be used", "--effects=-masks", "0003.png", "10 × 10"]);
    succeed(&mut train("-masks"));
    succeed(&mut splat(&["inspect", text(&capture)]));
    // Every eighth photograph is held out: masks exclude all of these two.
    for view in ["0000", "0008"] {
        GrayImage::new(64, 48).save(masks.join(format!("{view}.png"))).unwrap();
    }
    std::fs::remove_file(masks.join("0003.png")).unwrap();
    refuse(&mut train("masks"), &["exclude every pixel of 2 photographs", "--effects=-masks"]);
    // One of the two may be dropped if the other is left.
    std::fs::remove_file(masks.join("0008.png")).unwrap();
    assert!(succeed(&mut train("masks")).stderr.contains("every pixel: 1"));
}

#[test]
fn an_option_and_an_effect_do_not_contradict_each_other() {
    let arguments = ["train", text(&DEMO), "--steps", "2", "--antialias", "--out"];
    let out = tempfile::tempdir().unwrap();
    let train = |effects: &str| {
        let mut run = splat(&[&arguments[..], &[text(out.path())]].concat());
        run.arg(format!("--effects={effects}"));
        run
    };
    refuse(&mut train("-antialias"), &["`--antialias`", "contradict"]);
    succeed(&mut train("none"));
    assert_eq!(json(&out.path().join("metrics.json"))["effects"]["on"], serde_json::json!(["antialias"]));
}

#[test]
fn what_is_learnt_beside_the_scene_lies_beside_it() {
    let out = tempfile::tempdir().unwrap();
    let out = out.path();
    let train = |options: &[&str]| {
        let always = ["train", text(&DEMO), "--steps", "6", "--out", text(out)];
        succeed(splat(&always).args(options));
        json(&out.join("metrics.json"))
    };
    let metrics = train(&["--effects", "pose-refinement", "--background", "environment:1"]);
    assert_eq!(metrics["effects"]["on"], serde_json::json!(["pose-refinement"]));
    let poses = json(&out.join("poses.json"));
    assert_eq!(poses.as_object().unwrap().len(), 7, "of the photographs that were trained on");
    let background = out.join("background.json");
    assert_eq!(json(&background)["environment"].as_array().unwrap().len(), 4);
    let scores = out.join("scores");
    let scene = out.join("scene.ply");
    let eval = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(&scores)];
    succeed(&mut splat(&eval));
    let psnr = |metrics: &Value| metrics["test"]["psnr"].as_f64().unwrap();
    let (found, expected) = (psnr(&json(&scores.join("metrics.json"))), psnr(&metrics));
    assert!((found - expected).abs() < 1e-3, "{found} instead of {expected} dB");
    succeed(splat(&eval).args(["--shrink", "4"]));
    refuse(splat(&eval).args(["--shrink", "64"]), &["0000.png", "--shrink 64"]);
    refuse(splat(&eval).args(["--background", "nowhere.json"]), &["nowhere.json", "background.json"]);
    assert_eq!(crate::run::end(splat(&eval).args(["--background", "red"])).code, Some(2));
    // Files that a run did not write are not left over from the run before it.
    train(&["--effects", "none"]);
    assert!(!background.exists() && !out.join("poses.json").exists());
}

#[test]
fn unknown_effects_are_refused() {
    let ended = crate::run::end(&mut splat(&["train", "capture", "--out", "out", "--effects", "fog"]));
    assert!(
        ended.code == Some(2) && ended.stderr.contains("antialias, alpha, exposure, bilateral-grid, masks"),
        "{ended:?}"
    );
    refuse(&mut splat(&["inspect", "/nowhere"]), &["no capture folder /nowhere"]);
}
