use std::fs;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use tempfile::TempDir;

use super::*;
use crate::formats::testing::{fixture, rows};
use crate::formats::{self, Format, QuantisationError, SceneFile};
use crate::gaussians::GaussianRows;

fn round_trip(rows: &GaussianRows) -> (GaussianRows, GaussianRows) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    let written = formats::write(&path, &scene, Format::CompressedPly).unwrap().rows.into_owned();
    (written, formats::read(&path).unwrap().0.rows)
}

/// Checks that each error is at most half a step of the quantisation, plus rounding in f32.
fn assert_within_bits(written: &GaussianRows, read: &GaussianRows) {
    assert_eq!(written.len(), read.len());
    let half = |low: f32, high: f32, bits: u32| {
        let largest = f64::from(low.abs().max(high.abs()));
        0.5 * (f64::from(high) - f64::from(low)) / f64::from((1_u32 << bits) - 1) + 2e-7 * largest
    };
    let near = |a: f32, b: f32, within: f64| {
        assert!((f64::from(a) - f64::from(b)).abs() <= within, "{a} became {b}, more than {within} off");
    };
    for i in 0..written.len() {
        let first = i / CHUNK * CHUNK;
        let Ranges(range) = Ranges::around(written, first..written.len().min(first + CHUNK));
        for axis in 0..3 {
            let bits = [11, 10, 11][axis];
            near(written.means[i][axis], read.means[i][axis], half(range[axis], range[axis + 3], bits));
            near(written.log_scales[i][axis], read.log_scales[i][axis], half(range[axis + 6], range[axis + 9], bits));
            let colour = half(range[axis + 12], range[axis + 15], 8) / 0.28209479 + 1e-6;
            near(written.sh_dc[i][axis], read.sh_dc[i][axis], colour);
        }
    }
    let loss = QuantisationError::between(written, read);
    assert!(loss.opacity.largest <= 0.5 / 255.0 + 1e-6, "{loss:?}");
    // Three components are off by half a step of √2 / 1023 each, the largest, at least one half, by up to three times that.
    let step = 2.0_f64.sqrt() / 2046.0;
    assert!(loss.rotation.largest <= (2.0 * 12.0_f64.sqrt() * step).to_degrees() * 1.01, "{loss:?}");
    // Steps are 8 / 256; the middle of a step is read.
    assert!(loss.harmonics.largest <= 4.0 / 256.0 + 1e-6, "{loss:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn errors_are_within_half_a_step(
        (rows, _) in (0_usize..=3, prop::sample::select(vec![1_usize, 2, 100, 255, 256, 257, 600]))
            .prop_flat_map(|(degree, count)| (rows(count, degree, 50.0), Just(count))),
    ) {
        let (written, read) = round_trip(&rows);
        assert_within_bits(&written, &read);
    }
}

#[test]
fn no_degree_four_and_neighbours_together() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let rows = rows(600, 4, 50.0).new_tree(&mut runner).unwrap().current();
    let (written, read) = round_trip(&rows);
    assert_eq!((written.sh_degree, read.sh_degree), (3, 3));
    assert_within_bits(&written, &read);
    // The first coefficients of a row stay with it.
    let of_first = rows.means.iter().position(|mean| *mean == written.means[0]).unwrap();
    assert_eq!(written.sh_rest[..45], rows.sh_rest[72 * of_first..][..45]);
    let boxes = |rows: &GaussianRows| {
        let Ranges(range) = Ranges::around(rows, 0..CHUNK);
        (0..3).map(|axis| f64::from(range[axis + 3] - range[axis])).product::<f64>()
    };
    assert!(boxes(&written) < 0.75 * boxes(&rows), "{} of {}", boxes(&written), boxes(&rows));
}

#[test]
fn one_place_is_no_reason_to_divide_by_zero() {
    let mut rows = GaussianRows::default();
    let one = GaussianRows {
        means: vec![[1e9, -3.0, 0.0]],
        rotations: vec![[-1.0, 0.0, 0.0, 0.0]],
        log_scales: vec![[-18.0, 0.0, 3.0]],
        logit_opacities: vec![50.0],
        sh_dc: vec![[7.0; 3]],
        ..GaussianRows::default()
    };
    (0..3).for_each(|_| rows.push(&one, 0));
    let (written, read) = round_trip(&rows);
    assert_eq!((read.len(), &read.means, &read.log_scales), (3, &written.means, &written.log_scales));
    assert_within_bits(&written, &read);
}

/// A Gaussian of vanishing size does not reduce the precision of the others.
#[test]
fn sizes_beyond_all_bounds_take_no_bits_from_others() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut rows = rows(50, 0, 1.0).new_tree(&mut runner).unwrap().current();
    rows.log_scales[7] = [-1e30, 80.0, -3e4];
    let (written, read) = round_trip(&rows);
    let odd = written.log_scales.iter().position(|scale| *scale == rows.log_scales[7]).unwrap();
    assert_eq!(read.log_scales[odd], [-20.0, 20.0, -20.0]);
    for i in (0..50).filter(|i| *i != odd) {
        for axis in 0..3 {
            let difference = (read.log_scales[i][axis] - written.log_scales[i][axis]).abs();
            assert!(difference < 0.5 * 40.0 / 1023.0, "{difference}");
        }
    }
}

/// Headers and rows written by hand, in which a part is missing or wrong.
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
    assert_within_bits(&in_their_order, &scene.rows);
}
