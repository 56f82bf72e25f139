//! `splat inspect` on scenes and captures.

use std::fs;

use serde_json::Value;
use splat_model::formats::{self, Format};
use splat_model::gaussians::{GroupOptions, GroupRows};

use crate::run::{DEMO, TRAINED, refuse, splat, succeed};
use crate::text;

fn info(path: &std::path::Path) -> (String, Value) {
    let said = succeed(&mut splat(&["inspect", text(path)])).stdout;
    let json = succeed(&mut splat(&["inspect", text(path), "--json"])).stdout;
    (said, serde_json::from_str(&json).unwrap())
}

#[test]
fn a_scene_is_described_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (mut scene, _) = formats::read(&TRAINED.join("scene.ply")).unwrap();
    scene.origin = [4e6, -2.5, 1.0].into();
    let splats = scene.rows.len();
    for format in [Format::Ply, Format::Spz, Format::Sog] {
        let path = folder.path().join(format!("scene{}", format.extension()));
        formats::write(&path, &scene, format).unwrap();
        let (said, json) = info(&path);
        assert_eq!((&json["kind"], &json["splats"]), (&"scene".into(), &splats.into()));
        assert_eq!(json["bytes"], fs::metadata(&path).unwrap().len());
        assert_eq!(json["format"], format.to_string());
        assert_eq!(json["origin"][0], if format.holds_origin() { 4e6 } else { 0.0 });
        let low = scene.rows.means.iter().fold(f32::INFINITY, |low, mean| low.min(mean[0]));
        assert!((json["bounds"]["low"][0].as_f64().unwrap() - f64::from(low)).abs() < 0.01, "{json}");
        assert!(json["bulk"]["low"][0].as_f64().unwrap() > f64::from(low), "{json}");
        let opacity: Vec<f64> = json["opacity"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        assert!(opacity.is_sorted() && opacity[2] < 1.0 && opacity[0] > 0.0, "{opacity:?}");
        for part in [&format!("{splats} splats"), "90% of centres", "opacity", "MiB", &format.to_string()] {
            assert!(said.contains(part), "{part}: {said}");
        }
    }
}

#[test]
fn what_is_odd_about_a_scene_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("odd.ply");
    let (mut scene, _) = formats::read(&TRAINED.join("scene.ply")).unwrap();
    let rows = &mut scene.rows;
    rows.means[0][1] = f32::NAN;
    rows.means[1] = [1e6, 0.0, 0.0];
    rows.log_scales[2] = [-10.0, -1.0, -1.0];
    rows.logit_opacities[3] = -9.0;
    let values = vec![0.5; 2 * rows.len()];
    rows.groups = vec![GroupRows { name: "features".into(), width: 2, values, options: GroupOptions::default() }];
    formats::write(&path, &scene, Format::Ply).unwrap();
    let (said, json) = info(&path);
    assert!(said.contains("further groups: features [2]") && json["groups"][0][0] == "features", "{said} {json}");
    for part in
        ["1 splats cannot be rendered", "1 splats are never drawn", "1 splats are needles", "1 splats are outliers"]
    {
        assert!(said.contains(part), "{part}: {said}");
        assert!(json["warnings"].to_string().contains(part), "{part}: {json}");
    }
}

#[test]
fn a_capture_is_described() {
    let (said, json) = info(&DEMO);
    assert_eq!((&json["kind"], &json["views"], &json["held_out"]), (&"capture".into(), &8.into(), &1.into()));
    assert_eq!((&json["cameras"][0]["width"], &json["cameras"][0]["views"]), (&64.into(), &8.into()));
    assert!(json["points"].as_u64().unwrap() > 100 && json["extent"].as_f64().unwrap() > 0.1, "{json}");
    for part in ["COLMAP, 8 photographs (1 held out)", "64 x 48 px, Pinhole", "camera centres", "MiB"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("warning"), "{said}");
}

#[test]
fn missing_photographs_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let capture = folder.path().join("capture");
    succeed(&mut splat(&["demo", "--out", text(&capture), "--views", "3", "--width", "32", "--height", "32"]));
    fs::remove_file(capture.join("images/0001.png")).unwrap();
    let (said, _) = info(&capture);
    assert!(said.contains("1 of 3 photographs that") && said.contains("0001.png: "), "{said}");
}

#[test]
fn what_is_neither_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    refuse(&mut splat(&["inspect", text(folder.path())]), &["sparse"]);
    refuse(&mut splat(&["inspect", text(&folder.path().join("none.ply"))]), &["none.ply"]);
    let path = folder.path().join("half.ply");
    let bytes = fs::read(TRAINED.join("scene.ply")).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    refuse(&mut splat(&["inspect", text(&path)]), &["half.ply"]);
}
