//! Scenes and captures with an origin.

use std::fs;
use std::path::Path;

use glam::DVec3;
use splat_demo::write_model;
use splat_model::capture::Capture;
use splat_model::ply;

use crate::run::{DEMO, TRAIN, TRAINED, splat, succeed};
use crate::text;

/// Origin that the capture is moved to, as far out as geo-referenced ones lie.
pub const FAR: [f64; 3] = [4_321_000.0, -650_000.0, 5_000.0];

/// Largest allowed difference between two renders, of 1. Values near [`FAR`] have a spacing of 0.5 in f32: if positions
/// or cameras were ever rounded there, the picture would be lost.
const TOLERANCE: f32 = 2e-3;

/// The demo capture, moved out to `offset`, without points.
pub fn moved_capture(folder: &Path, offset: [f64; 3]) {
    let mut capture = Capture::load(DEMO.as_path()).unwrap();
    let mut offset_world = capture.origin;
    (offset_world.x, offset_world.y, offset_world.z) = offset.into();
    for view in &mut capture.views {
        let rotated = view.cam_from_world.matrix3 * offset_world;
        view.cam_from_world.translation -= rotated;
    }
    write_model(folder, &capture.views, &Default::default(), &Default::default()).unwrap();
    fs::create_dir(folder.join("images")).unwrap();
    for view in &capture.views {
        fs::copy(&view.image_path, folder.join("images").join(&view.name)).unwrap();
    }
}

fn render(scene: &Path, capture: &Path) -> Vec<f32> {
    let out = tempfile::tempdir().unwrap();
    let arguments = ["--scene", text(scene), "--capture", text(capture), "--view", "0003.png", "--format", "npy"];
    succeed(splat(&["render", "--out", text(out.path())]).args(arguments));
    let bytes = fs::read(out.path().join("0003.npy")).unwrap();
    npyz::NpyFile::new(&bytes[..]).unwrap().into_vec().unwrap()
}

#[test]
fn a_scene_looks_the_same_wherever_it_and_its_capture_lie() {
    let folder = tempfile::tempdir().unwrap();
    let far = folder.path().join("far");
    moved_capture(&far, FAR);
    let origin = Capture::load(&far).unwrap().origin;
    assert_ne!(origin.to_array(), [0.0; 3]);
    assert_ne!(origin.to_array(), FAR, "the capture chooses an origin of its own, and the scene below has another");

    let near_scene = TRAINED.join("scene.ply");
    let (rows, _) = ply::read(&near_scene).unwrap();
    let far_scene = folder.path().join("far.ply");
    ply::write(&far_scene, &rows, DVec3::from(FAR)).unwrap();

    let expected = render(&near_scene, DEMO.as_path());
    let found = render(&far_scene, &far);
    let error = expected.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(error <= TOLERANCE, "{error}");
}

#[test]
fn a_far_capture_trains_and_its_scene_says_where_it_lies() {
    let folder = tempfile::tempdir().unwrap();
    let (far, out) = (folder.path().join("far"), folder.path().join("out"));
    moved_capture(&far, FAR);
    succeed(splat(&TRAIN).args([text(&far), "--out", text(&out)]));
    let (rows, origin) = ply::read(&out.join("scene.ply")).unwrap();
    assert_eq!(origin, Capture::load(&far).unwrap().origin);
    assert!(rows.means.as_flattened().iter().all(|coordinate| coordinate.abs() < 1e3));
}
