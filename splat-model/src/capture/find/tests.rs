use std::fs;

use super::*;
use crate::capture::testing::assert_says;

/// A folder with these files. `cameras.txt` and `images.txt` are a model of the photographs a.png and b.png, `.json` has them as frames, and other
/// files are pictures of 8 × 6 px.
fn folder(files: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in files {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let pose = r#""transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]]"#;
        match path.file_name().unwrap().to_str().unwrap() {
            "cameras.txt" => fs::write(&path, "1 PINHOLE 8 6 8 8 4 3\n").unwrap(),
            "images.txt" => fs::write(&path, "1 1 0 0 0 0 0 0 1 a.png\n\n2 1 0 0 0 1 0 0 1 b.png\n\n").unwrap(),
            json if json.ends_with(".json") => {
                let frame = |name: &str| format!(r#"{{"file_path": "images/{name}.png", {pose}}}"#);
                let text = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}, {}]}}"#, frame("a"), frame("b"));
                fs::write(&path, text).unwrap();
            }
            _ => ::image::RgbImage::new(8, 6).save(&path).unwrap(),
        }
    }
    folder
}

fn model(at: &str) -> Vec<String> {
    ["cameras.txt", "images.txt"].map(|name| format!("{at}{name}")).to_vec()
}

fn pictures(at: &str) -> Vec<String> {
    ["a.png", "b.png"].map(|name| format!("{at}{name}")).to_vec()
}

fn with(files: &[Vec<String>]) -> tempfile::TempDir {
    folder(&files.iter().flatten().map(String::as_str).collect::<Vec<_>>())
}

/// For each layout: where the model is, where the pictures are, what is named, and the capture's folder.
#[test]
fn cameras_are_found_at_the_places_where_programs_put_them() {
    for (model_at, pictures_at, named, home) in [
        ("sparse/0/", "images/", "", ""),
        ("sparse/0/", "", "", ""),
        ("sparse/0/", "images/", "sparse", ""),
        ("sparse/0/", "images/", "sparse/0", ""),
        ("sparse/0/", "images/", "sparse/0/cameras.txt", ""),
        ("sparse/0/", "images/", "images", ""),
        ("", "", "", ""),
        ("", "images/", "", ""),
        ("", "photos/", "", ""),
        ("", "images/", "images", ""),
        ("", "photos/", "photos", ""),
        ("colmap/sparse/0/", "images/", "", ""),
        ("colmap/sparse/0/", "images/", "images", ""),
        ("distorted/sparse/0/", "input/", "", ""),
        ("distorted/sparse/0/", "input/", "input", ""),
        ("dense/sparse/", "dense/images/", "", "dense"),
        ("text/", "images/", "", ""),
        ("export/model/", "export/", "", "export"),
        ("capture/sparse/0/", "capture/images/", "", "capture"),
        ("capture/colmap/sparse/0/", "capture/images/", "", "capture"),
    ] {
        let folder = with(&[model(model_at), pictures(pictures_at)]);
        let source = if named.is_empty() { folder.path().to_owned() } else { folder.path().join(named) };
        let case = format!("{model_at} and {pictures_at} by {named:?}");
        assert!(is_there(&source), "{case}");
        let capture = Capture::load(&source).unwrap_or_else(|error| panic!("{case}: {error}"));
        let canonical = |path: &Path| path.canonicalize().unwrap();
        let paths: Vec<PathBuf> = capture.views.iter().map(|view| canonical(&view.image_path)).collect();
        assert_eq!(
            paths,
            pictures(pictures_at).iter().map(|name| canonical(&folder.path().join(name))).collect::<Vec<_>>(),
            "{case}"
        );
        assert_eq!(canonical(&capture.folder), canonical(&folder.path().join(home)), "{case}");
        assert_eq!(canonical(&capture.files[0]), canonical(&folder.path().join(model_at).join("images.txt")), "{case}");
        let is_usual =
            model_at == "sparse/0/" && !["sparse", "sparse/0", "images"].contains(&named) || source.is_file();
        assert_eq!(capture.remarks.iter().any(|remark| remark.contains("cameras are read from")), !is_usual, "{case}");
    }
}

