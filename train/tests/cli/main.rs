//! The program from end to end, on a demo capture so small that a run takes a moment.

mod blocks;
mod browser;
mod captures;
mod choices;
mod clean;
mod convert;
mod effects;
mod errors;
mod export;
mod hard_cases;
#[cfg(unix)]
mod inputs;
mod inspect;
#[cfg(unix)]
mod installed;
mod live;
mod lpips;
mod memory;
mod mesh;
mod non_finite;
mod origin;
mod pareto;
mod paths;
mod readers;
#[cfg(unix)]
mod reconstruct;
mod registry;
mod resume;
mod run;
mod scores;
mod time;
mod view;
mod voice;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use image::GenericImageView;
use serde_json::Value;

use run::{DEMO, TRAIN, TRAINED, end, refuse, splat, succeed};

/// The first and only test view of eight: every eighth by name, beginning with the first.
const TEST_VIEW: &str = "0000.png";

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

/// Returns all files below a folder, relative to it.
fn files(folder: &Path) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let name = entry.file_name().into_string().unwrap();
        match entry.path().is_dir() {
            true => found.extend(files(&entry.path()).iter().map(|below| format!("{name}/{below}"))),
            false => _ = found.insert(name),
        }
    }
    found
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn training_writes_the_scene_its_scores_and_its_pictures() {
    let out = TRAINED.as_path();
    assert_eq!(
        files(out),
        ["metrics.json", "report.html", "run.toml", "scene.ply", "views/0000.png"].map(String::from).into()
    );
    let metrics = json(&out.join("metrics.json"));
    let expected = ["test", "splats", "culled_non_finite", "steps", "seconds", "peak_rss_mib", "device", "seed"];
    assert_eq!(keys(&metrics), expected.into_iter().chain(["effects", "options", "version"]).collect());
    assert_eq!(metrics["culled_non_finite"], 0);
    let scores = ["psnr", "ssim", "psnr_corrected", "ssim_corrected", "lpips", "lpips_missing"];
    assert_eq!(keys(&metrics["test"]), scores.into_iter().chain(["lpips_net", "views"]).collect());
    assert_eq!(keys(&metrics["test"]["views"][0]), scores.into_iter().chain(["name"]).collect());
    assert_eq!(keys(&metrics["seconds"]), ["load", "train", "scores", "eval"].into());
    assert_eq!(metrics["test"]["views"].as_array().unwrap().len(), 1);
    assert_eq!(metrics["test"]["views"][0]["name"], TEST_VIEW);
    assert_eq!(metrics["test"]["psnr"], metrics["test"]["views"][0]["psnr"]);
    assert!(metrics["test"]["psnr"].as_f64().unwrap() > 5.0 && metrics["test"]["ssim"].as_f64().unwrap() > 0.1);
    assert_eq!((&metrics["steps"], &metrics["seed"]), (&16.into(), &7.into()));
    assert_eq!(metrics["device"], "flex");
    assert_eq!(metrics["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(metrics["options"]["test_every"], 8);
    assert_eq!(metrics["options"]["max_side"], 64);
    assert_eq!(metrics["options"]["density"]["max_splats"], 1_000_000);
    assert_eq!(metrics["options"]["capture"], text(&DEMO));
    assert!(metrics["splats"].as_u64().unwrap() > 100);
    if cfg!(target_os = "linux") {
        assert!(metrics["peak_rss_mib"].as_f64().unwrap() > 1.0);
    }
}

#[test]
fn pictures_show_truth_then_render_then_error() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let arguments = ["--scene", text(&scene), "--capture", text(&DEMO), "--view", TEST_VIEW];
    succeed(splat(&["render"]).args(arguments).args(["--out", text(folder.path())]));
    let panels = image::open(TRAINED.join("views").join(TEST_VIEW)).unwrap().into_rgb8();
    let truth = image::open(DEMO.join("images").join(TEST_VIEW)).unwrap().into_rgb8();
    let render = image::open(folder.path().join(TEST_VIEW)).unwrap().into_rgb8();
    assert_eq!(panels.dimensions(), (3 * 64, 48));
    assert_eq!(panels.view(0, 0, 64, 48).to_image(), truth);
    assert_eq!(panels.view(64, 0, 64, 48).to_image(), render);
    let error = panels.view(128, 0, 64, 48).to_image();
    assert!(error.pixels().any(|pixel| pixel.0 != [0; 3]));
}

#[test]
fn the_device_can_be_chosen_and_steps_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let output =
        succeed(splat(&["train", text(&DEMO), "--steps", "2", "--device", "ndarray", "--out"]).arg(folder.path()));
    assert_eq!(json(&folder.path().join("metrics.json"))["device"], "ndarray");
    assert!(output.stderr.contains("step 2/2  loss 0."), "{}", output.stderr);
    for part in ["dB PSNR", "scene.ply", "metrics.json", "views", "training"] {
        assert!(output.stdout.contains(part), "{part}: {}", output.stdout);
    }
}

