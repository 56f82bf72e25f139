use super::*;

fn of(source: &str, size: u64) -> Ingredients {
    Ingredients { source: source.into(), files: [("a.jpg".to_string(), size)].into(), ..Ingredients::default() }
}

#[test]
fn finished_stages_are_kept_until_something_changes() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("made");
    let mut workspace = Workspace::open(&folder, of("photos", 7)).unwrap();
    fs::write(workspace.join(DATABASE), "SQLite format 3\0 features").unwrap();
    workspace.set_features([("a.jpg".to_string(), 40)].into());
    workspace.finish(Stage::Features).unwrap();
    let again = Workspace::open(&folder, of("photos", 7)).unwrap();
    assert!(again.has(Stage::Features) && !again.has(Stage::Matches) && again.join(DATABASE).exists());
    assert_eq!(again.features()["a.jpg"], 40);
    let moved = Workspace::open(&folder, of("elsewhere/photos", 7)).unwrap();
    assert!(moved.has(Stage::Features));
    let changed = Workspace::open(&folder, of("photos", 8)).unwrap();
    assert!(!changed.has(Stage::Features) && !changed.join(DATABASE).exists());
}

#[test]
fn a_folder_with_anything_else_is_left_alone() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join("database.db"), "mine").unwrap();
    let error = Workspace::open(root.path(), of("photos", 7)).err().unwrap().to_string();
    assert!(error.contains("--out"), "{error}");
    assert_eq!(fs::read_to_string(root.path().join("database.db")).unwrap(), "mine");
    // A stamp of another program is none.
    fs::write(root.path().join(STAMP), "{\"views\": 3}").unwrap();
    assert!(Workspace::open(root.path(), of("photos", 7)).is_err());
    assert_eq!(fs::read_to_string(root.path().join("database.db")).unwrap(), "mine");
}

/// Other photographs make everything anew, except what the user put there or changed.
#[test]
fn what_is_not_as_it_was_written_is_kept() {
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name);
    let write = |name: &str, content: &[u8]| {
        fs::create_dir_all(path(name).parent().unwrap()).unwrap();
        fs::write(path(name), content).unwrap();
    };
    let frame = b"\xff\xd8\xff, a frame".as_slice();
    let own = [
        ("sparse.partial/0/cameras.bin", b"the model".as_slice()),
        ("images.partial/frame_000003.jpg", frame),
        ("lists/0.txt", b"a.jpg"),
        (LOG, b"\n$ \"colmap\""),
        (DATABASE, b"SQLite format 3\0"),
        ("database.db-wal", b"changes"),
    ];
    let make = |size: u64| {
        let mut workspace = Workspace::open(root.path(), of("photos", size))?;
        own.iter().for_each(|(name, content)| write(name, content));
        workspace.complete(SPARSE_PARTIAL, SPARSE)?;
        workspace.complete(IMAGES_PARTIAL, IMAGES)?;
        // Of a mapper and a decoder that were killed.
        own[..2].iter().for_each(|(name, content)| write(name, content));
        workspace.finish(Stage::Model)
    };
    make(1).unwrap();
    make(2).unwrap();
    for (name, text) in [
        ("sparse/0/cameras.bin", "aligned by hand"),
        ("sparse/mine/cameras.bin", "the model"),
        ("images/frame_000003.jpg", "retouched"),
        ("images/more.jpg", "a photograph"),
        ("images.partial/frame_000003.jpg", "a text"),
        ("sparse.partial/notes", "a text"),
        ("lists/mine.txt", "a.jpg"),
        (LOG, "a diary"),
        (DATABASE, "mine"),
        (SCALE_FILE, "{\"metres_per_unit\": 3.0}"),
    ] {
        let before = fs::read(path(name)).ok();
        write(name, text.as_bytes());
        let files = own::files_below(root.path()).unwrap();
        let error = Workspace::open(root.path(), of("photos", 3)).err().unwrap().to_string();
        assert!(error.contains(name) && error.contains("--out"), "{error}");
        assert_eq!(
            (fs::read_to_string(path(name)).unwrap().as_str(), own::files_below(root.path()).unwrap()),
            (text, files)
        );
        match before {
            Some(before) => fs::write(path(name), before).unwrap(),
            None => fs::remove_file(path(name)).unwrap(),
        }
    }
    write("masks/a.png", b"a mask of the user's");
    make(3).unwrap();
    assert!(path("masks/a.png").exists());
    write(SCALE_FILE, b"{\"metres_per_unit\": 3.0}");
    make(3).unwrap();
    assert!(path(SCALE_FILE).exists(), "measured by hand");
}

#[test]
fn photographs_of_the_same_name_have_folders_of_their_own() {
    let root = tempfile::tempdir().unwrap();
    let folder = |source: &str| own_folder(root.path(), "photos", Path::new(source));
    assert_eq!(folder("/a/photos"), root.path().join("photos"));
    Workspace::open(&root.path().join("photos"), of("/a/photos", 1)).unwrap();
    assert_eq!(folder("/a/photos"), root.path().join("photos"));
    assert_eq!(folder("/b/photos"), root.path().join("photos-2"));
    fs::create_dir_all(root.path().join("photos-2/x")).unwrap();
    assert_eq!(folder("/b/photos"), root.path().join("photos-3"));
}
