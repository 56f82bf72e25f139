use std::fs;

use glam::{DVec3, Vec3};
use tempfile::TempDir;

use super::*;
use crate::formats::testing::fixture;
use crate::formats::{self, Format, QuantisationError};
use crate::gaussians::GaussianRows;

/// A chunk of discs whose writer kept the logarithm of no thickness.
#[test]
fn an_infinite_end_of_a_range_spoils_nothing_else() {
    let mut ranges = [0.0; 18];
    ranges[6..12].copy_from_slice(&[-3.0, -3.0, f32::NEG_INFINITY, -1.0, -1.0, -1.0]);
    let mut rows = GaussianRows::default();
    for level in [0_u32, 1_000, 2_047] {
        Ranges(ranges).unpack_to(&[0, 0, level, 255], &mut rows);
    }
    let thin = f32::MIN_POSITIVE.ln();
    assert_eq!(rows.log_scales, [[-3.0, -3.0, thin], [-3.0, -3.0, thin], [-3.0, -3.0, -1.0]]);
}

/// Headers and rows written by hand, in which a part is missing or wrong.
#[test]
fn what_is_missing_is_named() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    let chunk: String = RANGES.as_flattened().iter().map(|name| format!("property float {name}\n")).collect();
    let packed: String = PACKED.iter().map(|name| format!("property uint {name}\n")).collect();
    let levels = |count: usize| (0..count).map(|i| format!("property uchar f_rest_{i}\n")).collect::<String>();
    let head = "ply\nformat binary_little_endian 1.0\n";
    let whole =
        format!("{head}element chunk 1\n{chunk}element vertex 1\n{packed}element sh 1\n{}end_header\n", levels(9));
    let read = |header: &str| {
        fs::write(&path, [header.as_bytes(), &[0; 97]].concat()).unwrap();
        formats::read(&path).map(|(scene, _)| scene.rows).map_err(|error| error.to_string())
    };
    assert_eq!(read(&whole).unwrap().len(), 1);
    // Ranges of colours may be missing; the colours then range from 0 to 1.
    let old = whole.lines().filter(|line| !line.ends_with("_r") && !line.ends_with("_g") && !line.ends_with("_b"));
    let old = read(&(old.collect::<Vec<_>>().join("\n") + "\n")).unwrap();
    assert!((old.sh_dc[0][0] + 0.5 / 0.28209479).abs() < 1e-6, "{old:?}");
    let cases = [
        (whole.replace("element chunk 1\n", "element face 1\n"), "`chunk`"),
        (whole.replace("property float max_g\n", ""), "`max_g`"),
        (whole.replace("property uint packed_color\n", ""), "`packed_color`"),
        (whole.replace("property uint packed_scale", "property float packed_scale"), "`packed_scale` of `vertex`"),
        (whole.replace("property uint packed_scale", "property list uchar uint packed_scale"), "`packed_scale`"),
        (whole.replace("property uchar f_rest_3", "property float f_rest_3"), "`f_rest_3` of `sh`"),
        (whole.replace("property uchar f_rest_8\n", ""), "8 properties"),
        (whole.replace("f_rest_8\n", "f_rest_9\n"), "`f_rest_8`"),
        (whole.replace("element sh 1", "element sh 2"), "2 rows of `sh`"),
        (whole.replace("element vertex 1", "element vertex 257"), "257"),
        (whole.replace("element chunk 1", "element chunk 0"), "0 rows of `chunk`"),
        (
            whole.replace("element chunk 1", "element chunk 18446744073709551615"),
            "18446744073709551615 rows of `chunk`",
        ),
    ];
    for (header, part) in cases {
        let message = read(&header).unwrap_err();
        assert!(
            message.contains(part) && message.contains("scene.ply") && message.contains("export"),
            "{part}: {message}"
        );
    }
}

/// `splat-transform` wrote both files from the same PLY; the second holds the values after its loss (see
/// `tests/scenes/README.md`).
#[test]
fn files_of_splat_transform_are_read_as_it_reads_them() {
    let (scene, format) = formats::read(&fixture("splat-transform.compressed.ply")).unwrap();
    let (theirs, plain) = formats::read(&fixture("splat-transform.compressed.read.ply")).unwrap();
    assert_eq!((format, plain), (Format::CompressedPly, Format::Ply));
    assert_eq!((scene.rows.len(), scene.rows.sh_degree, scene.origin), (20, 3, DVec3::ZERO));
    let loss = QuantisationError::between(&theirs.rows, &scene.rows);
    assert!(loss.position.largest < 1e-6 && loss.scale.largest < 1e-5 && loss.colour.largest < 1e-6, "{loss:?}");
    assert!(loss.rotation.largest < 1e-3 && loss.opacity.largest < 1e-3 && loss.harmonics.largest < 1e-6, "{loss:?}");
    // The scene equals the one that they were given, in another order.
    let given = formats::read(&fixture("given.ply")).unwrap().0.rows;
    let mut in_their_order = GaussianRows { sh_degree: 3, ..GaussianRows::default() };
    for mean in &scene.rows.means {
        let distance = |i: &usize| Vec3::from(given.means[*i]).distance_squared(Vec3::from(*mean));
        let nearest = (0..given.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        in_their_order.push(&given, nearest);
    }
    let loss = QuantisationError::between(&in_their_order, &scene.rows);
    // Three components are off by half a step of √2 / 1023 each, the largest, at least one half, by up to three times that.
    let step = 2.0_f64.sqrt() / 2046.0;
    assert!(loss.rotation.largest <= (2.0 * 12.0_f64.sqrt() * step).to_degrees() * 1.01, "{loss:?}");
    // Steps are 1 / 255, and 8 / 256, of which the middle is read.
    assert!(loss.opacity.largest <= 0.5 / 255.0 + 1e-6 && loss.harmonics.largest <= 4.0 / 256.0 + 1e-6, "{loss:?}");
    assert!(loss.position.largest < 0.01 && loss.scale.largest < 0.01 && loss.colour.largest < 0.01, "{loss:?}");
}

#[test]
fn nothing_is_written() {
    let folder = TempDir::new().unwrap();
    let (scene, format) = formats::read(&fixture("splat-transform.compressed.ply")).unwrap();
    let error = formats::write(&folder.path().join("a.compressed.ply"), &scene, format).unwrap_err().to_string();
    assert!(error.contains("a.compressed.ply") && error.contains("SOG"), "{error}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