#[test]
fn devices_are_listed_by_the_names_that_can_be_passed() {
    let listed = succeed(&mut splat(&["devices"])).stdout;
    let mut lines = listed.lines().take_while(|line| !line.is_empty());
    assert!(lines.next().unwrap().starts_with("--device"), "{listed}");
    let names: Vec<&str> = lines.map(|line| line.split_whitespace().next().unwrap()).collect();
    assert_eq!(names[..2], ["flex", "ndarray"], "{listed}");
    for name in names {
        // Far enough to see that the name is understood and the device exists; the scene does not exist.
        let arguments = ["render", "--scene", "none.ply", "--capture", "none", "--view", "all", "--device", name];
        refuse(splat(&arguments).args(["--out", "none"]), &["computing on", "no capture folder"]);
    }
    assert!(listed.contains("`--device auto` takes"), "{listed}");
}

#[test]
fn auto_says_what_it_takes() {
    let arguments = ["render", "--scene", "none.ply", "--capture", "none", "--view", "all", "--device", "auto"];
    refuse(splat(&arguments).args(["--out", "none"]), &["computing on", "no capture folder"]);
}

#[test]
fn a_second_run_replaces_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    succeed(splat(&TRAIN).args(["--test-every", "2", "--out", text(out)]).arg(DEMO.as_path()));
    let views = ["0000", "0002", "0004", "0006"].map(|name| format!("views/{name}.png"));
    let others = ["metrics.json", "report.html", "run.toml", "scene.ply"].map(String::from);
    assert_eq!(files(out), views.iter().cloned().chain(others.clone()).collect());
    // None of these is as this program writes it.
    let mine = ["views/mine.png", "views/0002.png", "poses.json", "background.json", ".mine.tmp-aB3dE9"];
    mine.iter().for_each(|name| fs::write(out.join(name), "kept").unwrap());

    succeed(splat(&TRAIN).args(["--out", text(out)]).arg(DEMO.as_path()));
    let kept = mine.map(String::from);
    assert_eq!(files(out), views.into_iter().chain(others).chain(kept).collect());
    assert!(mine.iter().all(|name| fs::read_to_string(out.join(name)).is_ok_and(|text| text == "kept")));
    // The same seed gives the same scene, to the last bit.
    assert_eq!(fs::read(out.join("scene.ply")).unwrap(), fs::read(TRAINED.join("scene.ply")).unwrap());
}

#[test]
fn without_a_folder_no_run_replaces_another() {
    let folder = tempfile::tempdir().unwrap();
    let train = |arguments: &[&str], said: &str| {
        let ended = succeed(
            splat(&[&["train", "--steps", "1", "--test-every", "0"], arguments].concat()).current_dir(folder.path()),
        );
        assert!(ended.stderr.contains(said), "{said:?} is not in: {}", ended.stderr);
    };
    let scene = |name: &str| fs::read(folder.path().join("out").join(name).join("scene.ply")).unwrap();
    // The capture's folder has the name that the demo capture's default output would have, too.
    let capture = DEMO.file_name().unwrap().to_str().unwrap();
    assert_eq!(capture, "demo");
    train(&[text(&DEMO)], "writing to out/demo");
    let first = scene("demo");
    fs::create_dir_all(folder.path().join("out/demo-2/checkpoints")).unwrap();
    train(&[text(&DEMO), "--seed", "9"], "out/demo is not empty and is kept: writing to out/demo-3 ");
    train(&[], "writing to out/demo-4 ");
    assert!(folder.path().join("out/demo-4/demo-capture").is_dir());
    assert!(scene("demo") == first && scene("demo-3") != scene("demo-4"), "a run has replaced another");
    assert_eq!(files(&folder.path().join("out/demo-2")), [].into());
    let mut inside = splat(&["train", ".", "--steps", "1", "--test-every", "0"]);
    fs::create_dir_all(folder.path().join("mine")).unwrap();
    succeed(
        splat(&["demo", "--views", "4", "--width", "40", "--height", "40", "--out"])
            .arg(folder.path().join("mine/a.b")),
    );
    succeed(inside.current_dir(folder.path().join("mine/a.b")));
    assert!(folder.path().join("mine/a.b/out/a.b/scene.ply").is_file(), "`.` has the name of the folder it is");
}

