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
    // The scene's file states the projection.
    assert!((eval(&[]) - psnr(&ALONG_RAYS)).abs() < 1e-4);
    let dials = &json(&out.join("metrics.json"))["options"]["dials"];
    assert_eq!(*dials, serde_json::json!({"projection": "ray-max"}));
    let affine = ["--projection", "affine"];
    assert!((eval(&affine) - psnr(&ALONG_RAYS)).abs() > 1e-3, "the choice makes no difference");
    let picture = |options: &[&str], name: &str| {
        let out = folder.path().join(name);
        let always =
            ["render", "--scene", text(&scene), "--capture", text(&DEMO), "--view", "0000.png", "--out", text(&out)];
        succeed(&mut splat(&[&always[..], options].concat()));
        fs::read(out.join("0000.png")).unwrap()
    };
    assert_eq!(picture(&CHOICES, "rays"), picture(&[], "stated"));
    assert_ne!(picture(&[], "rays"), picture(&affine, "plain"));
}

#[test]
fn rays_go_through_a_lens() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let train = ["train", text(&LENS), "--steps", "2", "--max-side", "48", "--effects", "none", "--out", text(&out)];
    succeed(&mut splat(&[&train[..], &CHOICES].concat()));
    let (scene, again) = (out.join("scene.ply"), folder.path().join("again"));
    let eval = ["eval", text(&LENS), "--scene", text(&scene), "--max-side", "48", "--out", text(&again)];
    succeed(&mut splat(&[&eval[..], &CHOICES].concat()));
    let along_rays = psnr(&again);
    assert!((along_rays - psnr(&out)).abs() < 1e-4);
    succeed(splat(&eval).args(["--projection", "affine"]));
    assert!((psnr(&again) - along_rays).abs() > 1e-6, "the projection makes no difference");
}

#[test]
fn rays_do_not_go_with_what_changes_ellipses() {
    let folder = tempfile::tempdir().unwrap();
    let train = ["train", text(&DEMO), "--steps", "3", "--out", text(folder.path()), "--effects", "motion-blur"];
    refuse(&mut splat(&[&train[..], &CHOICES].concat()), &["motion blur", "--projection ray-max", "--effects=-NAME"]);
}

/// Nothing is said twice: the scene's file states the background, antialiasing and the projection of its training.
#[test]
fn a_scene_is_shown_as_it_was_trained() {
    let (folder, trained) =
        (tempfile::tempdir().unwrap(), train("stated", &["--antialias", "--background", "0.5,0.1,1"]));
    let scene = trained.join("scene.ply");
    let psnr_of = |scene: &Path, options: &[&str]| {
        let out = folder.path().join("eval");
        let eval = ["eval", text(&DEMO), "--scene", text(scene), "--max-side", "48", "--out", text(&out)];
        succeed(splat(&eval).args(options));
        psnr(&out)
    };
    assert!((psnr_of(&scene, &[]) - psnr(&trained)).abs() < 1e-4);
    for other in [&["--antialias=false"][..], &["--background", "white"]] {
        assert!((psnr_of(&scene, other) - psnr(&trained)).abs() > 1e-3, "{other:?} makes no difference");
    }
    let header = String::from_utf8_lossy(&fs::read(&scene).unwrap()[..600]).into_owned();
    let stated =
        r#"splat trained as {"antialias":true,"ray_max":false,"background":[0.5,0.1,1.0],"environment":false}"#;
    assert!(header.contains(stated), "{header}");
    let said = succeed(&mut splat(&["inspect", text(&scene)])).stdout;
    assert!(said.contains(r#""background":[0.5,0.1,1.0]"#), "{said}");
    let (sog, other) = (folder.path().join("scene.sog"), folder.path().join("other.ply"));
    succeed(&mut splat(&["convert", text(&scene), text(&sog)]));
    succeed(&mut splat(&["convert", text(&sog), text(&other)]));
    assert!(String::from_utf8_lossy(&fs::read(&other).unwrap()[..600]).contains(stated));
    // What no run wrote is named.
    let broken = folder.path().join("broken.ply");
    let text_of = fs::read(&scene).unwrap();
    let at = text_of.windows(5).position(|bytes| bytes == b"0.5,0").unwrap();
    let mut bytes = text_of;
    bytes[at..at + 3].copy_from_slice(b"0,5");
    fs::write(&broken, bytes).unwrap();
    refuse(&mut splat(&["inspect", text(&broken)]), &["broken.ply", "splat trained as", "remove that line"]);
}
