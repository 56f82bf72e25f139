//! Inputs with which a reader once failed.

use std::fs;
use std::path::PathBuf;

use splat_model::capture::Capture;
use splat_model::ply;
use splat_model::trainer::TrainConfig;

use super::engine::folder;
use super::seeds;

/// Writes a scene and returns the error message of its reader.
fn refused_scene(name: &str, bytes: &[u8]) -> (PathBuf, String) {
    let folder = folder(name);
    let path = folder.join("scene.ply");
    fs::write(&path, bytes).expect("the folder can be written to");
    let message = ply::read(&path).expect_err("refused").to_string();
    let _ = fs::remove_dir_all(folder);
    (path, message)
}

/// The content of a broken line once went to the terminal unescaped, followed by the state of the parser.
#[test]
fn a_broken_header_is_quoted_without_control_characters() {
    let bytes = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float\x1b[2J\0 x\nend_header\n1\n";
    let (path, message) = refused_scene("regression-header", bytes);
    assert!(message.contains(path.to_str().expect("plain")) && message.contains("Line 4"), "{message}");
    assert!(!message.chars().any(char::is_control), "{message:?}");
    assert!(!message.contains("ParseError") && message.contains("expected"), "{message}");
}

#[test]
fn names_in_a_header_are_quoted_without_control_characters() {
    let list = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int a\x01b\nend_header\n1 1\n";
    let (_, message) = refused_scene("regression-list", list);
    assert!(!message.chars().any(char::is_control), "{message:?}");
}

/// A photograph's name of four thousand letters was once quoted in full.
#[test]
fn a_long_name_is_cut_where_it_is_quoted() {
    let folder = folder("regression-name");
    let model = seeds::model(&folder);
    let images = folder.join("sparse/0/images.bin");
    let at = model.binary[1].windows(6).position(|window| window == b"00.png").expect("the first name");
    for name in ["/".repeat(4_000), "\u{7f}".repeat(4_000) + "/../x", "\u{fffd}".repeat(2_000)] {
        let mut bytes = model.binary[1].clone();
        let bad: Vec<u8> = match name.starts_with('\u{fffd}') {
            true => vec![0xff; 4_000],
            false => name.into_bytes(),
        };
        bytes.splice(at..at + 6, bad);
        fs::write(&images, bytes).expect("the folder can be written to");
        let message = Capture::load(&folder).expect_err("refused").to_string();
        assert!(message.len() < 1_000 && message.contains("`NAME`") && message.contains("bytes"), "{message}");
    }
    let _ = fs::remove_dir_all(folder);
}

/// Such a background once became infinite, was written as `null` and could not be read again.
#[test]
fn a_background_beyond_f32_is_refused() {
    let text = serde_json::to_string(&TrainConfig::default()).expect("plain data");
    let text = text.replace("\"background\":[0.0,0.0,0.0]", "\"background\":[0.0,0.0,1e39]");
    let message = serde_json::from_str::<TrainConfig>(&text).expect_err("refused").to_string();
    assert!(message.contains("out of range"), "{message}");
    // The path that reads the text as f64 first.
    let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let message = serde_json::from_value::<TrainConfig>(value).expect_err("refused").to_string();
    assert!(message.contains("expected three finite f32 numbers"), "{message}");
}
