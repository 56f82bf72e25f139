//! The mesh of a trained scene against the true surfaces of the demo capture.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use splat_demo::{self as demo, DemoOptions, MeshError, Surfaces};
use splat_model::capture::Capture;
use splat_model::formats;
use splat_model::gaussians::Gaussians;
use splat_model::mesh::{MeshOptions, of_splats};
use splat_op::RenderOptions;
use splat_train::options;

/// Trains on a demo capture by a loss, named as on the command line.
fn trained(folder: &Path, options: &DemoOptions, steps: usize, loss: &str) -> PathBuf {
    let path = |name: &str| folder.join(name).display().to_string();
    demo::write(&folder.join("capture"), options).unwrap();
    let (capture, out, steps) = (path("capture"), path("out"), steps.to_string());
    let words = ["splat", "train", &capture, "--out", &out, "--steps", &steps, "--effects", "none", "--sh-degree", "0"];
    let rest = ["--test-every", "0", "--device", "cpu", "--quiet", "--loss", loss];
    let words = words.into_iter().chain(rest).map(OsString::from);
    splat_train::run(&options::parse(words).unwrap().command).unwrap();
    folder.join("out/scene.ply")
}

/// The error of the mesh of a scene. A sample of the surface counts as covered within `tolerance`, scene units; the platform is 3.9 wide.
fn judged(capture: &Path, scene: &Path, options: &DemoOptions, tolerance: f64) -> MeshError {
    let capture = Capture::load(capture).unwrap();
    let splats = Gaussians::from_rows(&formats::read(scene).unwrap().0.rows, &Device::flex()).unwrap().splats();
    let cameras: Vec<_> = capture.views.iter().map(|view| (view.intrinsics, view.cam_from_world)).collect();
    let mesh = of_splats(&splats, &cameras, &RenderOptions::standard(), &MeshOptions::default(), || ()).unwrap();
    let surfaces = Surfaces::of(options);
    let seen: Vec<_> = cameras
        .iter()
        .flat_map(|(camera, pose)| surfaces.seen(camera, pose).into_iter().step_by(5).flatten())
        .collect();
    let error = surfaces.error(&mesh.positions, &mesh.normals, &seen, tolerance);
    eprintln!("{} splats, {} triangles: {error:?}", splats.means.dims()[0], mesh.triangles.len());
    error
}

#[test]
fn a_trained_scene_has_nearly_the_true_surface() {
    let folder = tempfile::tempdir().unwrap();
    let options = DemoOptions { width: 120, height: 90, views: 24, points: 3_000, ..DemoOptions::PLAIN };
    let scene = trained(folder.path(), &options, 600, "l1-ssim");
    let error = judged(&folder.path().join("capture"), &scene, &options, 0.05);
    assert!(error.distance <= 0.03 && error.completeness >= 0.85 && error.normal_deg <= 27.0, "{error:?}");
}

/// The demo capture of `splat train`, 2,000 steps, by the usual loss and by that of surfaces.
#[test]
#[ignore = "as long as two runs"]
fn the_demo_capture_has_its_surface() {
    let error = |loss: &str| {
        let folder = tempfile::tempdir().unwrap();
        let scene = trained(folder.path(), &DemoOptions::PLAIN, 2_000, loss);
        judged(&folder.path().join("capture"), &scene, &DemoOptions::PLAIN, 0.02)
    };
    let usual = error("l1-ssim");
    assert!(usual.distance <= 0.016 && usual.completeness >= 0.86 && usual.normal_deg <= 18.5, "{usual:?}");
    let surfaces = error("surfaces");
    assert!(
        surfaces.normal_deg < 0.9 * usual.normal_deg && surfaces.distance < usual.distance,
        "{surfaces:?}, {usual:?}"
    );
}
