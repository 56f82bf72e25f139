use std::fs;

use super::*;
use crate::formats::{self, QuantisationError};
use crate::gaussians::testing::random_rows;

fn scene(count: usize, sh_degree: usize) -> SceneFile {
    SceneFile { rows: random_rows(count, sh_degree, 1), ..SceneFile::default() }
}

/// More than two chunks of rows, some of which cannot be rendered and one of which is far away.
fn large() -> SceneFile {
    let mut scene = scene(2 * ROWS_AT_ONCE + 77, 1);
    for row in [0, 1, 70_000, 2 * ROWS_AT_ONCE + 76] {
        scene.rows.means[row][1] = f32::NAN;
    }
    scene.rows.means[99_999] = [3e6, -2e6, 5e5];
    scene
}

#[test]
fn a_stream_writes_the_bytes_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let scene = large();
    formats::write(&path("in.ply"), &scene, Format::Ply).unwrap();
    for (name, format) in [("a.ply", Format::Ply), ("a.spz", Format::Spz)] {
        let written = formats::write(&path("whole"), &scene, format).unwrap();
        let (read, _) = formats::read(&path("whole")).unwrap();
        let from = path("in.ply");
        let mut from = SceneReader::open(&from).unwrap();
        let options = ConvertOptions { antialiased: scene.antialiased, ..ConvertOptions::default() };
        let converted = convert(&mut from, &path(name), format, &options).unwrap();
        assert!(fs::read(path(name)).unwrap() == fs::read(path("whole")).unwrap(), "{name}");
        assert_eq!((converted.left_out, converted.moved), (written.left_out, written.moved), "{name}");
        assert_eq!((converted.count, converted.sh_degree), (read.rows.len(), read.rows.sh_degree), "{name}");
        // PLY holds numbers that are not finite; their differences are not, either.
        if format == Format::Spz {
            assert!(written.left_out == 4 && written.moved == 1);
            assert_eq!(converted.error, QuantisationError::between(&written.rows, &read.rows));
        }
    }
}

#[test]
fn every_format_is_read_in_parts_as_in_one() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(700, 2);
    for format in Format::ALL {
        let path = folder.path().join(format!("a{}", format.extension()));
        formats::write(&path, &scene, format).unwrap();
        let (whole, _) = formats::read(&path).unwrap();
        let mut reader = SceneReader::open(&path).unwrap();
        assert_eq!((reader.format(), reader.size()), (format, (whole.rows.len(), whole.rows.sh_degree)));
        for _ in 0..2 {
            let mut found = GaussianRows { sh_degree: whole.rows.sh_degree, ..GaussianRows::default() };
            loop {
                let part = reader.next_rows(256 + 3).unwrap();
                if part.is_empty() {
                    break;
                }
                (0..part.len()).for_each(|row| found.push(&part, row));
            }
            assert!(found == whole.rows, "{format}");
            reader.rewind().unwrap();
        }
        let about = reader.about().clone();
        assert_eq!(SceneFile { rows: whole.rows, ..about }, reader.read().unwrap(), "{format}");
    }
}

#[test]
fn a_broken_scene_harms_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("in.ply"), folder.path().join("out.ply"));
    fs::write(&to, "precious").unwrap();
    let mut header = Vec::new();
    ply::write_header(&mut header, 2, 0, WorldFrame::default()).unwrap();
    // The second row is text. All are as long as the header promises.
    let text = String::from_utf8(header).unwrap().replace("binary_little_endian", "ascii");
    fs::write(&from, format!("{text}{}\n{}\n", "1 ".repeat(17), "x ".repeat(17))).unwrap();
    for format in [Format::Ply, Format::Spz] {
        let mut reader = SceneReader::open(&from).unwrap();
        let error = convert(&mut reader, &to, format, &ConvertOptions::default()).unwrap_err().to_string();
        assert!(error.contains("in.ply") && error.contains("row 1"), "{error}");
        assert_eq!(fs::read_to_string(&to).unwrap(), "precious");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "a temporary file is left");
    }
}
