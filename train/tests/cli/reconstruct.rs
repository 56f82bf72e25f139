//! From photographs alone to a scene, with a script in COLMAP's place (`colmap.sh`).

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use splat_demo::write_model;
use splat_model::capture::{Capture, View};
use splat_model::formats;
use tempfile::TempDir;

use crate::run::{DEMO, TRAIN, TRAINED, end, refuse, splat, succeed};
use crate::{files, json, text};

/// Photographs without cameras, and a script in COLMAP's place.
pub struct Alone {
    folder: TempDir,
}

impl Alone {
    /// The demo's photographs; the script finds the demo's cameras.
    pub fn new() -> Self {
        let alone = Self { folder: tempfile::tempdir().unwrap() };
        let script = alone.path("bin/colmap");
        for folder in ["photos", "bin", "models"] {
            fs::create_dir(alone.path(folder)).unwrap();
        }
        fs::write(&script, include_str!("colmap.sh")).unwrap();
        fs::set_permissions(&script, fs::Permissions::from_mode(0o755)).unwrap();
        for entry in fs::read_dir(DEMO.join("images")).unwrap().map(Result::unwrap) {
            fs::copy(entry.path(), alone.path("photos").join(entry.file_name())).unwrap();
        }
        copy_model(&DEMO.join("sparse/0"), &alone.path("models/0"));
        alone
    }

