use super::*;

const SMALL: DemoOptions = DemoOptions { width: 16, height: 16, views: 2, points: 10, ..DemoOptions::PLAIN };

#[test]
fn a_complete_capture_is_reused_and_nothing_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("demo");
    assert!(ensure(&folder, &SMALL).unwrap());
    assert!(!ensure(&folder, &SMALL).unwrap());
    let mut names: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["demo.json", "images", "sparse"]);
    let refused = |options: &DemoOptions| {
        let error = ensure(&folder, options).unwrap_err().to_string();
        assert!(error.contains("images already exists") && error.contains("--out"), "{error}");
    };
    refused(&DemoOptions { views: 3, ..SMALL });
    assert_eq!(Capture::load(&folder).unwrap().views.len(), 2);
    fs::remove_file(folder.join("images/0001.png")).unwrap();
    refused(&SMALL);
    assert!(folder.join("images/0000.png").exists());
}

/// The capture is not complete without the files that an effect adds beside the pictures.
#[test]
fn what_effects_add_belongs_to_the_capture() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path().join("demo");
    let all = DemoOptions { masks: true, motion: true, depth: true, ..SMALL };
    assert!(ensure(&folder, &all).unwrap());
    assert!(!ensure(&folder, &all).unwrap());
    for file in ["masks/0001.png", "depth/0000.png", "depth/depth.json", "truth.json"] {
        let (there, away) = (folder.join(file), folder.join("away"));
        fs::rename(&there, &away).unwrap();
        assert!(ensure(&folder, &all).is_err(), "{file} is missing");
        fs::rename(&away, &there).unwrap();
        assert!(!ensure(&folder, &all).unwrap(), "{file}");
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
    assert!(error.contains("images already exists") && error.contains("--out"), "{error}");
    assert!(photo.exists());
}

#[test]
fn a_mark_of_another_program_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("notes.txt"), "beside the capture").unwrap();
    fs::write(folder.path().join(MARK), "{\"steps\": 5}").unwrap();
    assert!(ensure(folder.path(), &SMALL).unwrap_err().to_string().contains(MARK));
    fs::remove_file(folder.path().join(MARK)).unwrap();
    assert!(ensure(folder.path(), &SMALL).unwrap() && folder.path().join("notes.txt").exists());
}
