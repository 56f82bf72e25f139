//! Error messages name the file or option and the remedy.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::run::{DEMO, TRAIN, TRAINED, end, refuse, splat};
use crate::text;

/// A copy of the demo capture to break.
fn copy() -> TempDir {
    let target = tempfile::tempdir().unwrap();
    copy_folder(DEMO.as_path(), target.path());
    target
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy_folder(&entry.path(), &target),
            false => _ = fs::copy(entry.path(), target).unwrap(),
        }
    }
}

/// Checks that training on `capture` is refused and leaves nothing in the output folder.
#[track_caller]
fn refuse_capture(capture: &Path, parts: &[&str]) {
    let out = tempfile::tempdir().unwrap();
    refuse(splat(&TRAIN).arg(capture).arg("--out").arg(out.path()), parts);
    assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
}

#[test]
fn a_missing_capture() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("nowhere");
    refuse_capture(&missing, &[text(&missing), "`images/` and `sparse/0/`"]);
    let out = folder.path().join("out");
    refuse(splat(&TRAIN).arg(&missing).arg("--out").arg(&out), &[]);
    assert!(!out.exists(), "no folder is made for a run that cannot start");
}

#[test]
fn a_capture_without_a_model() {
    let capture = copy();
    fs::remove_dir_all(capture.path().join("sparse/0")).unwrap();
    refuse_capture(capture.path(), &[text(&capture.path().join("sparse")), "cameras.bin", "colmap mapper"]);
}

#[test]
fn truncated_models() {
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let capture = copy();
        let path = capture.path().join("sparse/0").join(name);
        let bytes = fs::read(&path).unwrap();
        for length in [0, 5, 8, bytes.len() / 2, bytes.len() - 1] {
            fs::write(&path, &bytes[..length]).unwrap();
            refuse_capture(capture.path(), &[text(&path), "export it again"]);
        }
    }
}

#[test]
fn hostile_models() {
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let capture = copy();
        let path = capture.path().join("sparse/0").join(name);
        let mut bytes = fs::read(&path).unwrap();
        for count in [u64::MAX, u64::MAX / 64, 1 << 40] {
            bytes[..8].copy_from_slice(&count.to_le_bytes());
            fs::write(&path, &bytes).unwrap();
            refuse_capture(capture.path(), &[text(&path), &count.to_string(), "export it again"]);
        }
    }
}

#[test]
fn a_missing_picture() {
    let capture = copy();
    let path = capture.path().join("images/0003.png");
    fs::remove_file(&path).unwrap();
    let list = capture.path().join("sparse/0/images.bin");
    let parts = ["1 of 8 photographs", text(&list), text(&path), "holds \"0000.png\"", "Put the photographs"];
    refuse_capture(capture.path(), &parts);
    for i in 0..8 {
        let _ = fs::remove_file(capture.path().join(format!("images/000{i}.png")));
    }
    fs::remove_dir(capture.path().join("images")).unwrap();
    refuse_capture(capture.path(), &["8 of 8 photographs", "sparse"]);
}

#[test]
fn a_picture_of_another_size() {
    let capture = copy();
    let path = capture.path().join("images/0003.png");
    image::RgbImage::new(48, 64).save(&path).unwrap();
    refuse_capture(capture.path(), &[text(&path), "48 × 64", "64 × 48", "Use the pictures"]);
}

#[test]
fn an_unreadable_picture() {
    let capture = copy();
    // The held-out photograph: it is checked before the run, too.
    let path = capture.path().join("images/0000.png");
    let bytes = fs::read(&path).unwrap();
    for content in [&bytes[..bytes.len() / 2], b"not a picture", b""] {
        fs::write(&path, content).unwrap();
        refuse_capture(capture.path(), &[text(&path), "export or copy it again"]);
    }
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    refuse_capture(capture.path(), &[text(&path), "ordinary file"]);
}

/// Files in the way stand in for missing permissions, which do not bind root.
#[test]
fn outputs_that_cannot_be_written() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "in the way").unwrap();
    let scene = TRAINED.join("scene.ply");
    let demo = text(&DEMO);
    for out in [file.clone(), file.join("below")] {
        let fix = [text(&out), "output folder", "--out"];
        refuse(splat(&TRAIN).args([demo, "--out", text(&out)]), &fix);
        refuse(&mut splat(&["train", "--out", text(&out)]), &fix);
        refuse(&mut splat(&["eval", demo, "--scene", text(&scene), "--out", text(&out)]), &fix);
        let arguments = ["render", "--scene", text(&scene), "--capture", demo, "--view", "all", "--out", text(&out)];
        refuse(&mut splat(&arguments), &fix);
        refuse(&mut splat(&["demo", "--out", text(&out)]), &[text(&out), "--out"]);
    }
    for (name, is_folder) in [("metrics.json", true), ("scene.ply", true), ("views", false)] {
        let out = folder.path().join(format!("with {name}"));
        fs::create_dir(&out).unwrap();
        let taken = out.join(name);
        if is_folder { fs::create_dir(&taken) } else { fs::write(&taken, "") }.unwrap();
        refuse(splat(&TRAIN).args([demo, "--out", text(&out)]), &[text(&taken), "--out"]);
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "in the way");
}

