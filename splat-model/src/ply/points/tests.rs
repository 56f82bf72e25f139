use std::fs;

use super::*;

fn read(bytes: &[u8]) -> Result<(Vec<DVec3>, Vec<[u8; 3]>), String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.ply");
    fs::write(&path, bytes).unwrap();
    read_points(&path).map_err(|error| error.to_string())
}

#[test]
fn points_and_colours_of_any_type_are_read() {
    let binary = |kind: &str, colours: &[[u8; 4]; 3]| {
        let mut bytes = format!(
            "ply\nformat binary_little_endian 1.0\nelement camera 1\nproperty list uchar int i\nelement vertex 1\n\
                 property double z\nproperty float nx\nproperty float x\nproperty short y\nproperty {kind} red\n\
                 property {kind} blue\nproperty {kind} green\nelement face 7\nproperty int a\nend_header\n"
        )
        .into_bytes();
        bytes.extend([1, 9, 9, 9, 9]);
        bytes.extend(0.1_f64.to_le_bytes());
        bytes.extend([5.0_f32, -2.5].iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend((-7_i16).to_le_bytes());
        let size = if kind == "uchar" { 1 } else { 4 };
        colours.iter().for_each(|colour| bytes.extend(&colour[..size]));
        bytes
    };
    let expected = (vec![DVec3::new(-2.5, -7.0, 0.1)], vec![[255, 3, 128]]);
    assert_eq!(read(&binary("uchar", &[[255; 4], [128; 4], [3; 4]])).unwrap(), expected);
    let unit = [1.7_f32, 128.0 / 255.0, 3.2 / 255.0].map(f32::to_le_bytes);
    assert_eq!(read(&binary("float", &unit)).unwrap(), expected, "0 to 1, and clipped at 1");
}

#[test]
fn colours_of_other_names_and_ranges_are_read() {
    let read = |names: [&str; 3], kind: &str, rows: &[&str]| {
        let properties: String = names.iter().map(|name| format!("property {kind} {name}\n")).collect();
        let rows: String = rows.iter().map(|row| format!("0 0 0 {row}\n")).collect();
        let count = rows.lines().count();
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n{properties}end_header\n{rows}"
        );
        read(text.as_bytes()).unwrap().1
    };
    let expected = [[255, 51, 0], [0, 128, 10]];
    for names in CHANNELS.iter().take(5) {
        assert_eq!(read(*names, "uchar", &["255 51 0", "0 128 10"]), expected, "{names:?}");
        assert_eq!(read(*names, "float", &["1 0.2 0", "0 0.5 0.04"]), expected, "{names:?}");
        assert_eq!(read(*names, "double", &["255 51 0", "0 128 10"]), expected, "{names:?}");
        assert_eq!(read(*names, "ushort", &["65535 13107 0", "0 32896 2570"]), expected, "{names:?}");
    }
    // (c / 255 − 0.5) / 0.28209.
    assert_eq!(read(CHANNELS[5], "float", &["1.7725 -1.0635 -1.7725"])[0], expected[0]);
    // One row beyond the range of two hundred.
    let mut rows = vec!["1 0.2 0"; 200];
    rows[7] = "9000 0 0";
    let wild = read(CHANNELS[0], "float", &rows);
    assert_eq!((wild[0], wild[7]), ([255, 51, 0], [255, 0, 0]));
}

#[test]
fn points_without_colours_are_grey() {
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                    end_header\n1 2 3\n4 5 6\n";
    let (positions, colours) = read(text.as_bytes()).unwrap();
    assert_eq!(positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
    assert_eq!(colours, [[127; 3]; 2]);
}

#[test]
fn what_no_point_can_have_is_refused() {
    let text = |axis: &str, row: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float {axis}\nproperty float y\nproperty float z\n\
                 end_header\n{row}\n"
        )
    };
    for (text, parts) in [
        (text("x", "1 inf 2"), ["row 0", "`y` is inf"]),
        (text("x", "1 2 -1e16"), ["row 0", "`z` is -1"]),
        (text("x", "1.25 2.25"), ["row 0", "2 values"]),
        (text("u", "1 2 3"), ["`x`", "`u` `y` `z`"]),
        (text("x", "1 2 3").replace("vertex 1", "vertex 400000000000"), ["400000000000 rows", "truncated"]),
        (text("x", "1 2 3").replace("property float z", "property list uchar int z"), ["`z`", "is a list"]),
    ] {
        let message = read(text.as_bytes()).unwrap_err();
        assert!(parts.iter().all(|part| message.contains(part)) && message.contains("points.ply"), "{message}");
    }
}