#[test]
fn zero_holds_out_no_view_and_measures_none() {
    let folder = tempfile::tempdir().unwrap();
    succeed(splat(&TRAIN).args(["--test-every", "0", "--out", text(folder.path())]).arg(DEMO.as_path()));
    assert_eq!(json(&folder.path().join("metrics.json"))["test"], Value::Null);
    assert_eq!(files(folder.path()), ["metrics.json", "report.html", "run.toml", "scene.ply"].map(String::from).into());
}

#[test]
fn evaluation_repeats_the_scores_of_training() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let arguments = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(folder.path())];
    succeed(&mut splat(&arguments));
    let (trained, evaluated) = (json(&TRAINED.join("metrics.json")), json(&folder.path().join("metrics.json")));
    assert_eq!(keys(&evaluated), keys(&trained));
    assert_eq!(evaluated["splats"], trained["splats"]);
    for metric in ["psnr", "ssim"] {
        let difference = evaluated["test"][metric].as_f64().unwrap() - trained["test"][metric].as_f64().unwrap();
        assert!(difference.abs() <= 1e-4, "{metric}: {difference}");
    }
    let mut expected = files(TRAINED.as_path());
    // `eval` knows nothing of the training, and leaves the scene where it is.
    assert!(["report.html", "run.toml", "scene.ply"].iter().all(|name| expected.remove(*name)));
    assert_eq!(files(folder.path()), expected);
}

#[test]
fn a_scene_can_be_measured_where_it_lies() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ply");
    fs::copy(TRAINED.join("scene.ply"), &scene).unwrap();
    let arguments = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(folder.path())];
    succeed(&mut splat(&arguments));
    assert_eq!(fs::read(&scene).unwrap(), fs::read(TRAINED.join("scene.ply")).unwrap());
}

#[test]
fn every_format_of_a_render_holds_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    for format in ["png", "exr", "npy"] {
        let arguments = ["--scene", text(&scene), "--capture", text(&DEMO), "--format", format];
        succeed(splat(&["render", "--view", "all", "--out", text(folder.path())]).args(arguments));
    }
    let expected = (0..8).flat_map(|view| ["png", "exr", "npy"].map(|format| format!("{view:04}.{format}")));
    assert_eq!(files(folder.path()), expected.collect());

    let png = image::open(folder.path().join("0003.png")).unwrap();
    let exr = image::open(folder.path().join("0003.exr")).unwrap();
    let npy = fs::read(folder.path().join("0003.npy")).unwrap();
    let npy = npyz::NpyFile::new(&npy[..]).unwrap();
    assert_eq!(png.color(), image::ColorType::Rgb8);
    assert_eq!(exr.color(), image::ColorType::Rgba32F);
    assert_eq!(npy.shape(), [48, 64, 4]);
    let npy: Vec<f32> = npy.into_vec().unwrap();
    let exr = exr.into_rgba32f();
    assert_eq!(exr.as_raw(), &npy);
    for (pixel, values) in png.into_rgb8().pixels().zip(npy.as_chunks::<4>().0) {
        assert!((0.0..=1.0).contains(&values[3]));
        for channel in 0..3 {
            let level = (values[channel].clamp(0.0, 1.0) * 255.0).round();
            assert!((level - f32::from(pixel.0[channel])).abs() <= 0.0, "{values:?} {pixel:?}");
        }
    }
}

