//! No subcommand replaces a file that it reads, by whatever path its output leads there.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use clap::CommandFactory;
use glam::{DMat4, DVec3};
use serde_json::{Value, json};
use splat_model::capture::Capture;
use splat_train::options::Cli;
use tempfile::TempDir;

use crate::run::{DEMO, TRAINED, end, splat, succeed};
use crate::text;

/// How a command line names its output.
#[derive(Clone, Copy, Debug)]
enum Way {
    Plain,
    Symlink,
    Up,
    HardLink,
}

const WAYS: [Way; 4] = [Way::Plain, Way::Symlink, Way::Up, Way::HardLink];

/// A command line whose output, the word `OUT`, is aimed at an input.
struct Case {
    /// The words, split at blanks. Paths are relative to the folder of the inputs.
    line: &'static str,
    /// The input, below that folder.
    input: &'static str,
    /// The folder that `OUT` names and in which the command writes the file; `None` if `OUT` is the file itself.
    folder: Option<&'static str>,
}

const fn case(line: &'static str, input: &'static str, folder: Option<&'static str>) -> Case {
    Case { line, input, folder }
}

const TRAIN: &str = "train cap --out OUT --steps 2 --test-every 8 --effects none --device cpu";

/// Every subcommand that reads and writes.
fn cases() -> Vec<Case> {
    vec![
        case(TRAIN, "cap/scene.ply", Some("cap")),
        case("train colmap --out OUT --steps 2 --effects none --device cpu", "colmap/views/0000.png", Some("colmap")),
        case("train colmap --start given/scene.ply --out OUT --steps 2 --device cpu", "given/scene.ply", Some("given")),
        case("train colmap --config given/run.toml --out OUT --device cpu", "given/run.toml", Some("given")),
        case("resume OUT", "cap/scene.ply", Some("cap")),
        case(
            "render --scene given/scene.ply --capture cap --path orbit --video OUT --device cpu",
            "given/scene.ply",
            None,
        ),
        case(
            "render --scene given/scene.ply --capture cap --path given/path.json --video OUT --device cpu",
            "given/path.json",
            None,
        ),
        case(
            "render --scene given/scene.ply --capture colmap --view all --out OUT --device cpu",
            "colmap/views/0000.png",
            Some("colmap/views"),
        ),
        case(
            "render --scene given/scene.ply --capture colmap --view 0003.png --out OUT --device cpu",
            "colmap/masks/0003.png",
            Some("colmap/masks"),
        ),
        case(
            "render --scene given/scene.ply --capture cap --view all --out OUT --device cpu",
            "cap/views/0000.png",
            Some("cap"),
        ),
        case("eval colmap --scene given/scene.ply --out OUT --device cpu", "colmap/views/0000.png", Some("colmap")),
        case("eval colmap --scene given/metrics.json --out OUT --device cpu", "given/metrics.json", Some("given")),
        case("pareto colmap --scene given/pareto.csv --out OUT --device cpu", "given/pareto.csv", Some("given")),
        case("convert given/scene.ply OUT", "given/scene.ply", None),
        case("convert given/scene.ply OUT --format spz", "given/scene.ply", None),
        case("clean given/scene.ply OUT --box=-1,-1,-1,1,1,1", "given/scene.ply", None),
        case("clean given/scene.ply OUT --capture cap --device cpu", "cap/scene.ply", None),
        case("mesh given/scene.glb --capture cap --out OUT", "given/scene.glb", None),
        case("export given/scene.ply --html OUT", "given/scene.ply", None),
        case("export given/scene.ply --views colmap --html OUT", "colmap/sparse/0/cameras.bin", None),
        case("reconstruct plain/views --out OUT", "plain/views/0000.png", Some("plain/views")),
        case("demo --views 3 --width 16 --height 16 --out OUT", "photos/images/0000.png", Some("photos")),
        case(
            "blocks plan plan/coarse --out OUT --blocks 2 -- --steps 4 --device cpu --effects none",
            "plan/coarse/scene.ply",
            Some("plan"),
        ),
        case("blocks merge blocks --out OUT", "blocks/block-0/run/scene.ply", None),
        case("blocks merge blocks --out OUT", "cap/scene.ply", None),
    ]
}