#[test]
fn frames_are_found_in_json_of_any_name() {
    for (json, named, home) in [
        ("transforms.json", "", ""),
        ("transforms.json", "transforms.json", ""),
        ("transforms.json", "images", ""),
        ("transform_train.json", "", ""),
        ("cameras.json", "cameras.json", ""),
        ("transforms_all.JSON", "", ""),
        ("transforms_test.json", "", ""),
    ] {
        let folder = with(&[vec![json.to_lowercase()], pictures("images/")]);
        fs::rename(folder.path().join(json.to_lowercase()), folder.path().join(json)).unwrap();
        let capture = Capture::load(&folder.path().join(named)).unwrap();
        assert_eq!(
            capture.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(),
            ["images/a.png", "images/b.png"],
            "{json}"
        );
        assert_eq!(capture.folder.canonicalize().unwrap(), folder.path().join(home).canonicalize().unwrap());
    }
    let folder = with(&[vec!["c/transforms.json".into()], pictures("c/images/")]);
    assert_eq!(Capture::load(folder.path()).unwrap().folder, folder.path().join("c"));
    // Other JSON is no camera.
    let other = folder.path().join("c/images/notes.json");
    fs::write(&other, r#"{"frames": 7}"#).unwrap();
    assert!(!is_there(&other) && is_there(&folder.path().join("c")));
}

#[test]
fn of_several_the_one_whose_photographs_are_there_is_read() {
    let folder = with(&[model("colmap/sparse/0/"), vec!["old/cameras.json".into()], pictures("images/")]);
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!(capture.views[0].image_path, folder.path().join("images/a.png"));
    assert_says(&capture.remarks[0], &["colmap/sparse/0", "old/cameras.json are not there"]);
    // The size of the pictures decides between two folders that have them.
    let folder = with(&[model("distorted/sparse/0/"), pictures("images/"), pictures("input/")]);
    for name in pictures("images/") {
        ::image::RgbImage::new(7, 6).save(folder.path().join(name)).unwrap();
    }
    assert_eq!(Capture::load(folder.path()).unwrap().views[0].image_path, folder.path().join("input/a.png"));
}

#[test]
fn what_is_ambiguous_is_refused_with_a_list() {
    let says = |folder: &Path, parts: &[&str]| {
        assert!(is_there(folder));
        assert_says(&Capture::load(folder).unwrap_err().to_string(), parts);
    };
    let folder = with(&[model("colmap/sparse/0/"), vec!["cameras.json".into()], pictures("images/")]);
    says(
        folder.path(),
        &[folder.path().to_str().unwrap(), "several places", "cameras.json", "colmap/sparse/0", "Name the one"],
    );
    let folder = with(&[model("colmap/sparse/0/"), vec!["cameras.json".into()], pictures("elsewhere/at/all/")]);
    says(folder.path(), &["cameras.json", "colmap/sparse/0", "the photographs of none are there"]);
    let folder = with(&[model("sparse/0/"), pictures("images/"), vec!["others/x.png".into()]]);
    says(&folder.path().join("others"), &["above", "sparse/0", "a folder of their own"]);
    // Half a model is an error, and no reason to look elsewhere.
    let folder = with(&[vec!["cameras.txt".into()], pictures("")]);
    says(folder.path(), &["no images found", "images.txt"]);
}

#[test]
fn what_this_program_wrote_does_not_count() {
    let folder = with(&[model("out/photos-reconstruction/sparse/0/"), pictures("")]);
    assert!(is_there(folder.path()));
    fs::write(folder.path().join("out/photos-reconstruction/reconstruction.json"), "{}").unwrap();
    assert!(!is_there(folder.path()));
    assert_says(
        &Capture::load(folder.path()).unwrap_err().to_string(),
        &["no COLMAP model found", "sparse/cameras.bin"],
    );
}
