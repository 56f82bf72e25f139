//! Model choices, from the training to the picture.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::run::{DEMO, fresh, refuse, splat, succeed};
use crate::{json, text};

const CHOICES: [&str; 2] = ["--projection", "ray-max"];

/// A short run with other model choices than the standard's.
static ALONG_RAYS: LazyLock<PathBuf> = LazyLock::new(|| train("along-rays", &CHOICES));

/// A capture taken through a lens.
static LENS: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("lens");
    let size = ["--views", "8", "--width", "64", "--height", "48", "--lens"];
    succeed(splat(&["demo", "--out"]).arg(&folder).args(size));
    folder
});

fn train(name: &str, options: &[&str]) -> PathBuf {
    let out = fresh(name);
    let always = ["train", text(&DEMO), "--steps", "6", "--max-side", "48", "--effects", "none", "--out", text(&out)];
    succeed(&mut splat(&[&always[..], options].concat()));
    out
}

fn psnr(folder: &Path) -> f64 {
    json(&folder.join("metrics.json"))["test"]["psnr"].as_f64().unwrap()
}

#[test]
fn a_run_renders_as_it_was_asked_to_and_says_so() {
    let options = &json(&ALONG_RAYS.join("metrics.json"))["options"];
    assert_eq!(options["dials"], serde_json::json!({"projection": "ray-max"}));
    let plain = train("plain-rays", &[]);
    assert_eq!(json(&plain.join("metrics.json"))["options"]["dials"], serde_json::json!({}));
    let scene = |folder: &Path| fs::read(folder.join("scene.ply")).unwrap();
    assert_ne!(scene(&plain), scene(&ALONG_RAYS), "the steps took no notice");
}

#[test]
fn one_evaluates_and_renders_as_one_trained() {
    let (folder, scene) = (tempfile::tempdir().unwrap(), ALONG_RAYS.join("scene.ply"));
    let out = folder.path().join("eval");
    let eval = |options: &[&str]| {
        let always = ["eval", text(&DEMO), "--scene", text(&scene), "--max-side", "48", "--out", text(&out)];
        succeed(&mut splat(&[&always[..], options].concat()));
        psnr(&out)
    };
    assert!((eval(&CHOICES) - psnr(&ALONG_RAYS)).abs() < 1e-4);
    let dials = &json(&out.join("metrics.json"))["options"]["dials"];
    assert_eq!(*dials, serde_json::json!({"projection": "ray-max"}));
    assert!((eval(&[]) - psnr(&ALONG_RAYS)).abs() > 1e-3, "the choices make no difference");
    let picture = |options: &[&str], name: &str| {
        let out = folder.path().join(name);
        let always =
            ["render", "--scene", text(&scene), "--capture", text(&DEMO), "--view", "0000.png", "--out", text(&out)];
        succeed(&mut splat(&[&always[..], options].concat()));
        fs::read(out.join("0000.png")).unwrap()
    };
    assert_ne!(picture(&CHOICES, "rays"), picture(&[], "plain"));
}

#[test]
fn rays_go_through_a_lens() {
    let folder = tempfile::tempdir().unwrap();
    for choice in [&CHOICES[..2], &CHOICES[2..]] {
        let out = folder.path().join(choice[1]);
        let train =
            ["train", text(&LENS), "--steps", "2", "--max-side", "48", "--effects", "none", "--out", text(&out)];
        succeed(&mut splat(&[&train[..], choice].concat()));
        let (scene, again) = (out.join("scene.ply"), folder.path().join("again"));
        let eval = ["eval", text(&LENS), "--scene", text(&scene), "--max-side", "48", "--out", text(&again)];
        succeed(&mut splat(&[&eval[..], choice].concat()));
        let chosen = psnr(&again);
        assert!((chosen - psnr(&out)).abs() < 1e-4, "{choice:?}");
        succeed(&mut splat(&eval));
        assert!((psnr(&again) - chosen).abs() > 1e-6, "{choice:?} makes no difference");
    }
}

#[test]
fn rays_do_not_go_with_what_changes_ellipses() {
    let folder = tempfile::tempdir().unwrap();
    let train = ["train", text(&DEMO), "--steps", "3", "--out", text(folder.path()), "--effects", "motion-blur"];
    refuse(&mut splat(&[&train[..], &CHOICES].concat()), &["motion blur", "--projection ray-max", "--effects=-NAME"]);
}