/// A program with the name of ffmpeg that runs these lines of a shell, first on the PATH.
#[cfg(unix)]
fn with_ffmpeg(command: &mut std::process::Command, folder: &Path, script: &str) {
    use std::os::unix::fs::PermissionsExt;
    let program = folder.join("ffmpeg");
    fs::write(&program, format!("#!/bin/sh\nfor last; do :; done\n{script}\n")).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    command.env("PATH", format!("{}:/usr/bin:/bin", folder.display()));
}

#[cfg(unix)]
#[test]
fn a_path_becomes_a_video_by_ffmpeg() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, video) = (TRAINED.join("scene.ply"), folder.path().join("out/orbit.mp4"));
    let orbit = ["render", "--scene", text(&scene), "--capture", text(&DEMO), "--path", "orbit", "--frames", "3"];
    let to_video = || {
        let mut command = splat(&orbit);
        command.args(["--fps", "24", "--video", text(&video)]);
        command
    };
    let mut command = to_video();
    with_ffmpeg(&mut command, folder.path(), "echo \"$@\" > \"$0.said\"; cat > \"$last\"");
    assert_eq!(succeed(&mut command).stdout.trim(), text(&video));
    let said = fs::read_to_string(folder.path().join("ffmpeg.said")).unwrap();
    assert!(
        said.contains("-s 64x48 -r 24") && said.contains("/.splat-video-") && said.trim().ends_with("/orbit.mp4"),
        "{said}"
    );
    // The same pictures, in files.
    let pictures = folder.path().join("pictures");
    succeed(splat(&orbit).args(["--out", text(&pictures)]));
    assert_eq!(files(&pictures), ["0000.png", "0001.png", "0002.png"].map(String::from).into());
    let picture = |name: &str| image::open(pictures.join(name)).unwrap().into_rgb8().into_raw();
    assert!(fs::read(&video).unwrap() == [picture("0000.png"), picture("0001.png"), picture("0002.png")].concat());
    assert!(picture("0000.png") != picture("0001.png"));
    // What goes wrong leaves the file that was there, and nothing else.
    for (script, part) in [("echo no encoder >&2; exit 3", "no encoder"), ("cat > \"$last\"; exit 1", "exit status: 1")]
    {
        let mut command = to_video();
        with_ffmpeg(&mut command, folder.path(), script);
        refuse(&mut command, &["cannot encode", "orbit.mp4", part]);
        assert_eq!(files(&folder.path().join("out")), ["orbit.mp4".to_owned()].into());
    }
    refuse(
        to_video().env("PATH", folder.path().join("pictures")),
        &["`--video` needs ffmpeg", "apt install", "--out DIR"],
    );
    assert_eq!(end(splat(&orbit).args(["--view", "all", "--out", "x"])).code, Some(2));
}

#[test]
fn without_a_capture_the_demo_is_made_once_and_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["train", "--steps", "1", "--out", text(folder.path())];
    succeed(&mut splat(&arguments));
    let picture = folder.path().join("demo-capture/images/0000.png");
    let made = fs::metadata(&picture).unwrap().modified().unwrap();
    succeed(&mut splat(&arguments));
    assert_eq!(fs::metadata(&picture).unwrap().modified().unwrap(), made);
    assert!(folder.path().join("scene.ply").exists());
    let metrics = json(&folder.path().join("metrics.json"));
    assert_eq!(metrics["test"]["views"].as_array().unwrap().len(), 6, "every eighth of 48");
}

#[test]
fn help_names_every_subcommand_and_default() {
    let help = succeed(&mut splat(&["--help"])).stdout;
    for name in ["train", "resume", "eval", "render", "inspect", "devices"] {
        assert!(help.contains(name), "{help}");
    }
    // Lines may be wrapped anywhere.
    let help = succeed(&mut splat(&["train", "--help"])).stdout;
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    for part in ["[default: 30000; with the demo capture", "otherwise 8]", "[default: 1000000]", "[default: auto]"] {
        assert!(help.contains(part), "{part}: {help}");
    }
}
