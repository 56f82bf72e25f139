//! Tests that tests, benches and pages read only files inside the repository, or files of `SPLAT_DATA_DIR`.

use std::fs;
use std::path::{Component, Path, PathBuf};

/// Folder beside the clones in which this project was written, in two parts, so that this file does not contain its name.
const BESIDE: [&str; 2] = ["..", "/shared"];

/// Folders that are not tracked, and `.ci`, which names optional data that may exist.
const PASSED_OVER: [&str; 6] = [".ci", ".git", ".github", "target", "out", "node_modules"];

/// Extensions of text files.
const TEXT: [&str; 12] = ["rs", "toml", "md", "py", "sh", "yml", "yaml", "json", "js", "html", "css", "txt"];

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests are a folder of the repository").to_owned()
}

/// Collects the text files below a folder.
fn texts(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a readable folder").map(|entry| entry.expect("a readable entry")) {
        let (path, name) = (entry.path(), entry.file_name());
        if entry.file_type().expect("a readable entry").is_dir() {
            if !PASSED_OVER.iter().any(|passed| name == *passed) {
                texts(&path, found);
            }
        } else if path.extension().is_some_and(|end| TEXT.iter().any(|text| end == *text)) {
            found.push(path);
        }
    }
}

/// Returns the folder of the crate that a file belongs to, relative to the repository.
fn crate_of(file: &Path, root: &Path) -> PathBuf {
    let folder = file.ancestors().skip(1).find(|folder| folder.join("Cargo.toml").is_file());
    folder.expect("the repository has a Cargo.toml").strip_prefix(root).expect("below the root").to_owned()
}

/// Returns the reason if a text reads files outside the repository: the name of the folder beside it, or a path that leaves it.
fn leaves(text: &str, home: &Path) -> Option<String> {
    let beside = BESIDE.concat();
    if text.contains(&beside) {
        return Some(format!("names {beside}"));
    }
    let after = text.split("env!(\"CARGO_MANIFEST_DIR\")").skip(1);
    let literals =
        after.filter_map(|rest| rest.split_once('"').map(|(_, rest)| rest.split('"').next().unwrap_or(rest)));
    // Other string literals do not begin with `..`.
    for literal in literals.map(|literal| literal.trim_start_matches('/')).filter(|literal| literal.starts_with("..")) {
        let mut depth = home.components().count();
        for component in Path::new(literal).components() {
            match component {
                Component::ParentDir if depth == 0 => return Some(format!("climbs out by {literal}")),
                Component::ParentDir => depth -= 1,
                _ => depth += 1,
            }
        }
    }
    None
}

#[test]
fn nothing_outside_the_repository_is_read() {
    let root = repository();
    let mut files = Vec::new();
    texts(&root, &mut files);
    assert!(files.len() > 300, "only {} files of {}", files.len(), root.display());
    let read = |file: &PathBuf| String::from_utf8_lossy(&fs::read(file).expect("a readable file")).into_owned();
    let found: Vec<String> = files
        .iter()
        .filter_map(|file| Some(format!("{} {}", file.display(), leaves(&read(file), &crate_of(file, &root))?)))
        .collect();
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn what_leaves_the_repository_is_seen() {
    let home = Path::new("tests");
    assert!(leaves(&format!("splat train {}/data/fox_small", BESIDE.concat()), home).is_some());
    let path = |literal: &str| format!("concat!(env!(\"CARGO_MANIFEST_DIR\"), \"{literal}\")");
    assert!(leaves(&path("/../../data"), home).is_some());
    assert!(leaves(&path("/../docs/../../data"), home).is_some());
    assert!(leaves(&path("/../docs"), home).is_none());
    assert!(leaves(&path("/../../docs"), Path::new("tests/hard-cases")).is_none());
}