    /// Models of the demo's first photographs: as many as each number says.
    fn with_models(sizes: &[usize]) -> Self {
        let alone = Self::new();
        let capture = Capture::load(DEMO.as_path()).unwrap();
        fs::remove_dir_all(alone.path("models/0")).unwrap();
        for (i, &size) in sizes.iter().enumerate() {
            let folder = tempfile::tempdir().unwrap();
            let views: Vec<View> = capture.views[..size].to_vec();
            write_model(folder.path(), &views, &capture.points, &Default::default()).unwrap();
            copy_model(&folder.path().join("sparse/0"), &alone.path(&format!("models/{i}")));
        }
        alone
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A command that finds no other COLMAP and no ffmpeg.
    pub fn splat(&self, fake: &str, arguments: &[&str]) -> Command {
        let mut command = splat(arguments);
        command.env("PATH", self.path("bin")).env("FAKE", fake).env("FAKE_MODELS", self.path("models"));
        command.env("FAKE_LOG", self.path("calls")).current_dir(self.folder.path());
        command
    }

    fn reconstruct(&self, fake: &str) -> Command {
        self.splat(fake, &["reconstruct", "photos", "--out", "made"])
    }

    /// The commands that the script was called with, in order, without questions for help.
    fn calls(&self) -> Vec<String> {
        let text = fs::read_to_string(self.path("calls")).unwrap_or_default();
        text.lines().filter(|line| *line != "help" && !line.ends_with(" -h")).map(str::to_owned).collect()
    }

    pub fn called(&self) -> Vec<String> {
        self.calls().iter().map(|line| line.split(' ').next().unwrap().to_owned()).collect()
    }
}

fn copy_model(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

const ALL: [&str; 3] = ["feature_extractor", "exhaustive_matcher", "mapper"];

#[test]
fn photographs_alone_become_the_scene_that_their_cameras_give() {
    let alone = Alone::new();
    let before = files(&alone.path("photos"));
    let train = [&TRAIN[..], &["photos", "--out", "out"]].concat();
    let said = succeed(&mut alone.splat("ok", &train)).stderr;
    for part in ["COLMAP 3.8", "share one camera: SIMPLE_RADIAL", "8 of 8 photographs placed", "all pairs of 8"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let scene = |out: &Path| fs::read(out.join("scene.ply")).unwrap();
    assert!(scene(&alone.path("out")) == scene(&TRAINED), "the cameras are the demo's, and so the scene is");
    assert_eq!(files(&alone.path("photos")), before);
    assert_eq!(alone.called(), ALL);
    let calls = alone.calls();
    assert!(calls[0].contains("--SiftExtraction.use_gpu 0") && calls[0].contains("single_camera 1"), "{calls:?}");
    assert!(calls[1].contains("--SiftMatching.use_gpu 0"), "{calls:?}");
    // What is finished serves the next run, and is a capture of its own.
    succeed(&mut alone.splat("ok", &train));
    assert_eq!(alone.called(), ALL);
    let scene = alone.path("out/scene.ply");
    succeed(&mut alone.splat("ok", &["eval", "out/reconstruction", "--scene", text(&scene), "--out", "scores"]));
    assert_eq!(json(&alone.path("scores/metrics.json"))["test"]["views"][0]["name"], "0000.png");
}

#[test]
fn of_many_photographs_those_are_compared_that_look_alike() {
    let alone = Alone::new();
    for i in 8..41 {
        fs::copy(DEMO.join("images/0000.png"), alone.path(&format!("photos/{i:04}.png"))).unwrap();
    }
    let said = succeed(&mut alone.reconstruct("ok")).stderr;
    assert!(said.contains("41 photographs with the 20 that look most like it, and the 5"), "{said}");
    let expected = ["feature_extractor", "sequential_matcher", "vocab_tree_builder", "vocab_tree_matcher", "mapper"];
    assert_eq!(alone.called(), expected);
    let calls = alone.calls();
    for (call, part) in [
        (0, "--SiftExtraction.max_num_features 2048"),
        (1, "--SequentialMatching.overlap 5"),
        (2, "--num_visual_words 256"),
        (3, "--VocabTreeMatching.num_images 20"),
    ] {
        assert!(calls[call].contains(part), "{part}: {calls:?}");
    }
    // Options that a version lacks are not given to it, and the photographs are small.
    assert!(!calls[2].contains("num_iterations") && !calls[0].contains("max_image_size"), "{calls:?}");
    assert!(!alone.path("made/vocabulary.bin").exists());
}

#[test]
fn features_of_large_photographs_are_found_in_smaller_pictures() {
    let alone = Alone::new();
    image::RgbImage::new(1_601, 8).save(alone.path("photos/large.png")).unwrap();
    for (fake, size) in
        [("ok", "--SiftExtraction.max_image_size 1600"), ("version4", "--FeatureExtraction.max_image_size 1600")]
    {
        let said = succeed(&mut alone.splat(fake, &["reconstruct", "photos", "--out", fake])).stderr;
        assert!(said.contains("pictures of 1600 px, up to 2048 in each; `--full-size-features`"), "{said}");
        let calls = alone.calls();
        let call = calls.iter().rfind(|call| call.starts_with("feature_extractor")).unwrap();
        assert!(call.contains(size) && call.contains("--SiftExtraction.first_octave 0"), "{calls:?}");
        assert!(call.contains("--SiftExtraction.max_num_features 2048"), "{calls:?}");
    }
    let full = ["reconstruct", "photos", "--full-size-features", "--out", "full"];
    succeed(&mut alone.splat("ok", &full));
    let calls = alone.calls();
    let call = calls.iter().rfind(|call| call.starts_with("feature_extractor")).unwrap();
    assert!(!call.contains("max_image_size") && !call.contains("first_octave"), "{calls:?}");
    refuse(&mut alone.splat("ok", &["reconstruct", "photos", "--out", "full"]), &["with other options"]);
    let with_cameras = [&TRAIN[..], &[text(&DEMO), "--full-size-features"]].concat();
    refuse(&mut alone.splat("ok", &with_cameras), &["--full-size-features", "has cameras", "leave it out"]);
}

#[test]
fn without_out_later_runs_share_one_reconstruction() {
    let alone = Alone::new();
    let train = [&TRAIN[..], &["photos"]].concat();
    succeed(&mut alone.splat("ok", &train));
    succeed(&mut alone.splat("ok", &train));
    succeed(&mut alone.splat("ok", &["reconstruct", "photos"]));
    assert_eq!(alone.called(), ALL);
    let made = |name: &str| alone.path("out").join(name).is_dir();
    assert!(made("photos") && made("photos-2") && made("photos-reconstruction") && !made("photos-reconstruction-2"));
    // Another photograph changes what the reconstruction is made of.
    fs::copy(alone.path("photos/0000.png"), alone.path("photos/more.png")).unwrap();
    refuse(&mut alone.splat("ok", &["reconstruct", "photos"]), &["photos-reconstruction", "move it away", "--out"]);
    assert_eq!(alone.called(), ALL);
    let said = succeed(&mut alone.splat("ok", &["reconstruct", "photos", "--out", "again"])).stderr;
    assert!(said.contains("8 of 9") && said.contains("Not used: more.png"), "{said}");
    assert_eq!(alone.called(), [ALL, ALL].concat());
}

#[test]
fn what_a_user_put_into_a_reconstruction_stays() {
    let alone = Alone::new();
    let mine = ["made/masks/0000.png", "made/images/0000.png", "made/images/more.png", "made/notes/a.txt"];
    let kept = || mine.iter().all(|name| fs::read_to_string(alone.path(name)).is_ok_and(|text| text == "mine"));
    succeed(&mut alone.reconstruct("ok"));
    fs::remove_file(alone.path("made/images/0000.png")).unwrap();
    for name in mine {
        fs::create_dir_all(alone.path(name).parent().unwrap()).unwrap();
        fs::write(alone.path(name), "mine").unwrap();
    }
    succeed(&mut alone.reconstruct("ok"));
    assert!(kept() && alone.called() == ALL, "the finished one is used as it is");
    // Other photographs need another folder.
    fs::copy(alone.path("photos/0000.png"), alone.path("photos/0008.png")).unwrap();
    refuse(&mut alone.reconstruct("ok"), &["made holds a reconstruction of other photographs", "--out"]);
    assert!(kept() && alone.path("made/sparse/0/cameras.bin").exists() && alone.called() == ALL);
    // The photographs themselves are no place for it.
    let before = files(&alone.path("photos"));
    refuse(&mut alone.splat("ok", &["reconstruct", "photos", "--out", "photos"]), &["photos is an input", "choose"]);
    refuse(
        &mut alone.splat("ok", &["reconstruct", "made/images", "--out", "made"]),
        &["made/images has cameras already"],
    );
    assert!(files(&alone.path("photos")) == before && alone.path("made/images/0001.png").exists());
}

#[test]
fn a_stopped_reconstruction_goes_on_after_its_finished_stages() {
    let alone = Alone::new();
    let child = alone.reconstruct("slow").stderr(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while alone.called().last().map(String::as_str) != Some("mapper") {
        assert!(begun.elapsed() < Duration::from_secs(60), "{:?}", alone.called());
        sleep(Duration::from_millis(20));
    }
    succeed_kill(child.id());
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("Ctrl-C") && said.contains("the same command goes on"), "{said}");
    assert!(begun.elapsed() < Duration::from_secs(50), "the script's minute is not waited for");
    let said = succeed(&mut alone.reconstruct("ok")).stderr;
    assert!(said.contains("going on after"), "{said}");
    assert_eq!(alone.called(), [&ALL[..], &["mapper"]].concat());
}

fn succeed_kill(process: u32) {
    assert!(Command::new("kill").args(["-INT", &process.to_string()]).status().unwrap().success());
}

#[test]
fn version_4_has_other_options_and_a_global_mapper() {
    let alone = Alone::new();
    succeed(&mut alone.reconstruct("version4"));
    assert_eq!(alone.called(), ["feature_extractor", "exhaustive_matcher", "global_mapper"]);
    let calls = alone.calls();
    assert!(calls[0].contains("--FeatureExtraction.use_gpu 0"), "{calls:?}");
    assert!(calls[1].contains("--FeatureMatching.use_gpu 0"), "{calls:?}");
    let features = json(&alone.path("made/reconstruction.json"))["features"].clone();
    assert_eq!((features["0000.png"].clone(), features.as_object().unwrap().len()), (1250.into(), 8));
    // Where the global mapper places few, the incremental one is tried, and the better result is kept.
    let alone = Alone::with_models(&[8, 4]);
    let said = succeed(&mut alone.reconstruct("version4-poor")).stderr;
    assert!(said.contains("placed 4 of 8") && said.contains("8 of 8 photographs placed"), "{said}");
}

#[test]
fn of_several_models_the_largest_is_kept_and_the_rest_is_named() {
    let alone = Alone::with_models(&[2, 5]);
    let said = succeed(&mut alone.reconstruct("ok")).stderr;
    let parts = ["sparse/1, the largest", "5 of 8 photographs were placed", "2 parts", "0005.png", "two thirds"];
    for part in parts {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("less than half"), "{said}");
    let alone = Alone::with_models(&[3]);
    let said = succeed(&mut alone.reconstruct("ok")).stderr;
    assert!(said.contains("less than half: 3 of 8"), "{said}");
}

#[test]
fn every_failure_says_what_was_found_and_what_helps() {
    let cases: [(&str, &[&str]); 6] = [
        ("bare", &["no cameras for the 8 photographs", "8 of them have fewer than 100 features", "more light"]),
        ("apart", &["no cameras for the 8 photographs", "median 1250", "from different sides", "two thirds"]),
        ("crash", &["COLMAP crashed (signal 11)", "finding features", "*** Aborted", "reconstruction.log"]),
        ("killed", &["COLMAP was killed", "memory", "smaller photographs", "reconstruction.log"]),
        ("full", &["COLMAP failed (exit status: 1)", "matching", "database or disk is full"]),
        ("stranger", &["`colmap help`", "column: a program", "on the PATH"]),
    ];
    for (fake, parts) in cases {
        refuse(&mut Alone::new().reconstruct(fake), parts);
    }
    let alone = Alone::new();
    fs::remove_file(alone.path("bin/colmap")).unwrap();
    refuse(&mut alone.reconstruct("ok"), &["COLMAP", "not installed", "apt install colmap", "brew", "sparse/0/"]);
    // The log keeps what is not shown.
    let alone = Alone::new();
    refuse(&mut alone.reconstruct("full"), &[]);
    let log = fs::read_to_string(alone.path("made/reconstruction.log")).unwrap();
    assert!(log.contains("$ ") && log.contains("Matching block [1/1, 1/1]"), "{log}");
}

#[test]
fn photographs_that_cannot_work_are_refused_before_colmap_begins() {
    let alone = Alone::new();
    let photos = alone.path("photos");
    let broken = photos.join("0003.png");
    let bytes = fs::read(&broken).unwrap();
    fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    refuse(&mut alone.reconstruct("ok"), &["0003.png", "cannot decode", "export or copy it again"]);
    for entry in fs::read_dir(&photos).unwrap().map(Result::unwrap) {
        fs::copy(DEMO.join("images/0000.png"), entry.path()).unwrap();
    }
    refuse(&mut alone.reconstruct("ok"), &["8 photographs", "copies of 1", "at least 3"]);
    for i in 2..8 {
        fs::rename(photos.join(format!("000{i}.png")), photos.join(format!("000{i}.heic"))).unwrap();
    }
    refuse(&mut alone.reconstruct("ok"), &["holds 2 JPEG and PNG", "6 .heic", "converted", "50 to 200"]);
    refuse(&mut alone.splat("ok", &["reconstruct", "nowhere"]), &["nowhere", "folder of photographs, or a video"]);
    refuse(&mut alone.splat("ok", &["reconstruct", text(&DEMO)]), &["has cameras already", "splat train"]);
    refuse(&mut alone.splat("ok", &["reconstruct", "photos", "--frames", "9"]), &["--frames", "video"]);
    let with_cameras = [&TRAIN[..], &[text(&DEMO), "--camera-model", "OPENCV"]].concat();
    refuse(&mut alone.splat("ok", &with_cameras), &["--camera-model", "has cameras", "leave it out"]);
    assert_eq!(alone.called(), [""; 0]);
    // Other subcommands say where cameras come from.
    refuse(&mut alone.splat("ok", &["inspect", "photos"]), &["photos", "`splat reconstruct photos`"]);
    // What is not ours is not touched.
    let alone = Alone::new();
    fs::create_dir(alone.path("made")).unwrap();
    fs::write(alone.path("made/mine"), "").unwrap();
    refuse(&mut alone.reconstruct("ok"), &["made is not empty", "--out"]);
}

/// Cameras that are there are used, or what is unclear about them is said; the search for cameras takes hours and has another world.
#[test]
fn colmap_is_never_called_where_cameras_are() {
    for (model, photographs, named) in [
        ("photos", "photos", "photos"),
        ("photos/colmap/sparse/0", "photos/images", "photos"),
        ("photos/distorted/sparse/0", "photos/input", "photos"),
        ("photos/dense/sparse", "photos/dense/images", "photos"),
        ("photos/sparse/0", "photos/images", "photos/images"),
    ] {
        let alone = Alone::new();
        if photographs != "photos" {
            fs::rename(alone.path("photos"), alone.path("moved")).unwrap();
            fs::create_dir_all(alone.path(photographs).parent().unwrap()).unwrap();
            fs::rename(alone.path("moved"), alone.path(photographs)).unwrap();
        }
        copy_model(&DEMO.join("sparse/0"), &alone.path(model));
        let said = succeed(&mut alone.splat("ok", &[&TRAIN[..], &[named, "--out", "out"]].concat())).stderr;
        assert!(said.contains("7 photographs to train on") && !said.contains("COLMAP"), "{model}: {said}");
        refuse(&mut alone.splat("ok", &["reconstruct", named]), &["has cameras already"]);
        // A second model, and it is not clear which is meant.
        copy_model(&DEMO.join("sparse/0"), &alone.path("photos/elsewhere/sparse/0"));
        if named == "photos" && photographs != "photos/dense/images" {
            refuse(
                &mut alone.splat("ok", &[&TRAIN[..], &[named]].concat()),
                &["several places", "elsewhere/sparse/0", "Name the one"],
            );
        }
        assert_eq!(alone.called(), [""; 0], "{model}");
    }
}

#[test]
fn a_file_is_named_for_what_it_is_and_leaves_nothing() {
    let alone = Alone::new();
    for (name, bytes, parts) in [
        ("a.zip", &b"PK\x03\x04\x14\0\0\0"[..], ["a.zip is a ZIP archive", "unpack it"]),
        ("a.tar.gz", b"\x1f\x8b\x08\0\0\0\0\0", ["a.tar.gz is a GZ archive", "unpack it"]),
        ("a.ply", b"ply\nformat ascii 1.0\n", ["a.ply is a PLY file", "name the folder"]),
        ("a.json", b"{\"frames\": []}", ["a.json is a JSON file without frames", "name the folder"]),
        ("images.txt", b"# nothing\n", ["images.txt is a text file", "name the folder"]),
        ("a.spz", b"\x1f\x8b\x08\0\0\0\0\0", ["a.spz is a scene in SPZ", "splat view"]),
        ("a.splat", &[0; 64], ["format .splat", "splat-transform"]),
        ("a.jpg", b"\xff\xd8\xff\xe0\0\x10JFIF", ["a.jpg is a JPG picture", "name the folder"]),
    ] {
        fs::write(alone.path(name), bytes).unwrap();
        for arguments in [&["train", name, "--out", "out"][..], &["reconstruct", name]] {
            refuse(&mut alone.splat("ok", arguments), &parts);
        }
    }
    refuse(&mut alone.splat("ok", &["inspect", "a.jpg"]), &["a.jpg", "a JPG picture"]);
    assert!(!alone.path("out").exists() && alone.called().is_empty());
    // FFmpeg knows more videos than this program: what is not known is left to it.
    for (name, bytes) in [("a.mp4", &b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom"[..]), ("a.y4m", &[1; 64])] {
        fs::write(alone.path(name), bytes).unwrap();
        refuse(&mut alone.splat("ok", &["train", name, "--out", "out"]), &["ffmpeg"]);
    }
}

#[test]
fn a_scale_beside_the_capture_is_kept_in_the_scene_and_by_convert() {
    let alone = Alone::new();
    succeed(&mut alone.splat("ok", &["reconstruct", "photos", "--out", "found"]));
    fs::write(alone.path("found/scale.json"), "{\"metres_per_unit\": 2.5}").unwrap();
    succeed(&mut alone.splat("ok", &[&TRAIN[..], &["found", "--out", "out"]].concat()));
    let metres = |name: &str| formats::read(&alone.path(name)).unwrap().0.metres_per_unit;
    assert_eq!(metres("out/scene.ply"), Some(2.5));
    let said = succeed(&mut alone.splat("ok", &["convert", "out/scene.ply", "a.sog"])).stdout;
    assert!(said.contains("a scene unit is 2.5"), "{said}");
    assert_eq!(metres("a.sog"), Some(2.5));
    succeed(&mut alone.splat("ok", &["convert", "a.sog", "b.ply"]));
    assert_eq!(metres("b.ply"), Some(2.5));
    let said = succeed(&mut alone.splat("ok", &["inspect", "found"])).stdout;
    assert!(said.contains("a scene unit is 2.5000 m"), "{said}");
}

#[test]
fn a_scale_that_cannot_be_measured_is_refused() {
    let alone = Alone::new();
    let with = |from: &str| {
        let mut command = alone.reconstruct("ok");
        command.args(["--scale-from", from]);
        command
    };
    refuse(&mut with("gps"), &["0 of 8 placed photographs", "location", "scale.json"]);
    assert_eq!(end(&mut with("left,right=1")).code, Some(2), "marked points went");
}
