use super::*;

const SMALL: DemoOptions = DemoOptions { width: 16, height: 16, views: 2, points: 10, ..DemoOptions::PLAIN };

#[test]
fn a_complete_capture_is_reused_and_another_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("demo");
    assert!(ensure(&folder, &SMALL).unwrap());
    assert!(!ensure(&folder, &SMALL).unwrap());
    fs::remove_file(folder.join("images/0001.png")).unwrap();
    assert!(ensure(&folder, &SMALL).unwrap(), "a picture is missing");
    fs::remove_dir_all(folder.join("sparse")).unwrap();
    assert!(ensure(&folder, &SMALL).unwrap(), "interrupted before the model was in place");
    assert!(ensure(&folder, &DemoOptions { views: 3, ..SMALL }).unwrap(), "another demo");
    assert_eq!(Capture::load(&folder).unwrap().views.len(), 3);
    let mut names: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["demo.json", "images", "sparse"]);
}

/// The files that an effect adds beside the pictures are removed with the effect, and are made again when missing.
#[test]
fn what_effects_add_comes_and_goes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("demo");
    let all = DemoOptions { masks: true, motion: true, depth: true, ..SMALL };
    assert!(ensure(&folder, &all).unwrap());
    assert!(!ensure(&folder, &all).unwrap());
    for file in ["masks/0001.png", "depth/0000.png", "depth/depth.json", "truth.json"] {
        fs::remove_file(folder.join(file)).unwrap();
        assert!(ensure(&folder, &all).unwrap(), "{file} is missing");
        assert!(folder.join(file).is_file(), "{file}");
    }
    assert!(!folder.join("masks/0000.png").exists(), "held out");
    let truth: Value = serde_json::from_slice(&fs::read(folder.join("truth.json")).unwrap()).unwrap();
    let photographs = truth["photographs"].as_array().unwrap();
    assert_eq!(photographs.len(), 2);
    for (photograph, name) in photographs.iter().zip(["0000.png", "0001.png"]) {
        assert_eq!(photograph["name"].as_str(), Some(name));
        let rotation = photograph["rotation_wxyz"].as_array().unwrap();
        let squared: f64 = rotation.iter().map(|value| value.as_f64().unwrap().powi(2)).sum();
        assert!((squared - 1.0).abs() < 1e-12 && photograph["readout"]["angular"].as_array().unwrap().len() == 3);
    }
    assert!(ensure(&folder, &SMALL).unwrap());
    for name in ["masks", "depth", "truth.json"] {
        assert!(!folder.join(name).exists(), "{name}");
    }
}

/// Two demos with different options never have the same mark: each option's value appears in it.
#[test]
fn each_flag_is_an_option_of_its_own() {
    use clap::{CommandFactory, FromArgMatches, Parser};
    #[derive(Parser)]
    struct DemoCli {
        #[command(flatten)]
        demo: DemoArgs,
    }
    let marked = |line: &[&str]| {
        let line = ["demo", "--out", "x"].iter().chain(line);
        made_with(&DemoCli::from_arg_matches(&DemoCli::command().get_matches_from(line)).unwrap().demo.options())
    };
    let plain = marked(&[]);
    assert_eq!(plain, made_with(&DemoOptions::PLAIN));
    let flags: Vec<String> = plain
        .as_object()
        .unwrap()
        .iter()
        .filter(|(_, value)| value.is_boolean())
        .map(|(name, _)| name.clone())
        .collect();
    assert_eq!(flags.len(), 14);
    assert_eq!(marked(&["--town"]), made_with(&DemoOptions::TOWN));
    for flag in flags.into_iter().filter(|flag| flag != "town") {
        let mut expected = plain.clone();
        expected[&flag] = true.into();
        assert_eq!(marked(&[&format!("--{flag}")]), expected);
    }
}

#[test]
fn a_folder_with_other_pictures_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let photo = folder.path().join("images/mine.jpg");
    fs::create_dir(photo.parent().unwrap()).unwrap();
    fs::write(&photo, "").unwrap();
    let error = ensure(folder.path(), &SMALL).unwrap_err().to_string();
    assert!(error.contains("images/mine.jpg") && error.contains("--out"), "{error}");
    assert!(photo.exists());
}

/// A demo is replaced by another only as far as it is a demo.
#[test]
fn what_a_user_put_into_a_demo_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let other = DemoOptions { views: 3, ..SMALL };
    for (file, content) in [("images/mine.png", "mine"), ("masks/a/0001.png", "mine"), ("images/0001.png", "painted")] {
        ensure(folder.path(), &SMALL).unwrap();
        fs::create_dir_all(path(file).parent().unwrap()).unwrap();
        fs::write(path(file), content).unwrap();
        let before = own::files_below(folder.path()).unwrap();
        let error = ensure(folder.path(), &other).unwrap_err().to_string();
        assert!(error.contains(file) && error.contains("--out"), "{error}");
        assert_eq!(own::files_below(folder.path()).unwrap(), before);
        assert_eq!(fs::read_to_string(path(file)).unwrap(), content);
        fs::remove_file(path(file)).unwrap();
    }
    fs::write(path("notes.txt"), "beside the capture").unwrap();
    assert!(ensure(folder.path(), &other).unwrap() && path("notes.txt").exists());
    fs::write(path(MARK), "{\"steps\": 5}").unwrap();
    assert!(ensure(folder.path(), &SMALL).unwrap_err().to_string().contains(MARK), "of another program");
}
