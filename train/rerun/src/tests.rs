//! A run is shown and then read back with Rerun's own reader.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;

use re_log_encoding::Decoder;
use re_sdk::external::re_log_types::LogMsg;
use re_sdk::log::Chunk;
use re_sdk_types::Component;
use re_sdk_types::components::{
    Color, PinholeProjection, Position3D, Radius, Scalar, TransformMat3x3, TransformRelation, Translation3D,
};
use serde_json::json;

use super::*;

/// Chunks by entity. A chunk is static or has a step for each row.
type Entities = BTreeMap<String, Vec<Chunk>>;

/// The output folder of a run of 20 steps with two cameras, one complete snapshot and one incomplete snapshot.
fn run() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let snapshots = folder.path().join("snapshots");
    let write = |name: &str, text: String| {
        let path = snapshots.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    };
    // One camera at the origin that looks along z, and one two units to its right that looks along -x.
    let view = |name: &str, is_test: bool, pose: [[f64; 4]; 3]| {
        json!({
            "name": name, "is_test": is_test, "model": "Pinhole", "width": 32, "height": 24,
            "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 12.5, "cam_from_world": pose,
        })
    };
    let ahead = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let aside = [[0.0, 0.0, 1.0, 0.5], [0.0, 1.0, 0.0, 0.25], [-1.0, 0.0, 0.0, 2.0]];
    let views = [view("a/1.png", false, ahead), view("b 2.png", true, aside)];
    write("run.json", json!({ "steps": 20, "origin": [1e6, 0.0, 0.0], "views": views }).to_string());
    let point =
        |step: usize, loss: Option<f64>| json!({ "step": step, "seconds": 0.1, "loss": loss, "splats": 10 * step });
    let score = json!({ "step": 10, "seconds": 0.5, "psnr": 20.5, "ssim": 0.75, "lpips": null, "views": 1 });
    let points = [point(10, Some(0.25)), point(20, None)];
    write("history.json", json!({ "points": points, "scores": [score] }).to_string());
    let seen = json!({ "name": "b 2.png", "picture": "0.png", "psnr": 20.5, "ssim": 0.75, "lpips": null });
    write("000010/snapshot.json", json!({ "step": 10, "splats": 2, "shown": 2, "views": [seen] }).to_string());
    write("000010/0.png", "\u{89}PNG".into());
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let properties: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    let rows = "1 2 3 0 0 1.7724539 0 -1 -2 -3\n4 5 6 0 0 0 99 0 0 0\n";
    write("000010/scene.ply", format!("ply\nformat ascii 1.0\nelement vertex 2\n{properties}end_header\n{rows}"));
    write("000020/scene.ply", "still being written".into());
    folder
}

fn saved(out: &Path, path: &Path) -> Result<()> {
    save(RecordingStreamBuilder::new("test"), out, path, false)
}

fn read(path: &Path) -> Entities {
    let mut entities = Entities::new();
    for message in Decoder::<LogMsg>::decode_eager(BufReader::new(File::open(path).unwrap())).unwrap() {
        if let LogMsg::ArrowMsg(_, message) = message.unwrap() {
            let chunk = Chunk::from_arrow_msg(&message).unwrap();
            entities.entry(chunk.entity_path().to_string()).or_default().push(chunk);
        }
    }
    entities
}

/// The values of a component of an entity, row by row.
fn values<C: Component>(entities: &Entities, path: &str, component: &'static str) -> Vec<Vec<C>> {
    let chunks = entities.get(path).unwrap_or_else(|| panic!("no {path} among {:?}", entities.keys()));
    let rows = |chunk: &Chunk| {
        let values = chunk.iter_component::<C>(component.into());
        values.into_iter().map(|row| row.as_slice().to_vec()).collect::<Vec<_>>()
    };
    chunks.iter().flat_map(rows).collect()
}

fn steps(entities: &Entities, path: &str) -> Vec<i64> {
    let chunks = &entities[path];
    chunks.iter().flat_map(|chunk| chunk.timelines()[&"step".into()].times_raw().to_vec()).collect()
}