/// Subcommands that write no file, or read none beside the one that they renew.
const OTHERS: [&str; 6] = ["view", "inspect", "hard-cases", "devices", "completions", "help"];

/// The inputs of all commands, below one folder.
fn inputs() -> TempDir {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name);
    let demo = Capture::load(&DEMO).unwrap();
    // With cameras of COLMAP, masks, and photographs in another folder.
    copy(&DEMO.join("images"), &path("colmap/views"));
    copy(&DEMO.join("sparse"), &path("colmap/sparse"));
    symlink("views", path("colmap/images")).unwrap();
    copy(&DEMO.join("images"), &path("colmap/masks"));
    for photographs in ["photos/images", "plain/views"] {
        copy(&DEMO.join("images"), &path(photographs));
    }
    for folder in ["cap", "plan/coarse"] {
        write_json(&path(folder), &demo);
    }
    fs::create_dir(path("given")).unwrap();
    for name in ["scene.ply", "scene.glb", "metrics.json", "pareto.csv"] {
        fs::copy(TRAINED.join("scene.ply"), path("given").join(name)).unwrap();
    }
    fs::write(path("given/run.toml"), "steps = 2").unwrap();
    let camera = json!({ "camera_to_world": DMat4::IDENTITY.to_cols_array() });
    fs::write(path("given/path.json"), json!({ "camera_path": [camera, camera] }).to_string()).unwrap();
    let plan = "blocks plan cap --out blocks --blocks 2 --coarse-steps 0 -- --steps 4 --effects none";
    succeed(splat(&plan.split(' ').collect::<Vec<_>>()).current_dir(root.path()));
    for block in ["blocks/block-0/run", "blocks/block-1/run"] {
        fs::write(path(block).join("metrics.json"), "{}").unwrap();
        fs::copy(TRAINED.join("scene.ply"), path(block).join("scene.ply")).unwrap();
    }
    root
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy(&entry.path(), &target),
            false => _ = fs::copy(entry.path(), target).unwrap(),
        }
    }
}

