use std::fs;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use glam::DVec3;
use tempfile::TempDir;

use super::row::{names, rest_per_channel};
use super::write::write_header;
use super::{WorldFrame, read, write, write_parts, write_to};
use crate::FileError;
use crate::gaussians::GaussianRows;

mod random;

/// Rows whose values all differ, so that tests detect a swap of any two.
fn numbered_rows(count: usize, sh_degree: usize) -> GaussianRows {
    let mut next = 0;
    let mut value = || {
        next += 1;
        next as f32 + 0.25
    };
    let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
    for _ in 0..count {
        rows.means.push([value(), value(), value()]);
        rows.rotations.push([value(), value(), value(), value()]);
        rows.log_scales.push([value(), value(), value()]);
        rows.logit_opacities.push(value());
        rows.sh_dc.push([value(), value(), value()]);
        rows.sh_rest.extend((0..3 * rest_per_channel(sh_degree)).map(|_| value()));
    }
    rows
}

/// Some of a scene's rows.
fn part(rows: &GaussianRows, which: Range<usize>) -> GaussianRows {
    let mut part = GaussianRows { sh_degree: rows.sh_degree, ..GaussianRows::default() };
    which.for_each(|i| part.push(rows, i));
    part
}

#[test]
fn a_scene_in_parts_is_the_file_of_the_whole() {
    let folder = TempDir::new().unwrap();
    let [whole, parts] = ["whole.ply", "parts.ply"].map(|name| folder.path().join(name));
    let rows = numbered_rows(11, 2);
    let origin = DVec3::new(1.0, 2.0, 3.0);
    write(&whole, &rows, origin).unwrap();
    write_parts(&parts, 11, 2, [0..4, 4..4, 4..11].map(|which| part(&rows, which)), origin).unwrap();
    let file = fs::read(&whole).unwrap();
    assert!(fs::read(&parts).unwrap() == file);
    // Other parts than announced, and one that does not fit together, leave the file as it was.
    let mut torn = rows.clone();
    torn.sh_rest.pop();
    for (count, sh_degree, rows) in [(12, 2, &rows), (10, 2, &rows), (11, 1, &rows), (11, 2, &torn)] {
        let error = write_parts(&parts, count, sh_degree, [rows], origin).unwrap_err();
        assert!(error.to_string().contains("could not write"), "{error}");
        assert!(fs::read(&parts).unwrap() == file);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

/// The bits of all values, because `==` on floats does not compare bits.
fn bits(rows: &GaussianRows) -> Vec<u32> {
    let fields: [Vec<f32>; 6] = [
        rows.means.concat(),
        rows.rotations.concat(),
        rows.log_scales.concat(),
        rows.logit_opacities.clone(),
        rows.sh_dc.concat(),
        rows.sh_rest.clone(),
    ];
    fields.concat().into_iter().map(f32::to_bits).collect()
}

fn round_trip(rows: &GaussianRows, origin: DVec3) -> (GaussianRows, DVec3) {
    let folder = TempDir::new().unwrap();
    let (path, mut file) = (folder.path().join("scene.ply"), Vec::new());
    write_to(&mut file, rows, origin).unwrap();
    match write(&path, rows, origin) {
        // No file holds rows alone that cannot be rendered, unless another program wrote it.
        Err(error) if error.to_string().contains("no splat is left") => fs::write(&path, file).unwrap(),
        written => assert!(written.is_ok() && fs::read(&path).unwrap() == file),
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    read(&path).unwrap()
}

fn read_bytes(bytes: &[u8]) -> Result<(GaussianRows, DVec3), FileError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    fs::write(&path, bytes).unwrap();
    read(&path)
}

fn written_bytes(rows: &GaussianRows) -> Vec<u8> {
    let mut file = Vec::new();
    write_to(&mut file, rows, DVec3::ZERO).unwrap();
    file
}

/// The message must name the file and contain every word.
fn assert_refused(bytes: &[u8], words: &[&str]) {
    let message = read_bytes(bytes).expect_err("accepted").to_string();
    assert!(message.contains("scene.ply"), "{message}");
    for word in words {
        assert!(message.contains(word), "`{word}` is not in: {message}");
    }
    assert!(!message.contains('\n'), "{message}");
}

#[test]
fn round_trip_keeps_every_bit_at_every_degree() {
    for degree in 0..=4 {
        let mut rows = numbered_rows(7, degree);
        rows.means[0] = [-0.0, f32::MAX, f32::MIN];
        rows.log_scales[1] = [f32::MIN_POSITIVE, f32::from_bits(1), f32::INFINITY];
        rows.logit_opacities[2] = f32::MIN;
        let origin = DVec3::new(4_512_345.123_456_789, -1e-300, 0.1 + 0.2);
        let (back, back_origin) = round_trip(&rows, origin);
        assert_eq!(bits(&back), bits(&rows));
        assert_eq!(back.sh_degree, degree);
        assert_eq!(back_origin, origin);
    }
}

#[test]
fn an_empty_scene_is_read_and_never_written() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    let mut header = Vec::new();
    write_header(&mut header, 0, 3, &[], WorldFrame::default()).unwrap();
    fs::write(&path, &header).unwrap();
    let empty = GaussianRows { sh_degree: 3, ..GaussianRows::default() };
    assert_eq!(read(&path).unwrap(), (empty.clone(), DVec3::ZERO));
    let mut hidden = numbered_rows(2, 3);
    hidden.means.fill([f32::NAN; 3]);
    for (rows, of) in [(empty, 0), (hidden, 2)] {
        let error = write(&path, &rows, DVec3::ZERO).unwrap_err();
        for part in ["scene.ply", "no splat is left", &format!("{of} of {of} cannot be rendered")] {
            assert!(error.to_string().contains(part), "{error}");
        }
        assert_eq!(fs::read(&path).unwrap(), header);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
}

/// Checks the layout byte by byte against the description of the original code, not against our reader.
#[test]
fn the_layout_is_that_of_the_original_code() {
    let rows = numbered_rows(2, 1);
    let bytes = written_bytes(&rows);
    let header = "ply\nformat binary_little_endian 1.0\ncomment Generated by splat 0.1.0\nelement vertex 2\n";
    let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let text = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(text.starts_with(header), "{text}");
    let properties: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("property float ")).collect();
    let expected = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 f_rest_0 f_rest_1 f_rest_2 f_rest_3 f_rest_4 f_rest_5 f_rest_6 \
                    f_rest_7 f_rest_8 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    assert_eq!(properties, expected.split(' ').collect::<Vec<_>>());

    let second: Vec<f32> =
        bytes[end + 26 * 4..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let rest = &rows.sh_rest[9..];
    let red_green_blue = [0, 3, 6, 1, 4, 7, 2, 5, 8].map(|i| rest[i]);
    let fields: [&[f32]; 7] = [
        &rows.means[1],
        &[0.0; 3],
        &rows.sh_dc[1],
        &red_green_blue,
        &[rows.logit_opacities[1]],
        &rows.log_scales[1],
        &rows.rotations[1],
    ];
    assert_eq!(second, fields.concat());
}

/// A file with one Gaussian, its properties as (type, name, value).
fn file(format: &str, properties: &[(&str, &str, f64)], before: (&str, &[u8])) -> Vec<u8> {
    let mut bytes = format!("ply\r\nformat {format} 1.0\r\ncomment caf?\n{}element vertex 1\n", before.0).into_bytes();
    // Comments of old programs are not always UTF-8.
    bytes.iter_mut().filter(|byte| **byte == b'?').for_each(|byte| *byte = 0xe9);
    for (kind, name, _) in properties {
        bytes.extend(format!("property {kind} {name}\n").as_bytes());
    }
    bytes.extend(b"element after 1\nproperty list uchar int ids\nend_header\n");
    bytes.extend(before.1);
    for &(kind, _, value) in properties {
        match (format, kind) {
            ("ascii", _) => bytes.extend(format!("{value} ").as_bytes()),
            ("binary_big_endian", "double") => bytes.extend(value.to_be_bytes()),
            ("binary_big_endian", "short") => bytes.extend((value as i16).to_be_bytes()),
            ("binary_big_endian", _) => bytes.extend((value as f32).to_be_bytes()),
            (_, "double") => bytes.extend(value.to_le_bytes()),
            (_, "short") => bytes.extend((value as i16).to_le_bytes()),
            (_, _) => bytes.extend((value as f32).to_le_bytes()),
        }
    }
    bytes
}

#[test]
fn any_encoding_order_and_type_is_read() {
    let properties = [
        ("float", "rot_3", 4.0),
        ("double", "x", 0.1),
        ("short", "z", -3.0),
        ("float", "temperature", 99.0),
        ("float", "rot_0", 1.0),
        ("float", "rot_1", 2.0),
        ("float", "rot_2", 3.0),
        ("short", "y", 2.0),
        ("float", "opacity", 0.5),
        ("float", "scale_2", -3.0),
        ("float", "scale_1", -2.0),
        ("float", "scale_0", -1.0),
        ("float", "f_dc_2", 7.0),
        ("float", "f_dc_1", 6.0),
        ("float", "f_dc_0", 5.0),
    ];
    let before = "element list 2\nproperty list uchar short ids\nelement nothing 3\n";
    let payloads: [(&str, &[u8]); 3] = [
        ("ascii", b"2 10 11\n0\n\n\n\n"),
        ("binary_little_endian", &[2, 10, 0, 11, 0, 0]),
        ("binary_big_endian", &[2, 0, 10, 0, 11, 0]),
    ];
    let expected = GaussianRows {
        means: vec![[0.1, 2.0, -3.0]],
        rotations: vec![[1.0, 2.0, 3.0, 4.0]],
        log_scales: vec![[-1.0, -2.0, -3.0]],
        logit_opacities: vec![0.5],
        sh_dc: vec![[5.0, 6.0, 7.0]],
        sh_rest: vec![],
        sh_degree: 0,
        groups: vec![super::groups_tests::group("temperature", 1, &[99.0])],
    };
    for (format, payload) in payloads {
        let (rows, origin) = read_bytes(&file(format, &properties, (before, payload))).unwrap();
        assert_eq!(rows, expected, "{format}");
        assert_eq!(origin, DVec3::ZERO);
    }
}

fn header(rows: usize, properties: &[String]) -> String {
    let lines: String = properties.iter().map(|name| format!("property float {name}\n")).collect();
    format!("ply\nformat binary_little_endian 1.0\nelement vertex {rows}\n{lines}end_header\n")
}

#[test]
fn a_file_that_is_no_ply_is_refused() {
    assert_refused(b"\x89PNG\r\n\x1a\n", &["not a PLY file", "PNG", "`ply`", "pass a .ply"]);
    assert_refused(b"", &["not a PLY file"]);
    assert!(read_bytes(&[b'x'; 100_000]).unwrap_err().to_string().len() < 300, "the file is not quoted whole");
    assert_refused(b"ply\nformat ascii 1.0\n", &["end_header", "export"]);
    assert_refused(b"ply\nformat ascii 7\nend_header\n", &["broken PLY header", "format ascii 7", "export"]);
    assert_refused(b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", &["`vertex`", "`face`", "export"]);
}

#[test]
fn a_header_without_an_end_is_not_read_to_the_end_of_the_file() {
    let mut bytes = b"ply\n".to_vec();
    bytes.resize(3 << 20, b'x');
    assert_refused(&bytes, &["end_header", "1048576 bytes"]);
}

#[test]
fn missing_and_surplus_properties_are_named() {
    let without = |name: &str| header(0, &names(1).into_iter().filter(|n| n != name).collect::<Vec<_>>());
    assert_refused(without("rot_2").as_bytes(), &["`rot_2`", "found `x` `y`", "export"]);
    assert_refused(without("f_rest_8").as_bytes(), &["8 properties `f_rest_*`", "0, 9, 24, 45 or 72", "export"]);
    let renamed: Vec<String> = names(1).into_iter().map(|n| n.replace("f_rest_4", "f_rest_04")).collect();
    assert_refused(header(0, &renamed).as_bytes(), &["`f_rest_4`", "`f_rest_04`", "export"]);
    let twice = header(0, &[names(0), vec!["x".into()]].concat());
    assert_refused(twice.as_bytes(), &["same name", "export"]);
    let list = header(0, &names(0)).replace("property float opacity", "property list uchar float opacity");
    assert_refused(list.as_bytes(), &["`opacity`", "list", "scalars"]);
    let text = header(0, &names(0)).replace("property float opacity", "property string opacity");
    assert_refused(text.as_bytes(), &["property string opacity", "export"]);
    assert!(read_bytes(without("nx").as_bytes()).is_ok());
}

#[test]
fn a_header_that_claims_too_much_reserves_nothing() {
    for rows in [1, 1 << 40, usize::MAX] {
        let claims = header(rows, &names(3));
        assert_refused(claims.as_bytes(), &[&format!("{rows} rows"), "0 bytes follow", "copy or export"]);
    }
    let ascii = header(10_000_000_000, &names(3)).replace("binary_little_endian", "ascii");
    assert_refused(ascii.as_bytes(), &["10000000000 rows", "copy or export"]);
    let many_empty =
        header(0, &names(0)).replace("element vertex", &format!("element nothing {}\nelement vertex", usize::MAX));
    assert!(read_bytes(many_empty.as_bytes()).is_ok(), "rows without properties take no space and no time");
}

#[test]
fn a_truncated_file_is_refused() {
    let bytes = written_bytes(&numbered_rows(3, 2));
    assert_refused(&bytes[..bytes.len() - 1], &["3 rows", "truncated", "copy or export"]);
    let lines = format!("{}{}", header(2, &names(0)).replace("binary_little_endian", "ascii"), "1.000000 ".repeat(17));
    assert_refused(lines.as_bytes(), &["row 1 of `vertex`", "2 rows", "truncated", "copy or export"]);
}

#[test]
fn an_ascii_row_that_is_no_row_of_numbers_is_refused() {
    let head = header(1, &names(0)).replace("binary_little_endian", "ascii");
    let row = "1 ".repeat(16);
    assert_refused(format!("{head}{row}apple\n").as_bytes(), &["row 0 of `vertex`", "apple", "correct"]);
    assert_refused(format!("{head}{row}1 1\n").as_bytes(), &["row 0", "18 values, expected 17", "correct"]);
    assert_refused(&[head.as_bytes(), &[0xff; 64]].concat(), &["row 0", "correct"]);
}

#[test]
fn comments_without_their_numbers_are_refused() {
    let origins = ["1 2", "1 2 x", "1 2 inf", "1 2 3 4"].map(|bad| ("splat origin", bad, "three finite numbers"));
    let sizes = ["0", "-1", "nan", "one", "1 2"].map(|bad| ("splat metres per unit", bad, "a positive number"));
    for (comment, bad, expected) in origins.into_iter().chain(sizes) {
        let text = header(0, &names(0)).replace("element", &format!("comment {comment} {bad}\nelement"));
        assert_refused(text.as_bytes(), &[comment, bad, expected, "remove"]);
    }
}

#[test]
fn files_that_cannot_be_opened_or_written_are_named() {
    let folder = TempDir::new().unwrap();
    let missing = &folder.path().join("missing").join("scene.ply");
    for message in [
        read(missing).unwrap_err().to_string(),
        write(missing, &numbered_rows(1, 0), DVec3::ZERO).unwrap_err().to_string(),
        read(Path::new("/")).unwrap_err().to_string(),
    ] {
        assert!(message.starts_with('/') && message.contains("could not"), "{message}");
    }
}

#[test]
fn rows_that_do_not_belong_together_are_not_written() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    type Spoil = fn(&mut GaussianRows);
    let spoils: [(&str, Spoil); 6] = [
        ("rotations", |rows| rows.rotations.truncate(2)),
        ("log_scales", |rows| rows.log_scales.truncate(2)),
        ("logit_opacities", |rows| rows.logit_opacities.push(0.0)),
        ("sh_dc", |rows| rows.sh_dc.truncate(2)),
        ("sh_rest", |rows| rows.sh_rest.truncate(2)),
        ("sh_degree", |rows| rows.sh_degree = 5),
    ];
    for (field, spoil) in spoils {
        let mut rows = numbered_rows(3, 2);
        spoil(&mut rows);
        let message = write(&path, &rows, DVec3::ZERO).unwrap_err().to_string();
        assert!(message.contains("scene.ply") && message.contains(field), "{message}");
    }
    let message = write(&path, &numbered_rows(1, 0), DVec3::NAN).unwrap_err().to_string();
    assert!(message.contains("origin"), "{message}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_failed_write_leaves_the_old_file_and_nothing_else() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    // The rename at the end must fail, because a folder has that name.
    fs::create_dir(&path).unwrap();
    let error = write(&path, &numbered_rows(2, 0), DVec3::ZERO).unwrap_err().to_string();
    assert!(error.contains("could not write"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// The limit is 5 s each way in release builds; run with `--ignored --nocapture` to see the times.
#[test]
#[ignore = "writes 248 MB"]
fn a_million_splats_load_and_save_in_seconds() {
    let rows = numbered_rows(1_000_000, 3);
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    let start = Instant::now();
    write(&path, &rows, DVec3::ZERO).unwrap();
    let saved = start.elapsed();
    let start = Instant::now();
    let (back, _) = read(&path).unwrap();
    let loaded = start.elapsed();
    println!("1,000,000 splats of degree 3: saved in {saved:.2?}, loaded in {loaded:.2?}");
    assert!(back == rows);
    assert!(saved.as_secs_f64() < 5.0 && loaded.as_secs_f64() < 5.0);
}