#[test]
fn no_steps() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    refuse(&mut splat(&["train", text(&DEMO), "--steps", "0", "--out", text(&out)]), &["--steps"]);
    refuse(&mut splat(&["train", "--steps", "0", "--out", text(&out)]), &["--steps"]);
    assert!(!out.exists());
}

#[test]
fn no_views_to_test_or_train_on() {
    let folder = tempfile::tempdir().unwrap();
    let scene = TRAINED.join("scene.ply");
    let arguments = ["eval", text(&DEMO), "--scene", text(&scene), "--out", text(folder.path())];
    refuse(splat(&arguments).args(["--test-every", "0"]), &["8 views", "--test-every"]);
    let arguments = ["train", text(&DEMO), "--steps", "1", "--out", text(folder.path())];
    refuse(splat(&arguments).args(["--test-every", "1"]), &["8 views", "--test-every"]);
}

#[test]
fn a_single_photograph_cannot_be_split() {
    use splat_demo::write_model;
    use splat_model::capture::Capture;

    let capture = copy();
    let read = Capture::load(capture.path()).unwrap();
    write_model(capture.path(), &read.views[..1], &read.points, &Default::default()).unwrap();
    refuse_capture(capture.path(), &["the 1 view is held out", "`--test-every 0`", "add photographs"]);
}

#[test]
fn scenes_that_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let good = fs::read(TRAINED.join("scene.ply")).unwrap();
    let empty: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n";
    let path = folder.path().join("scene.ply");
    let contents: [Option<&[u8]>; 5] =
        [None, Some(b""), Some(b"solid cube"), Some(&good[..good.len() - 1]), Some(empty)];
    for content in contents {
        match content {
            Some(bytes) => fs::write(&path, bytes).unwrap(),
            None => assert!(!path.exists()),
        }
        let out = folder.path().join("out");
        let demo = text(&DEMO);
        let parts = [text(&path), "--scene"];
        refuse(&mut splat(&["eval", demo, "--scene", text(&path), "--out", text(&out)]), &parts);
        let arguments = ["render", "--scene", text(&path), "--capture", demo, "--view", "all", "--out", text(&out)];
        refuse(&mut splat(&arguments), &parts);
        assert!(!out.exists());
    }
}

#[test]
fn a_view_that_there_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, demo) = (TRAINED.join("scene.ply"), text(&DEMO));
    let arguments = ["render", "--scene", text(&scene), "--capture", demo, "--view", "0000.jpg"];
    let parts = [demo, "0000.jpg", "0000.png", "`all`"];
    refuse(splat(&arguments).args(["--out", text(folder.path())]), &parts);
}

#[test]
fn a_demo_does_not_replace_a_capture() {
    let capture = copy();
    fs::remove_file(capture.path().join("demo.json")).unwrap();
    let taken: PathBuf = capture.path().join("images");
    refuse(&mut splat(&["demo", "--out", text(capture.path())]), &[text(&taken), "--out"]);
    refuse(&mut splat(&["demo", "--views", "1", "--out", text(&taken.join("new"))]), &["views", "2 to 9999"]);
}

#[cfg(feature = "wgpu")]
#[test]
fn an_adapter_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let arguments = ["train", text(&DEMO), "--device", "gpu:4000", "--out", text(&out)];
    refuse(&mut splat(&arguments), &["gpu:4000"]);
    assert!(!out.exists(), "no folder is made for a run that cannot start");
}

#[test]
fn a_command_line_that_cannot_be_understood_ends_with_2() {
    for arguments in [
        &["eval", "capture"][..],
        &["train", "--steps", "many"],
        &["train", "--device", "abacus"],
        &["train", "--max-splats", "0"],
        &["paint"],
    ] {
        let ended = end(&mut splat(arguments));
        assert_eq!(ended.code, Some(2), "{ended:?}");
        assert!(ended.stderr.contains("error: "), "{}", ended.stderr);
    }
}

#[test]
#[cfg(not(feature = "mpi"))]
fn processes_that_were_started_together_need_mpi() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (variable, count) in [("OMPI_COMM_WORLD_SIZE", "4"), ("PMI_SIZE", "2")] {
        let mut command = splat(&TRAIN);
        command.env(variable, count);
        let processes = format!("{count} processes");
        refuse(
            command.arg(DEMO.as_path()).arg("--out").arg(&out),
            &[&processes, "--features mpi", "docs/LONG_RUNS.md"],
        );
    }
    assert!(!out.exists());
}