/// Writes a capture whose photographs lie in `views/` and whose points in `scene.ply`: names of results.
fn write_json(folder: &Path, demo: &Capture) {
    copy(&DEMO.join("images"), &folder.join("views"));
    let opencv_from_opengl = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
    let frame = |view: &splat_model::capture::View| {
        let world_from_cam = DMat4::from(view.cam_from_world.inverse()) * opencv_from_opengl;
        let rows = world_from_cam.transpose().to_cols_array_2d();
        let camera = view.intrinsics;
        json!({
            "file_path": format!("views/{}", view.name), "transform_matrix": rows, "w": camera.width, "h": camera.height,
            "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        })
    };
    let frames: Vec<Value> = demo.views.iter().map(frame).collect();
    let capture = json!({ "frames": frames, "ply_file_path": "scene.ply" });
    fs::write(folder.join("transforms.json"), capture.to_string()).unwrap();
    let points = demo.points.positions.iter().map(|[x, y, z]| format!("{x} {y} {z} 9 9 9\n")).collect::<Vec<_>>();
    let names = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
    let names = names.map(|name| format!("property {name}\n")).concat();
    let header = format!("ply\nformat ascii 1.0\nelement vertex {}\n{names}end_header\n", points.len());
    fs::write(folder.join("scene.ply"), header + &points.concat()).unwrap();
}

/// A checkpoint of step 0: that run failed in the next step.
fn checkpoint(root: &Path) -> PathBuf {
    let line = "train cap --out failed --steps 16 --opacity-weight 1e300 --test-every 8 --effects none";
    let ended = end(splat(&line.split(' ').collect::<Vec<_>>()).current_dir(root));
    assert!(ended.code == Some(1) && ended.stderr.contains("not finite"), "{}", ended.stderr);
    root.join("failed/checkpoints")
}

/// The content of all files below a folder, through links.
fn content(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for path in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        match path.is_dir() {
            true => found.extend(content(&path)),
            false => _ = found.insert(path.clone(), fs::read(&path).unwrap()),
        }
    }
    found
}

/// Makes the path that names the output, relative to `root`.
fn aimed(way: Way, case: &Case, root: &Path) -> PathBuf {
    let (input, folder) = (Path::new(case.input), case.folder.map(Path::new));
    let whole = folder.unwrap_or(input);
    match way {
        Way::Plain => whole.to_owned(),
        Way::Symlink => {
            let link = Path::new("link").join(whole.file_name().unwrap());
            fs::create_dir(root.join("link")).unwrap();
            symlink(root.join(whole), root.join(&link)).unwrap();
            link
        }
        Way::Up => {
            let within = folder.unwrap_or(input.parent().unwrap());
            fs::create_dir(root.join(within).join("sub")).unwrap();
            let up = within.join("sub/..");
            if folder.is_some() { up } else { up.join(input.file_name().unwrap()) }
        }
        Way::HardLink => {
            let below =
                folder.map_or(Path::new(input.file_name().unwrap()), |folder| input.strip_prefix(folder).unwrap());
            let link = root.join("hard").join(below);
            fs::create_dir_all(link.parent().unwrap()).unwrap();
            fs::hard_link(root.join(input), link).unwrap();
            if folder.is_some() { "hard".into() } else { Path::new("hard").join(below) }
        }
    }
}

#[test]
fn no_subcommand_replaces_its_input() {
    let cases = cases();
    let covered: BTreeSet<&str> = cases.iter().map(|case| case.line.split(' ').next().unwrap()).collect();
    let mut program = Cli::command();
    program.build();
    let all: BTreeSet<&str> = program.get_subcommands().map(|command| command.get_name()).collect();
    assert_eq!(all, covered.into_iter().chain(OTHERS).collect(), "a subcommand is in neither list");

    let origin = inputs();
    for (case, way) in cases.iter().flat_map(|case| WAYS.map(|way| (case, way))) {
        let root = tempfile::tempdir().unwrap();
        copy_links(origin.path(), root.path());
        let out = aimed(way, case, root.path());
        if case.line.starts_with("resume") {
            copy(&checkpoint(root.path()), &root.path().join(&out).join("checkpoints"));
        }
        let before = content(root.path());
        // A name may have blanks.
        let words: Vec<&str> = case.line.split(' ').map(|word| if word == "OUT" { text(&out) } else { word }).collect();
        let ended = end(splat(&words).current_dir(root.path()).env("PATH", "/nowhere"));
        let said = format!("{way:?}: {words:?}: {}", ended.stderr);
        assert_eq!(ended.code, Some(1), "{said}");
        let after = content(root.path());
        let changed: Vec<_> = before.iter().filter(|(path, content)| after.get(*path) != Some(content)).collect();
        assert!(changed.is_empty(), "{:?} changed: {said}", changed[0].0);
        let new: Vec<_> = after.keys().filter(|path| !before.contains_key(*path)).collect();
        assert!(new.is_empty(), "{new:?} is new: {said}");
        let name = match case.line.starts_with("reconstruct") || case.line.starts_with("demo") {
            // All photographs are meant.
            true => text(&out),
            false => Path::new(case.input).file_name().unwrap().to_str().unwrap(),
        };
        assert!(ended.stderr.contains(name) && !ended.stderr.contains("panicked"), "{name}: {said}");
    }
}

/// Copies a folder with the links in it.
fn copy_links(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        match fs::read_link(&source) {
            Ok(leads_to) => symlink(leads_to, target).unwrap(),
            Err(_) if source.is_dir() => copy_links(&source, &target),
            Err(_) => _ = fs::copy(source, target).unwrap(),
        }
    }
}
