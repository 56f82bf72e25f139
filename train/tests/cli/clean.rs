//! `splat clean` on a trained scene with splats that a test adds.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use splat_model::formats::{self, Format, SceneFile};
use splat_model::gaussians::GaussianRows;
use tempfile::TempDir;

use crate::run::{DEMO, TRAINED, end, fresh, refuse, splat, succeed};
use crate::{files, text};

/// Numbers of added splats.
const FLOATERS: usize = 12;
const UNSEEN: usize = 10;

/// A scene trained long enough to have surfaces.
static SCENE: LazyLock<PathBuf> = LazyLock::new(|| {
    let folder = fresh("cleaned");
    let length = ["train", "--steps", "300", "--sh-degree", "0", "--seed", "7", "--effects", "none"];
    succeed(splat(&length).arg(DEMO.as_path()).arg("--out").arg(&folder));
    folder.join("scene.ply")
});

/// The trained scene with black floaters between the cameras and the floor, and with splats too faint to be seen. Also returns the
/// number of splats before.
fn spoilt(folder: &TempDir) -> (PathBuf, SceneFile, usize) {
    let (mut scene, _) = formats::read(&SCENE).unwrap();
    let (one, count, centre) = (scene.rows.clone(), scene.rows.len(), middle(&scene.rows));
    let rows = &mut scene.rows;
    let mut add = |mean: [f32; 3], log_scale: f32, logit: f32| {
        rows.push(&one, 0);
        *rows.means.last_mut().unwrap() = mean;
        *rows.log_scales.last_mut().unwrap() = [log_scale; 3];
        *rows.logit_opacities.last_mut().unwrap() = logit;
        *rows.sh_dc.last_mut().unwrap() = [-1.7; 3];
    };
    for i in 0..FLOATERS {
        let (sin, cos) = (i as f32 * std::f32::consts::TAU / FLOATERS as f32).sin_cos();
        let (radius, height) = (2.2 + 0.05 * i as f32, 2.15 + 0.05 * i as f32);
        add([centre[0] + radius * cos, centre[1] + radius * sin, height], -1.8, -0.85);
    }
    (0..UNSEEN).for_each(|i| add([centre[0], centre[1], 0.3 + 0.01 * i as f32], -3.0, -12.0));
    let path = folder.path().join("spoilt.ply");
    formats::write(&path, &scene, Format::Ply).unwrap();
    (path, scene, count)
}

fn copy_of(path: &Path) -> GaussianRows {
    formats::read(path).unwrap().0.rows
}

fn middle(rows: &GaussianRows) -> [f32; 3] {
    [0, 1, 2].map(|axis| rows.means.iter().map(|mean| mean[axis]).sum::<f32>() / rows.len() as f32)
}

/// The number after `before` in the program's output.
fn number(said: &str, before: &str) -> f64 {
    let rest = &said[said.find(before).unwrap_or_else(|| panic!("{before:?} is not in: {said}")) + before.len()..];
    rest.split_whitespace().next().unwrap().parse().unwrap()
}

#[test]
fn floaters_and_what_no_view_shows_go_and_little_else() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scene, count) = spoilt(&folder);
    let (bytes, out) = (fs::read(&path).unwrap(), folder.path().join("below/cleaned.ply"));
    let said = succeed(&mut splat(&["clean", text(&path), text(&out), "--capture", text(&DEMO)])).stdout;
    let cleaned = copy_of(&out);
    // The rows that stay are those of the scene, in their order, to the last bit.
    let mut left = cleaned.means.iter();
    let mut next = left.next();
    let mut stayed = vec![false; scene.rows.len()];
    for (row, mean) in scene.rows.means.iter().enumerate() {
        if next == Some(mean) {
            (stayed[row], next) = (true, left.next());
        }
    }
    assert_eq!(next, None);
    let stay = |rows: std::ops::Range<usize>| rows.filter(|&row| stayed[row]).count();
    assert_eq!(stay(count..scene.rows.len()), 0, "{said}");
    assert!(stay(0..count) * 100 >= 97 * count, "{} of {count} stay: {said}", stay(0..count));
    assert!(said.contains("that no view shows") && said.contains("that float in free space"), "{said}");
    let (before, after) = (number(&said, "photographs: "), number(&said, "dB before, "));
    assert!(after > before, "{said}");
    assert_eq!(fs::read(&path).unwrap(), bytes);
    assert_eq!(files(folder.path()), ["below/cleaned.ply", "spoilt.ply"].map(String::from).into());
    // A second time there is little to remove.
    let again = folder.path().join("again.ply");
    let said = succeed(&mut splat(&["clean", text(&out), text(&again), "--capture", text(&DEMO)])).stdout;
    assert!(copy_of(&again).len() * 100 >= 97 * cleaned.len(), "{said}");
}

