//! Captures of other programs: what is not used is said, and files are read in spite of their names.

use std::fs;
use std::path::Path;

use glam::DAffine3;
use image::codecs::jpeg::JpegEncoder;
use splat_demo::write_model;
use splat_model::capture::{Capture, View};
use splat_model::formats::{self, Format};
use splat_model::sniff::FileKind;
use tempfile::TempDir;

use crate::run::{DEMO, TRAIN, TRAINED, refuse, splat, succeed};
use crate::{json, text};

/// The demo's photographs and model, without the mark that they are this program's.
fn capture() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for part in ["images", "sparse/0"] {
        fs::create_dir_all(folder.path().join(part)).unwrap();
        for entry in fs::read_dir(DEMO.join(part)).unwrap().map(Result::unwrap) {
            fs::copy(entry.path(), folder.path().join(part).join(entry.file_name())).unwrap();
        }
    }
    folder
}

/// Trains a few steps and returns what was said.
fn trained(capture: &Path, options: &[&str]) -> String {
    let out = tempfile::tempdir().unwrap();
    let arguments =
        [&["train", text(capture), "--steps", "2", "--device", "cpu", "--out", text(out.path())], options].concat();
    succeed(&mut splat(&arguments)).stderr
}

#[test]
fn what_is_not_used_is_said_by_every_command_that_reads_a_capture() {
    let capture = capture();
    fs::create_dir(capture.path().join("masks")).unwrap();
    for i in 0..8 {
        image::GrayImage::new(64, 48).save(capture.path().join(format!("masks/000{i}_mask.png"))).unwrap();
    }
    let masks = "masks/ holds 8 pictures, and none belongs to a photograph: expected for instance masks/0000.png.png or masks/0000.png, \
                 found 0000_mask.png";
    let said = [
        trained(capture.path(), &[]),
        succeed(&mut splat(&["inspect", text(capture.path())])).stderr,
        succeed(&mut splat(&["inspect", text(capture.path())])).stdout,
    ];
    for said in said {
        assert_eq!(said.matches(masks).count(), 1, "{said}");
    }
}

#[test]
fn a_capture_without_points_starts_from_those_that_photographs_show() {
    let capture = capture();
    assert!(!trained(capture.path(), &["--effects", "none"]).contains("the capture has"));
    fs::remove_file(capture.path().join("sparse/0/points3D.bin")).unwrap();
    let said = trained(capture.path(), &["--effects", "none"]);
    assert_eq!(said.matches("no points: training starts from ").count(), 1, "{said}");
    assert!(said.contains(" that its photographs show") && !said.contains("random"), "{said}");
}

#[test]
fn few_points_are_said() {
    let capture = capture();
    let Capture { views, mut points, .. } = Capture::load(capture.path()).unwrap();
    points.positions.truncate(4);
    points.colours.truncate(4);
    write_model(capture.path(), &views, &points, &Default::default()).unwrap();
    let said = trained(capture.path(), &["--effects", "none"]);
    let part = "4 points, which are few: its photographs show ";
    assert_eq!(said.matches(part).count(), 1, "{said}");
    assert!(!said.contains("show 0 more"), "{said}");
}

#[test]
fn points_that_no_photograph_shows_are_said_by_every_command_that_reads_a_capture() {
    let capture = capture();
    let Capture { views, points, .. } = Capture::load(capture.path()).unwrap();
    let said = succeed(&mut splat(&["inspect", text(capture.path())])).stdout;
    let count = points.positions.len();
    assert!(said.contains("photographs show ") && said.contains(&format!("of the {count} points")), "{said}");
    // Cameras with OpenGL's axes.
    let turned = |view: &View| {
        let cam_from_world = DAffine3::from_rotation_x(std::f64::consts::PI) * view.cam_from_world;
        View { cam_from_world, ..view.clone() }
    };
    write_model(capture.path(), &views.iter().map(turned).collect::<Vec<_>>(), &points, &Default::default()).unwrap();
    let none = format!("no photograph shows {count} of the {count} points");
    let out = capture.path().join("out");
    let arguments = ["train", text(capture.path()), "--effects", "none", "--device", "cpu", "--out", text(&out)];
    refuse(&mut splat(&arguments), &["no splat would be left", &none, "OpenGL"]);
    assert!(!out.join("scene.ply").exists());
    for command in ["inspect", "info"] {
        let said = succeed(&mut splat(&[command, text(capture.path())])).stdout;
        assert!(said.contains(&none), "{command}: {said}");
    }
}

