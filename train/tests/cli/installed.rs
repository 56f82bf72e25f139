//! Reconstruction with the installed COLMAP and ffmpeg. These tests say so and pass where the programs are missing; with
//! `SPLAT_COLMAP=require` they fail.

use std::env;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use image::{ImageEncoder, RgbImage};
use splat_model::capture::{Capture, View};

use crate::reconstruct::Alone;
use crate::run::{DEMO, Ended, end, refuse, splat, succeed};
use crate::{files, json, text};

/// Whether programs are installed; where they are not, the test is skipped visibly.
fn installed(programs: &[&str]) -> bool {
    let folders: Vec<PathBuf> = env::split_paths(&env::var_os("PATH").unwrap_or_default()).collect();
    let missing = programs.iter().find(|program| !folders.iter().any(|folder| folder.join(program).is_file()));
    let Some(missing) = missing else { return true };
    assert!(
        env::var("SPLAT_COLMAP").as_deref() != Ok("require"),
        "SPLAT_COLMAP=require, and there is no {missing} on the path"
    );
    // Written past the test harness, which swallows the output of passing tests.
    let line = format!("SKIPPED: no {missing} on the path (SPLAT_COLMAP=require makes that a failure)\n");
    std::io::stderr().write_all(line.as_bytes()).unwrap();
    false
}

/// Writes a picture as JPEG that is to be turned clockwise by 90 degrees for showing.
fn write_turned(picture: &RgbImage, file: &Path) {
    // A TIFF header, one entry: tag 0x112, a short, one of them, 6.
    let exif = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(fs::File::create(file).unwrap(), 95);
    encoder.set_exif_metadata(exif.to_vec()).unwrap();
    encoder.write_image(picture, picture.width(), picture.height(), image::ExtendedColorType::Rgb8).unwrap();
}

/// Cameras then have the size of the stored picture, as this program's reader has (`capture/unposed.rs`).
#[test]
fn the_installed_colmap_does_not_turn_pictures() {
    if !installed(&["colmap"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (photos, made) = (folder.path().join("photos"), folder.path().join("made"));
    fs::create_dir(&photos).unwrap();
    for i in 0..3 {
        let picture = image::open(DEMO.join(format!("images/000{i}.png"))).unwrap().into_rgb8();
        write_turned(&picture, &photos.join(format!("{i}.jpg")));
    }
    // Three small photographs from all sides give no model, which does not matter here.
    end(&mut splat(&["reconstruct", text(&photos), "--out", text(&made)]));
    let log = fs::read_to_string(made.join("reconstruction.log")).unwrap();
    assert_eq!((log.matches("64 x 48").count(), log.matches("48 x 64").count()), (3, 0), "{log}");
}

/// Half of the photographs have a tag that turns them. If COLMAP turned them, their size would not be that of the camera; if this program did, scores would
/// be low.
#[test]
fn the_installed_colmap_finds_the_cameras_of_the_demo() {
    if !installed(&["colmap"]) {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let size = ["--views", "48", "--width", "320", "--height", "240"];
    succeed(splat(&["demo", "--out", text(&path("demo"))]).args(size));
    fs::create_dir(path("photos")).unwrap();
    // The demo's neighbours by name stand far apart, so that COLMAP places none of 20 all around: those nearest to the first.
    let truth = Capture::load(&path("demo")).unwrap();
    let centre = |view: &View| view.cam_from_world.inverse().translation;
    let mut near: Vec<&View> = truth.views.iter().collect();
    near.sort_by(|a, b| {
        let from_first = |view: &View| centre(view).distance(centre(&truth.views[0]));
        from_first(a).total_cmp(&from_first(b))
    });
    for (i, view) in near[..18].iter().enumerate() {
        let picture = image::open(&view.image_path).unwrap().into_rgb8();
        let to = path("photos").join(&view.name).with_extension("jpg");
        if i % 2 == 0 { write_turned(&picture, &to) } else { picture.save(&to).unwrap() }
    }
    let photos = path("photos");
    let train = ["train", text(&photos), "--steps", "200", "--max-side", "160", "--seed", "7"];
    let Ended { stderr, .. } = succeed(splat(&train).args(["--out", text(&path("out"))]));
    let capture = Capture::load(&path("out/reconstruction")).unwrap();
    assert!(capture.views.len() >= 16, "{} placed: {stderr}", capture.views.len());
    // Distances between cameras are the demo's, but for one factor.
    let stem = |view: &View| view.name.split('.').next().unwrap().to_owned();
    let centres = |capture: &Capture| -> Vec<(String, glam::DVec3)> {
        capture.views.iter().map(|view| (stem(view), centre(view))).collect()
    };
    let (found, truth) = (centres(&capture), centres(&truth));
    let mut ratios = Vec::new();
    for (i, (name, centre)) in found.iter().enumerate() {
        let other = &found[(i + 7) % found.len()];
        let at = |name: &str| truth.iter().find(|(other, _)| other == name).unwrap().1;
        ratios.push(at(name).distance(at(&other.0)) / centre.distance(other.1));
    }
    ratios.sort_by(f64::total_cmp);
    assert!(ratios[ratios.len() - 1] < 1.1 * ratios[0], "{ratios:?}");
    let psnr = json(&path("out/metrics.json"))["test"]["psnr"].as_f64().unwrap();
    // 16.0 with and without the tags.
    assert!(psnr > 14.5, "{psnr} dB");
}

/// Every second frame is blurred.
#[test]
fn the_sharpest_frames_of_a_video_are_used() {
    if !installed(&["ffmpeg"]) {
        return;
    }
    let alone = Alone::new();
    for i in 0..16 {
        let picture = image::open(DEMO.join(format!("images/{:04}.png", i / 2))).unwrap().into_rgb8();
        let sharp = [1, 2].contains(&(i % 4));
        let picture = if sharp { picture } else { image::imageops::blur(&picture, 1.5) };
        picture.save(alone.path(&format!("{i:02}.png"))).unwrap();
    }
    let clip = alone.path("clip.mkv");
    let encode =
        ["-loglevel", "error", "-framerate", "10", "-i", text(&alone.path("%02d.png")), "-c:v", "ffv1", text(&clip)]
            .map(str::to_owned);
    assert!(Command::new("ffmpeg").args(encode).status().unwrap().success());
    let mut command = alone.splat("apart", &["reconstruct", text(&clip), "--frames", "8", "--out", "made"]);
    let path = env::join_paths([alone.path("bin"), "/usr/bin".into(), "/usr/local/bin".into()]).unwrap();
    refuse(command.env("PATH", path), &["no cameras for the 8 photographs"]);
    let frames: Vec<String> = files(&alone.path("made/images")).into_iter().collect();
    assert_eq!(frames, [1, 2, 5, 6, 9, 10, 13, 14].map(|frame| format!("frame_{frame:06}.jpg")));
    assert_eq!(alone.called()[1], "sequential_matcher");
    // Without ffmpeg, and with something that is no video.
    refuse(&mut alone.splat("ok", &["reconstruct", text(&clip)]), &["ffmpeg", "not installed", "apt install ffmpeg"]);
    fs::write(alone.path("note.mp4"), [0, 0x9f, 0x92, 0x96].repeat(16)).unwrap();
    let mut command = alone.splat("ok", &["reconstruct", "note.mp4"]);
    let path = env::join_paths([alone.path("bin"), "/usr/bin".into(), "/usr/local/bin".into()]).unwrap();
    refuse(command.env("PATH", path), &["note.mp4", "no pictures", "Invalid data"]);
}
