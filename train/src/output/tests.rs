use std::io::Write;

use super::*;

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn a_file_is_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let out = OutputFolder::prepare(folder.path(), Inputs::default(), ["a.txt"], &[]).unwrap();
    for text in ["first, longer", "second"] {
        out.write("a.txt", |file| Ok(file.write_all(text.as_bytes())?)).unwrap();
        assert_eq!(fs::read_to_string(out.join("a.txt")).unwrap(), text);
    }
    assert_eq!(names_in(folder.path()), ["a.txt"]);
}

#[test]
fn what_a_killed_process_left_is_swept_away() {
    let folder = tempfile::tempdir().unwrap();
    let written = ["a.txt", "scene.ply", "views/b.png", "none/c.png"];
    let out = OutputFolder::prepare(folder.path(), Inputs::default(), written, &["views"]).unwrap();
    let kept = [".hidden", "a.txt.tmp-aB3dE9", ".a.txt.tmp-7-0", ".tmp-aB3dE9", ".mine.tmp-aB3dE9", "views/b.png"];
    for name in [&kept[..], &[".a.txt.tmp-aB3dE9", ".scene.ply.tmp-000000", "views/.b.png.tmp-ZZZZZZ"]].concat() {
        out.write(name, |_| Ok(())).unwrap();
    }
    out.sweep();
    let mut left = names_in(folder.path());
    left.sort();
    assert_eq!(left, [".a.txt.tmp-7-0", ".hidden", ".mine.tmp-aB3dE9", ".tmp-aB3dE9", "a.txt.tmp-aB3dE9", "views"]);
    assert_eq!(names_in(&out.join("views")), ["b.png"]);
}

#[test]
fn an_input_is_never_replaced_and_nothing_is_made_before_that_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.ply");
    fs::write(&scene, "precious").unwrap();
    let (inputs, new) = (Inputs::of([&scene]), folder.path().join("new/folder"));
    let refused = |error: anyhow::Error| assert!(error.to_string().contains("scene.ply is an input"), "{error}");
    refused(OutputFolder::prepare(folder.path(), inputs.clone(), ["a.txt", "scene.ply"], &[]).unwrap_err());
    refused(OutputFolder::prepare(&new, inputs.clone(), ["../../scene.ply"], &[]).unwrap_err());
    refused(prepare_file(&new.join("../../scene.ply"), &inputs).unwrap_err());
    assert!(!new.exists());
    // A file that was not announced.
    let out = OutputFolder::prepare(folder.path(), inputs.clone(), ["a.txt"], &[]).unwrap();
    refused(out.write("scene.ply", |file| Ok(file.write_all(b"new")?)).unwrap_err());
    assert_eq!(fs::read_to_string(&scene).unwrap(), "precious");
    prepare_file(&new.join("a.ply"), &inputs).unwrap();
    assert!(new.is_dir());
}

#[test]
fn nothing_at_all_replaces_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    write(&path, |file| Ok(file.write_all(b"precious")?)).unwrap();
    let error = format!("{:#}", write(&path, |_| Ok(())).unwrap_err());
    assert!(error.contains("a.txt") && error.contains("empty"), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "precious");
    assert_eq!(names_in(folder.path()), ["a.txt"]);
}

#[test]
fn a_folder_is_free_until_something_is_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let free = |may_hold: &[&str]| free_folder(folder.path(), OsStr::new("fox.v1"), may_hold);
    let path = |name: &str| folder.path().join(name);
    assert_eq!(free(&[]), path("fox.v1"));
    fs::create_dir(path("fox.v1")).unwrap();
    assert_eq!(free(&[]), path("fox.v1"), "empty");
    fs::create_dir(path("fox.v1/checkpoints")).unwrap();
    assert_eq!(free(&[]), path("fox.v1-2"));
    assert_eq!(free(&["checkpoints"]), path("fox.v1"));
    fs::write(path("fox.v1-2"), "a file").unwrap();
    fs::create_dir_all(path("fox.v1-3/views")).unwrap();
    assert_eq!(free(&[]), path("fox.v1-4"));
    // Nothing can be below a file; the error is left to whoever creates the folder.
    assert_eq!(free_folder(&path("fox.v1-2"), OsStr::new("a"), &[]), path("fox.v1-2/a"));
}

#[test]
fn a_failure_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    write(&path, |file| Ok(file.write_all(b"good")?)).unwrap();
    let error = write(&path, |file| {
        file.write_all(b"ba")?;
        bail!("the sun went down")
    });
    let error = format!("{:#}", error.unwrap_err());
    assert!(error.contains("a.txt") && error.contains("the sun went down"), "{error}");
    assert_eq!(fs::read_to_string(&path).unwrap(), "good");
    assert_eq!(names_in(folder.path()), ["a.txt"]);
}

#[test]
fn what_cannot_be_written_is_found_beforehand() {
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("taken");
    fs::write(&taken, "").unwrap();
    fs::create_dir(folder.path().join("metrics.json")).unwrap();
    for (path, files, folders) in [
        (taken.clone(), vec![], vec![]),
        (taken.join("below"), vec![], vec![]),
        (folder.path().to_owned(), vec!["metrics.json"], vec![]),
        (folder.path().to_owned(), vec![], vec!["taken"]),
    ] {
        let error = OutputFolder::prepare(&path, Inputs::default(), &files, &folders).unwrap_err().to_string();
        let named = files.first().or(folders.first()).map_or(path.clone(), |name| path.join(name));
        assert!(error.contains(named.to_str().unwrap()) && error.contains("--out"), "{error}");
    }
}

#[test]
fn numbers_are_short() {
    let cases = [
        (0.0, "0"),
        (0.00012, "1.2e-4"),
        (0.001, "0.0010"),
        (0.0371, "0.037"),
        (3.16, "3.2"),
        (42.4, "42"),
        (12345.0, "1.2e4"),
    ];
    for (value, text) in cases {
        assert_eq!(short(value, 2), text);
    }
    let cases =
        [(0.0, "0"), (1.0, "1.000"), (-12.3456, "-12.35"), (54321.0, "54321"), (1e-4, "1.000e-4"), (-2e7, "-2.000e7")];
    for (value, text) in cases {
        assert_eq!(short(value, 4), text);
    }
}
