//! Plain points: `x y z` and, if present, `red green blue`.

use std::path::Path;

use glam::DVec3;
use ply_rs_bw::ply::{PropertyType, ScalarType};

use super::read::{PlyReader, require, value_error, vertex};
use super::{PlyError, VERTEX};

/// Largest valid coordinate; its square still fits an f32. Larger values indicate damage.
const MAX_COORDINATE: f64 = 1e15;

/// Channel value of a point without a colour.
const GREY: u8 = 127;

const COORDINATES: [&str; 3] = ["x", "y", "z"];
const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// Reads points: positions, and display-referred colours from 0 to 255.
///
/// `x y z` may be of any numeric type. `red green blue` range from 0 to 255, or from 0 to 1 if they are floating-point numbers,
/// and are clamped to that range. Points without colours are grey. All other content of the file is ignored.
///
/// # Errors
///
/// A [`PlyError`] for every file that is not a complete PLY file with such points, or in which a coordinate is not finite or is
/// beyond 1e15. Memory is bounded by a small multiple of the file's true size, whatever its header claims.
pub fn read_points(path: &Path) -> Result<(Vec<DVec3>, Vec<[u8; 3]>), PlyError> {
    let (mut input, header) = PlyReader::open(path)?;
    let vertex = vertex(path, &header)?;
    require(path, vertex, &COORDINATES)?;
    // Floating-point colours range from 0 to 1, all others from 0 to 255.
    let scales = CHANNELS.map(|name| {
        Some(match vertex.properties.get(name)?.data_type {
            PropertyType::Scalar(ScalarType::Float | ScalarType::Double) => 255.0,
            _ => 1.0,
        })
    });
    let coloured = CHANNELS.into_iter().zip(scales).filter_map(|(name, scale)| scale.map(|_| name));
    let names: Vec<&str> = COORDINATES.into_iter().chain(coloured).collect();
    input.begin(&header)?;
    let (mut positions, mut colours) = (Vec::with_capacity(vertex.count), Vec::with_capacity(vertex.count));
    input.each_row(vertex, header.encoding, &names, |row, values| {
        let (position, channels) = values.split_at(3);
        if let Some(axis) = position.iter().position(|value| !(value.abs() <= MAX_COORDINATE)) {
            let (name, value) = (COORDINATES[axis], position[axis]);
            let detail = format!("`{name}` is {value:e}, expected a finite number of at most 1e15");
            return Err(value_error(path, VERTEX, row, &detail));
        }
        positions.push(DVec3::from_slice(position));
        let mut channels = channels.iter();
        // The cast clamps to 0..255 and converts NaN to 0.
        let mut level = |scale: f64| channels.next().map(|value| (value * scale).round() as u8);
        colours.push(scales.map(|scale| scale.and_then(&mut level).unwrap_or(GREY)));
        Ok(())
    })?;
    Ok((positions, colours))
}

#[cfg(test)]
mod tests {
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
            (text("x", "1 inf 2"), ["row 0", "1 inf 2"]),
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
}
