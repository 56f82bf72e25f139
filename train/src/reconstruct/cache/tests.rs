use super::*;

fn of(source: &str, size: u64) -> Ingredients {
    Ingredients { source: source.into(), files: [("a.jpg".to_string(), size)].into(), ..Ingredients::default() }
}

#[test]
fn finished_stages_are_kept() {
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
    assert!(!Workspace::is_finished(&folder, &of("photos", 7)).unwrap());
    let error = Workspace::is_finished(&folder, &of("photos", 8)).unwrap_err().to_string();
    assert!(error.contains("other photographs") && error.contains("--out"), "{error}");
}

#[test]
fn a_folder_with_anything_else_is_left_alone() {
    let root = tempfile::tempdir().unwrap();
    fs::write(root.path().join("database.db"), "mine").unwrap();
    let error = Workspace::is_finished(root.path(), &of("photos", 7)).unwrap_err().to_string();
    assert!(error.contains("--out"), "{error}");
    assert_eq!(fs::read_to_string(root.path().join("database.db")).unwrap(), "mine");
    // A stamp of another program is none.
    fs::write(root.path().join(STAMP), "{\"views\": 3}").unwrap();
    assert!(Workspace::is_finished(root.path(), &of("photos", 7)).is_err());
    assert_eq!(fs::read_to_string(root.path().join("database.db")).unwrap(), "mine");
}

#[test]
fn what_a_stage_left_is_removed_and_what_is_there_is_not_replaced() {
    let root = tempfile::tempdir().unwrap();
    let workspace = Workspace::open(root.path(), of("photos", 7)).unwrap();
    fs::create_dir_all(workspace.join("sparse.partial/mapper/0")).unwrap();
    fs::write(workspace.join(DATABASE), "").unwrap();
    workspace.complete(&workspace.join("sparse.partial/mapper"), SPARSE).unwrap();
    workspace.clear(&[SPARSE_PARTIAL, DATABASE, LISTS]).unwrap();
    assert!(workspace.join("sparse/0").is_dir() && !workspace.join(SPARSE_PARTIAL).exists());
    assert!(!workspace.join(DATABASE).exists());
    fs::create_dir_all(workspace.join("images.partial/a")).unwrap();
    let error = workspace.complete(&workspace.join(IMAGES_PARTIAL), SPARSE).unwrap_err().to_string();
    assert!(error.contains("move away") && workspace.join("sparse/0").is_dir(), "{error}");
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
