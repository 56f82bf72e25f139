use std::fs;

use super::*;

#[test]
fn an_input_is_known_by_whatever_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir_all(path("photos/sub")).unwrap();
    fs::write(path("photos/a.png"), "a").unwrap();
    fs::write(path("photos/b.png"), "a").unwrap();
    fs::hard_link(path("photos/a.png"), path("hard.png")).unwrap();
    let inputs = Inputs::of([path("photos/a.png"), path("photos/missing.png")]);
    let mut names = vec![
        "photos/a.png",
        "photos/sub/../a.png",
        "photos/./a.png",
        "hard.png",
        "photos/sub/../missing.png",
        "new/b/../../hard.png",
    ];
    if cfg!(unix) {
        #[cfg(unix)]
        for (to, link) in [("photos/a.png", "soft.png"), ("photos", "folder")] {
            std::os::unix::fs::symlink(path(to), path(link)).unwrap();
        }
        names.extend(["soft.png", "folder/a.png", "folder/missing.png"]);
    }
    for name in names {
        let found = inputs.find(&path(name)).unwrap_or_else(|| panic!("{name}"));
        assert!(found.ends_with(if name.contains("missing") { "missing.png" } else { "a.png" }), "{found:?}");
        let error = inputs.spare([path("new.png"), path(name)]).unwrap_err().to_string();
        assert!(error.contains(path(name).to_str().unwrap()) && error.contains(found.to_str().unwrap()), "{error}");
    }
    for name in ["photos/b.png", "new.png", "photos/new.png", "new/missing.png", "photos", "photos/A.PNG.x"] {
        assert_eq!(inputs.find(&path(name)), None, "{name}");
    }
    // Where the file system ignores letter case, the other name is the same file; elsewhere it is another.
    assert_eq!(inputs.find(&path("photos/A.png")).is_some(), path("photos/A.png").exists());
    inputs.spare([path("photos/b.png")]).unwrap();
    assert!(Inputs::default().find(&path("photos/a.png")).is_none());
}