#[test]
fn a_jpeg_that_is_cut_short_is_refused_for_training_and_for_testing() {
    let capture = capture();
    let read = Capture::load(capture.path()).unwrap();
    let renamed = |view: &View| View { name: view.name.replace(".png", ".jpg"), ..view.clone() };
    let renamed: Vec<View> = read.views.iter().map(renamed).collect();
    write_model(capture.path(), &renamed, &read.points, &Default::default()).unwrap();
    for view in &read.views {
        let picture = image::open(&view.image_path).unwrap().into_rgb8();
        let mut bytes = Vec::new();
        picture.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, 95)).unwrap();
        fs::write(view.image_path.with_extension("jpg"), bytes).unwrap();
    }
    trained(capture.path(), &["--effects", "none"]);
    for name in ["0000.jpg", "0003.jpg"] {
        let path = capture.path().join("images").join(name);
        let whole = fs::read(&path).unwrap();
        for percent in [30, 95] {
            fs::write(&path, &whole[..whole.len() * percent / 100]).unwrap();
            let out = tempfile::tempdir().unwrap();
            for effects in ["none", "auto"] {
                let arguments =
                    [&TRAIN[..], &[text(capture.path()), "--effects", effects, "--out", text(out.path())]].concat();
                refuse(&mut splat(&arguments), &[text(&path), "cannot decode", "damaged"]);
            }
        }
        fs::write(&path, whole).unwrap();
    }
}

#[test]
fn a_picture_of_another_kind_is_named() {
    let capture = capture();
    let path = capture.path().join("images/0003.png");
    fs::write(&path, b"\0\0\0\x18ftypheic\0\0\0\0mif1heic").unwrap();
    let out = tempfile::tempdir().unwrap();
    let arguments = [&TRAIN[..], &[text(capture.path()), "--out", text(out.path())]].concat();
    refuse(&mut splat(&arguments), &[text(&path), "HEIC", "convert it to JPEG", "magick"]);
}

#[test]
fn scenes_in_archives_and_of_other_programs_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let scene = fs::read(TRAINED.join("scene.ply")).unwrap();
    let packed = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, &scene).unwrap();
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("scene.ply", zip::write::SimpleFileOptions::default()).unwrap();
    std::io::Write::write_all(&mut zip, &scene).unwrap();
    for (path, parts) in [
        (packed("scene.ply.gz", &gzip.finish().unwrap()), ["a gzip file around a PLY file", "gunzip"]),
        (
            packed("scene.zip", &zip.finish().unwrap().into_inner()),
            ["a ZIP archive without `meta.json`", "`scene.ply`"],
        ),
        (packed("scene.splat", &[7; 64]), ["a scene in the format .splat", "splat-transform"]),
        (packed("scene.ksplat", &[0; 4096]), ["a scene in the format .ksplat", "SuperSplat"]),
    ] {
        refuse(&mut splat(&["convert", text(&path), text(&folder.path().join("out.ply"))]), &parts);
        refuse(&mut splat(&["inspect", text(&path)]), &parts);
    }
    // What a name says does not matter where the content is a scene.
    let path = packed("scene.jpg", &scene);
    assert_eq!(formats::read(&path).unwrap().1, Format::Ply);
    assert!(FileKind::of(&path).is_some());
}

#[test]
fn a_file_of_cameras_stands_for_its_folder() {
    let capture = capture();
    let out = tempfile::tempdir().unwrap();
    let file = capture.path().join("sparse/0/images.bin");
    let options = ["--effects", "none", "--steps", "2", "--out", text(out.path())];
    succeed(splat(&["train", text(&file)]).args(options));
    assert_eq!(json(&out.path().join("metrics.json"))["options"]["capture"], text(capture.path()));
    let scene = out.path().join("scene.ply");
    let scores = tempfile::tempdir().unwrap();
    succeed(&mut splat(&[
        "eval",
        text(&file),
        "--scene",
        text(&scene),
        "--device",
        "cpu",
        "--out",
        text(scores.path()),
    ]));
}