#[test]
fn what_is_written_is_read_back() {
    let folder = run();
    let path = folder.path().join("run.rrd");
    saved(folder.path(), &path).unwrap();
    let found = read(&path);
    let names: Vec<&str> = found.keys().map(String::as_str).filter(|name| !name.starts_with("/__")).collect();
    let cameras =
        ["/world/cameras/test/b\\ 2.png", "/world/cameras/test/b\\ 2.png/render", "/world/cameras/train/a\\/1.png"];
    let curves = ["/curves/loss", "/curves/splats", "/test/psnr", "/test/ssim"];
    assert_eq!(names, [&curves[..], &cameras[..], &["/world/splats"]].concat());

    let camera = cameras[0];
    assert!(found[camera].iter().all(Chunk::is_static));
    let projection = &values::<PinholeProjection>(&found, camera, "Pinhole:image_from_camera")[0][0];
    assert_eq!(projection.0.0, [30.0, 0.0, 0.0, 0.0, 31.0, 0.0, 15.5, 12.5, 1.0]);
    // Columns of the rotation from world to camera.
    let rotation = &values::<TransformMat3x3>(&found, camera, "Transform3D:mat3x3")[0][0];
    assert_eq!(rotation.0.0, [0.0, 0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    let translation = &values::<Translation3D>(&found, camera, "Transform3D:translation")[0][0];
    assert_eq!(translation.0.0, [0.5, 0.25, 2.0]);
    let relation = &values::<TransformRelation>(&found, camera, "Transform3D:relation")[0][0];
    assert_eq!(*relation, TransformRelation::ChildFromParent);

    assert_eq!(steps(&found, "/world/splats"), [10]);
    let positions = &values::<Position3D>(&found, "/world/splats", "Points3D:positions")[0];
    assert_eq!(positions[..], [Position3D::new(1.0, 2.0, 3.0), Position3D::new(4.0, 5.0, 6.0)]);
    let colours = &values::<Color>(&found, "/world/splats", "Points3D:colors")[0];
    // Half grey plus the coefficient times the harmonic of degree 0, 0.2821; opacities 1/2 and 1.
    let expected =
        [Color::from_unmultiplied_rgba(128, 128, 255, 128), Color::from_unmultiplied_rgba(128, 128, 128, 255)];
    assert_eq!(colours[..], expected);
    let radii = &values::<Radius>(&found, "/world/splats", "Points3D:radii")[0];
    assert!((radii[0].0.0 - (-2.0_f32).exp()).abs() < 1e-6 && radii[1].0.0 == 1.0, "{radii:?}");

    let curve = |path: &str| {
        let values = values::<Scalar>(&found, path, "Scalars:scalars");
        values.iter().map(|row| row[0].0.0).collect::<Vec<f64>>()
    };
    // A loss that is not finite and an LPIPS that was not measured are absent.
    assert_eq!((curve("/curves/loss"), curve("/curves/splats")), (vec![0.25], vec![100.0, 200.0]));
    assert_eq!((curve("/test/psnr"), curve("/test/ssim")), (vec![20.5], vec![0.75]));
    assert_eq!((steps(&found, "/curves/splats"), steps(&found, "/test/psnr")), (vec![10, 20], vec![10]));
    assert_eq!(steps(&found, cameras[1]), [10]);
}

#[test]
fn a_run_that_goes_on_is_shown_once() {
    let folder = run();
    let (recording, storage) = RecordingStreamBuilder::new("test").memory().unwrap();
    let snapshots = Folder::of(folder.path());
    let mut shown = Shown::begin(&recording, &snapshots.run().unwrap()).unwrap();
    assert_eq!(shown.update(&recording, &snapshots).unwrap(), 20);
    let count = |storage: &re_sdk::sink::MemorySinkStorage| {
        let messages = storage.take();
        let arrow = messages.iter().filter(|message| matches!(message, LogMsg::ArrowMsg(..)));
        arrow.filter(|message| format!("{message:?}").contains("splats")).count()
    };
    recording.flush_blocking().unwrap();
    assert!(count(&storage) > 0);
    assert_eq!(shown.update(&recording, &snapshots).unwrap(), 20);
    recording.flush_blocking().unwrap();
    assert_eq!(count(&storage), 0, "shown twice");
}

#[test]
fn what_is_no_run_is_refused_and_leaves_no_file() {
    let folder = run();
    let path = folder.path().join("run.rrd");
    fs::write(&path, "before").unwrap();
    let refused = |file: &str, text: Option<&str>, part: &str| {
        let folder = run();
        let broken = folder.path().join("snapshots").join(file);
        match text {
            Some(text) => fs::write(broken, text).unwrap(),
            None => fs::remove_file(broken).unwrap(),
        }
        let message = format!("{:#}", saved(folder.path(), &path).expect_err(file));
        assert!(message.contains(part), "{message}");
    };
    refused("run.json", None, "--snapshots");
    refused("run.json", Some("{}"), "run.json");
    refused("history.json", Some("[]"), "history.json");
    refused("000010/scene.ply", Some("ply\n"), "scene.ply");
    refused("000010/0.png", None, "0.png");
    let elsewhere = r#"{"step": 10, "views": [{"name": "b 2.png", "picture": "../run.json"}]}"#;
    refused("000010/snapshot.json", Some(elsewhere), "not a file of the snapshot");
    assert_eq!(fs::read(&path).unwrap(), b"before");
    let names = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name());
    assert_eq!(names.count(), 2, "a temporary file is left");
}
