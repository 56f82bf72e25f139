use super::*;

fn folder(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }
    folder
}

#[test]
fn a_path_stays_below_its_folder_however_it_is_read() {
    assert_eq!(below("./a/./b.png").as_deref(), Some("a/b.png"));
    assert_eq!(below("a\\b.png").as_deref(), Some("a\\b.png"));
    assert_eq!(below("C:x.png").as_deref(), Some("C:x.png"));
    for path in
        ["", ".", "/a", "../a", "a/../b", "..\\a", "a\\..\\b", "\\a", "\\\\server\\a", "C:\\a", "c:/a", "a/..\\b"]
    {
        assert_eq!(below(path), None, "{path}");
    }
}

/// Letter case is folded on file systems that distinguish it; on others the first form is there.
#[cfg(target_os = "linux")]
#[test]
fn names_of_other_systems_are_found_where_they_are_unambiguous() {
    let names = [
        "in/A.JPG",
        "in/a b.png",
        "in/Two.png",
        "in/TWO.png",
        "in/re\u{301}sume\u{301}.png",
        "in/d.png.png",
        "in/e.jpeg",
        "w\\f.png",
    ];
    let folder = folder(&names);
    let mut found = Names::default();
    let mut find = |stated: &str| found.find(folder.path(), stated, &PICTURES);
    for (stated, expected) in [
        ("in/a b.png", Some("in/a b.png")),
        ("in\\a b.png", Some("in/a b.png")),
        ("IN\\a.jpg", Some("in/A.JPG")),
        ("in/R\u{e9}sum\u{e9}.PNG", Some("in/re\u{301}sume\u{301}.png")),
        ("in/d.png", Some("in/d.png.png")),
        ("in/D.png", Some("in/d.png.png")),
        ("in/e", Some("in/e.jpeg")),
        ("w\\f.png", Some("w\\f.png")),
        ("in/Two.png", Some("in/Two.png")),
        ("in/two.png", None),
        ("in/g.png", None),
        ("in", None),
    ] {
        assert_eq!(find(stated).as_deref(), expected, "{stated}");
    }
    assert_eq!(found.find(folder.path(), "in/e", &[]), None);
}

#[test]
fn what_lies_beside_a_missing_file_is_said() {
    let folder = folder(&["in/a.png", "in/b.png", "in/c.png", "in/d.png", "e"]);
    let of = |name: &str| beside(&folder.path().join(name));
    let root = folder.path().display();
    assert_eq!(of("in/x.png"), format!("{root}/in holds \"a.png\", \"b.png\", \"c.png\" and 1 more"));
    assert_eq!(of("images/left/x.png"), format!("{root} holds \"e\", \"in\""));
}

#[test]
fn files_are_listed_with_their_folders() {
    let folder = folder(&["b.png", "a/c.png", ".hidden", ".git/x"]);
    assert_eq!(files_below(folder.path(), &[]).unwrap(), ["a/c.png", "b.png"]);
    assert!(files_below(&folder.path().join("none"), &[]).is_err());
}