#[test]
fn a_box_needs_no_capture_and_the_origin_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (mut scene, _) = formats::read(&TRAINED.join("scene.ply")).unwrap();
    scene.origin = [4e6, -2.5, 1.0].into();
    scene.rows.means[0][1] = f32::NAN;
    let (path, out) = (folder.path().join("a.ply"), folder.path().join("b.spz"));
    formats::write(&path, &scene, Format::Ply).unwrap();
    let cut = middle(&copy_of(&TRAINED.join("scene.ply")))[0];
    let corners = format!("{cut},-inf,-inf,inf,inf,inf");
    let inside = scene.rows.means[1..].iter().filter(|mean| mean[0] >= cut).count();
    for name in ["b.ply", "b.sog"] {
        let out = folder.path().join(name);
        let said = succeed(&mut splat(&["clean", text(&path), text(&out), "--box", &corners])).stdout;
        let (read, _) = formats::read(&out).unwrap();
        assert_eq!((read.rows.len(), read.origin), (inside, scene.origin), "{said}");
        assert!(said.contains("removed 1 that cannot be rendered") && !said.contains("dB"), "{said}");
    }
    let elsewhere = ["clean", text(&path), text(&out), "--box", "1e6,1e6,1e6,2e6,2e6,2e6"];
    refuse_after_output(&elsewhere, "no splat would be left");
    assert!(!out.exists());
}

/// Like [`refuse`], for an error that comes after lines of output.
fn refuse_after_output(arguments: &[&str], part: &str) {
    let ended = end(&mut splat(arguments));
    assert!(ended.code == Some(1) && ended.stderr.contains(part), "{ended:?}");
}

#[test]
fn the_splats_that_contribute_most_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scene, _) = spoilt(&folder);
    let out = folder.path().join("small.ply");
    let capped = |most: usize, more: &[&str]| {
        let most = most.to_string();
        let fixed = ["clean", text(&path), text(&out), "--capture", text(&DEMO), "--max-splats", &most];
        let said = succeed(&mut splat(&[&fixed, more].concat())).stdout;
        (copy_of(&out), number(&said, "dB before, "), number(&said, "photographs: "), said)
    };
    let half = scene.rows.len() / 2;
    let (rows, psnr, before, said) = capped(half, &[]);
    assert_eq!(rows.len(), half, "{said}");
    assert!(!said.contains("float in free space"), "{said}");
    let (_, fewer, _, _) = capped(half / 4, &[]);
    // The scene without its faintest half is close to it; an eighth is not.
    assert!((before - psnr).abs() < 1.0 && fewer < psnr, "{before} {psnr} {fewer}");
    // More than there are removes none.
    assert_eq!(capped(10 * scene.rows.len(), &[]).0.len(), scene.rows.len());
}

#[test]
fn what_cannot_be_cleaned_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::copy(TRAINED.join("scene.ply"), path("a.ply")).unwrap();
    let (scene, out) = (path("a.ply"), path("b.ply"));
    let bytes = fs::read(&scene).unwrap();
    refuse(&mut splat(&["clean", text(&scene), text(&out)]), &["--box", "--capture"]);
    refuse(
        &mut splat(&["clean", text(&scene), text(&scene), "--box", "0,0,0,1,1,1"]),
        &["is an input of this command", "a.ply"],
    );
    refuse(&mut splat(&["clean", text(&scene), text(&path("b.bin")), "--box", "0,0,0,1,1,1"]), &["b.bin", "format"]);
    refuse(&mut splat(&["clean", text(&path("none.ply")), text(&out), "--box", "0,0,0,1,1,1"]), &["none.ply"]);
    let none = path("none");
    refuse(&mut splat(&["clean", text(&scene), text(&out), "--capture", text(&none)]), &["none", "sparse/0"]);
    for odd in [&["--box", "0,0,0,1,1"][..], &["--floaters"], &["--max-splats", "0"]] {
        assert_eq!(end(splat(&["clean", text(&scene), text(&out)]).args(odd)).code, Some(2), "{odd:?}");
    }
    assert!(!out.exists() && fs::read(&scene).unwrap() == bytes);
}
