use super::*;

#[test]
fn files_are_known_by_name_and_content() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("made.partial/0")).unwrap();
    fs::create_dir(path("made.partial/none")).unwrap();
    for name in ["made.partial/0/a", "made.partial/b", "c"] {
        fs::write(path(name), name).unwrap();
    }
    let mut own = OwnFiles::default();
    own.add(folder.path(), "made.partial", "made").unwrap();
    own.add(folder.path(), "c", "c").unwrap();
    fs::rename(path("made.partial"), path("made")).unwrap();
    fs::write(path("made/mine"), "made.partial/b").unwrap();
    let all = files_below(&path("made")).unwrap();
    assert_eq!(all, ["made/0/a", "made/b", "made/mine"].map(path));
    let held = |own: &OwnFiles, name: &str| own.hold(folder.path(), &path(name));
    assert_eq!(
        ["made/0/a", "made/b", "made/mine", "c", "none"].map(|name| held(&own, name)),
        [true, true, false, true, false]
    );
    fs::write(path("c"), "changed").unwrap();
    assert!(!held(&own, "c"));
    let again: OwnFiles = serde_json::from_str(&serde_json::to_string(&own).unwrap()).unwrap();
    assert_eq!(again, own);
    // Only what is left in the way of a folder keeps it.
    remove(&path("made"), &all[..2]).unwrap();
    assert_eq!(files_below(folder.path()).unwrap(), ["c", "made/mine"].map(path));
    assert!(!path("made/0").exists() && !path("made/none").exists());
    assert!(begins_with(&path("c"), b"chan") && begins_with(&path("c"), b"changed, and more"));
    assert!(!begins_with(&path("c"), b"made") && !begins_with(&path("none"), b""));
    own.add(folder.path(), "none", "made").unwrap();
    assert!(!held(&own, "made/b") && files_below(&path("none")).unwrap().is_empty());
}
