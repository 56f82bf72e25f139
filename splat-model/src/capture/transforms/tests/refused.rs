//! Tests of files that are not a capture: each message names the file, the frame, the field, what was found and what was
//! expected.

use super::*;
use crate::capture::testing::assert_says;

/// The error message for a file with these frames; it must name the file.
fn message(frames: &str) -> String {
    message_of(&format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": {frames}}}"#))
}

fn message_of(text: &str) -> String {
    let root = folder(&[(SINGLE, text)]);
    let message = Capture::load(root.path()).unwrap_err().to_string();
    assert_says(&message, &[root.path().join(SINGLE).to_str().unwrap()]);
    message
}

fn with_matrix(matrix: &str) -> String {
    message(&format!(r#"[{}, {{"file_path": "b.png", "transform_matrix": {matrix}}}]"#, frame("a.png")))
}

#[test]
fn matrices_that_are_no_poses() {
    let of = |rows: [&str; 4]| format!("[{}]", rows.join(", "));
    let last = "[0, 0, 0, 1]";
    for (matrix, found) in [
        (of(["[2, 0, 0, 0]", "[0, 2, 0, 0]", "[0, 0, 2, 0]", last]), "lengths 2.0000, 2.0000, 2.0000"),
        (of(["[0, 0, 0, 0]", "[0, 0, 0, 0]", "[0, 0, 0, 0]", last]), "determinant 0.0000"),
        (of(["[1, 0, 0, 0]", "[0, 1, 0, 0]", "[0, 0, -1, 0]", last]), "determinant -1.0000"),
        (of(["[1, 0.1, 0, 0]", "[0, 0.995, 0, 0]", "[0, 0, 1, 0]", last]), "lengths 1.0000, 1.0000, 1.0000"),
        (of(["[1, 0, 0, 0]", "[0, 1, 0, 0]", "[0, 0, 1, 0]", "[0, 0, 0, 2]"]), "0 0 0 2 as its last row"),
        (of(["[1, 0, 0, 1e16]", "[0, 1, 0, 0]", "[0, 0, 1, 0]", last]), "1e16"),
        (of(["[1, 0, 0, 0]", "[0, 1, 0]", "[0, 0, 1, 0]", last]), "3 numbers"),
        (of(["[1, 0, 0, 0]", "[0, 1, 0, 0, 5]", "[0, 0, 1, 0]", last]), "5 numbers"),
        ("[[1, 0, 0, 0]]".into(), "1 rows"),
        ("null".into(), "missing"),
    ] {
        assert_says(
            &with_matrix(&matrix),
            &["frame 1 (\"b.png\")", "`transform_matrix`", found, "expected", "Correct"],
        );
    }
}

#[test]
fn values_of_another_type() {
    let row = |second: &str| format!("[[1, 0, 0, 0], {second}, [0, 0, 1, 0]]");
    for (matrix, place, found, expected) in [
        (row("[0, \"x\", 0, 0]"), "[1][1]", "string", "a number"),
        (row("[0, null, 0, 0]"), "[1][1]", "null", "a number"),
        (row("7"), "[1]", "integer `7`", "a sequence"),
        ("5".into(), "", "integer `5`", "a sequence"),
        ("{\"a\": [1]}".into(), "", "map", "a sequence"),
    ] {
        let place = format!("frames[1].transform_matrix{place} on line 1, column ");
        assert_says(&with_matrix(&matrix), &[&place, found, expected, "Correct"]);
    }
    let lens = |field: &str| message_of(&format!(r#"{{{field}, "frames": [{}]}}"#, frame("a.png")));
    assert_says(&lens(r#""fl_x": true"#), &["fl_x on line 1", "boolean `true`", "a number"]);
    assert_says(&lens(r#""camera_model": 5"#), &["camera_model on line 1", "integer `5`", "a string"]);
    assert_says(&lens(r#""is_fisheye": 1"#), &["is_fisheye on line 1", "integer `1`", "a boolean"]);
    assert_says(&lens(r#""train_filenames": [3]"#), &["train_filenames[0] on line 1", "integer `3`", "a string"]);
}

#[test]
fn numbers_that_json_does_not_have() {
    // Python writes these.
    for number in ["NaN", "-Infinity", "1e999"] {
        let matrix = format!("[[1, 0, 0, {number}], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]");
        let place = ["frames[1].transform_matrix[0]", " on line 1, column ", "finite", "Correct"];
        assert_says(&with_matrix(&matrix), &place);
    }
    // Names in the file are shown without their control characters.
    assert_says(&message_of("{\"\\u0000\": NaN}"), &["\\0 on line 1", "finite"]);
    let long = "n".repeat(4_000);
    assert!(message_of(&format!("{{\"{long}\": NaN}}")).len() < 1_000);
}

#[test]
fn paths_that_lead_nowhere() {
    let pose = format!(r#""transform_matrix": {LOOKING_BACK}"#);
    assert_says(&message(&format!("[{{{pose}}}]")), &["frame 0", "`file_path` is missing"]);
    assert_says(
        &message(&format!(r#"[{{"file_path": 5, {pose}}}]"#)),
        &["frames[0].file_path on line 1", "integer `5`", "a string"],
    );
    let long = "x/".repeat(201);
    for path in ["../a.png", "..\\\\a.png", "C:\\\\a.png", "/etc/a.png", "", ".", "a\\u0000.png", "a\\n.png", &long] {
        assert_says(
            &message(&format!(r#"[{{"file_path": "{path}", {pose}}}]"#)),
            &["frame 0", "`file_path`", "neither absolute"],
        );
    }
    let mask = format!(r#"[{{"file_path": "a.png", "mask_path": "../m.png", {pose}}}]"#);
    assert_says(&message(&mask), &["frame 0 (\"a.png\")", "`mask_path`", "../m.png"]);
    let twice = format!("[{}, {}]", frame("a/b.png"), frame("./a/./b.png"));
    assert_says(&message(&twice), &["frame 1", "`file_path` is \"a/b.png\" again"]);
    let points = message_of(&format!(
        r#"{{"ply_file_path": "/p.ply", "w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#,
        frame("a.png")
    ));
    assert_says(&points, &["the file as a whole", "`ply_file_path`"]);
}

#[test]
fn pictures_that_are_not_there() {
    let text = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame("train/r_0"));
    let message = single(&text).unwrap_err().to_string();
    assert_says(
        &message,
        &["1 of 1 photographs", "transforms.json", "train/r_0:", "holds \"transforms.json\"", "Put the photographs"],
    );
    let message = single(&format!(r#"{{"fl_x": 8, "frames": [{}]}}"#, frame("a.png"))).unwrap_err().to_string();
    assert_says(&message, &["1 of 1 photographs", "a.png", "holds \"transforms.json\""]);
    let root =
        folder(&[(SINGLE, &format!(r#"{{"fl_x": 8, "frames": [{}]}}"#, frame("a.png"))), ("a.png", "not a picture")]);
    assert_says(&Capture::load(root.path()).unwrap_err().to_string(), &["cannot decode", "a.png"]);
    let root = folder(&[(
        SINGLE,
        &format!(r#"{{"ply_file_path": "p.ply", "w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame("a.png")),
    )]);
    assert_says(&Capture::load(root.path()).unwrap_err().to_string(), &["cannot read", "p.ply"]);
    fs::write(root.path().join("p.ply"), "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").unwrap();
    assert_says(&Capture::load(root.path()).unwrap_err().to_string(), &["p.ply", "`x`"]);
}

#[test]
fn files_that_are_no_captures() {
    assert_says(&message_of("{\"frames\": [1]}"), &["frames[0] on line 1, column", "integer `1`", "an object"]);
    assert_says(&message_of("{\"frames\": ["), &["line 1, column", "EOF"]);
    assert_says(&message_of("{}"), &["`frames` is missing", "a list of frames"]);
    assert_says(&message_of("{\"frames\": 7}"), &["frames on line 1", "integer `7`", "a sequence"]);
    assert_says(&message_of("{\"frames\": []}"), &["lists no images"]);
    assert_says(&message_of(&"[".repeat(100_000)), &["line 1, column"]);
    let nothing = tempfile::tempdir().unwrap();
    assert_says(&Capture::load(nothing.path()).unwrap_err().to_string(), &["`transforms.json`", "`sparse/0/`"]);
}

#[test]
fn the_same_name_in_both_files_of_a_split() {
    let file = format!(r#"{{"w": 8, "h": 6, "fl_x": 8, "frames": [{}]}}"#, frame("a.png"));
    let root = folder(&[(TRAIN, &file), ("transforms_test.json", &file), ("a.png", "")]);
    let message = Capture::load(root.path()).unwrap_err().to_string();
    assert_says(&message, &["transforms_test.json", "frame 0", "\"a.png\" again"]);
}

#[test]
fn a_file_too_large_is_not_read() {
    let root = folder(&[(SINGLE, "{}")]);
    fs::File::options().write(true).open(root.path().join(SINGLE)).unwrap().set_len(MAX_BYTES + 1).unwrap();
    assert_says(&Capture::load(root.path()).unwrap_err().to_string(), &["cannot read", "268435457 bytes"]);
}
