use std::fs;

use glam::{DMat3, DVec3};

use super::*;
use crate::capture::testing::assert_says;

/// OpenGL axes: at (1, 2, 3), looks along the world's +x with +z up.
const ALONG_X: &str = "[0, 0, -1, 1, -1, 0, 0, 2, 0, 1, 0, 3, 0, 0, 0, 1]";
const UNTURNED: &str = "[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]";

fn read(text: &str) -> Result<Vec<(DAffine3, Option<f64>)>> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("camera_path.json");
    fs::write(&file, text).unwrap();
    read_keyframes(&file)
}

/// The error message for a path whose second camera has these fields.
fn message(fields: &str) -> String {
    let text = format!(r#"{{"camera_path": [{{"camera_to_world": {UNTURNED}}}, {{{fields}}}]}}"#);
    let message = read(&text).unwrap_err().to_string();
    assert_says(&message, &["camera_path.json", "Correct"]);
    message
}

#[test]
fn paths_of_nerfstudio_are_read() {
    // With the keyframes of its old viewer, text by columns.
    let path = read(&format!(
        r#"{{"keyframes": [{{"matrix": "[1,0,0,0,0,1,0,0,0,0,1,0,5,6,7,1]", "fov": 50}}], "camera_type": "perspective",
            "render_height": 1080, "render_width": 1920, "fps": 24, "seconds": 4, "is_cycle": false,
            "camera_path": [{{"camera_to_world": {ALONG_X}, "fov": 40.5, "aspect": 1.7}}, {{"camera_to_world": {UNTURNED}}}]}}"#
    ))
    .unwrap();
    assert_eq!([path[0].1, path[1].1], [Some(40.5), None]);
    let DAffine3 { matrix3: axes, translation } = path[0].0;
    assert!(translation.distance(DVec3::new(1.0, 2.0, 3.0)) < 1e-12, "{translation}");
    // Right, down, forward.
    let expected = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    assert!(axes.abs_diff_eq(expected, 1e-12), "{axes}");
    let back = path[1].0;
    assert!(back.abs_diff_eq(DAffine3::from_scale(DVec3::new(1.0, -1.0, -1.0)), 1e-12), "{back}");
}

#[test]
fn what_is_no_path_is_said() {
    for (fields, parts) in [
        (UNTURNED.replace("[1,", "[2,"), &["frame 1", "`camera_to_world`", "lengths 2.0000"][..]),
        (UNTURNED.replace("[1,", "[-1,"), &["frame 1", "determinant -1.0000"]),
        (UNTURNED.replace("[1, 0, 0, 0", "[1, 0, 0, 1e16"), &["frame 1", "1e16", "finite"]),
        (UNTURNED.replace("[1, 0, 0, 0", "[1, 0, 0, NaN"), &["camera_path[1].camera_to_world", "finite"]),
        (UNTURNED.replace("[1, 0, 0, 0", "[1, 0, 0, 1e999"), &["camera_path[1].camera_to_world", "finite"]),
        (UNTURNED.replace("0, 1]", "0, 2]"), &["frame 1", "0 0 0 2 as its last row"]),
        (UNTURNED.replace(", 1]", "]"), &["camera_path[1].camera_to_world", "invalid length 15", "16"]),
        ("null".into(), &["camera_path[1].camera_to_world", "null"]),
        (format!("{UNTURNED}, \"fov\": 180"), &["frame 1", "`fov` is 180", "0.01 to 179"]),
        (format!("{UNTURNED}, \"fov\": -1"), &["frame 1", "`fov` is -1"]),
    ] {
        assert_says(&message(&format!("\"camera_to_world\": {fields}")), parts);
    }
    assert_says(&message("\"fov\": 50"), &["camera_path[1]", "missing field `camera_to_world`"]);
    let of = |text: &str| read(text).unwrap_err().to_string();
    assert_says(&of("{}"), &["missing field `camera_path`"]);
    assert_says(&of(r#"{"camera_path": []}"#), &["`camera_path` is a list of 0", "at least 2"]);
    let one = format!(r#"{{"camera_path": [{{"camera_to_world": {UNTURNED}}}]}}"#);
    assert_says(&of(&one), &["`camera_path` is a list of 1", "at least 2"]);
    let folder = tempfile::tempdir().unwrap();
    for name in ["none.json", ""] {
        let file = folder.path().join(name);
        assert_says(&read_keyframes(&file).unwrap_err().to_string(), &[file.to_str().unwrap(), "cannot read"]);
    }
}
