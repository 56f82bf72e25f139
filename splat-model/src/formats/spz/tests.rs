use std::fs;
use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use half::f16;
use proptest::prelude::*;
use tempfile::TempDir;

use super::pack::{Layout, farthest, fraction, pack};
use super::{GZIP, HEADER, MAGIC};
use crate::formats::testing::{fixture, rows, spoil};
use crate::formats::{
    self, FileError, Format, QuantisationError, SceneFile, SpzOptions, SpzVersion, WriteOptions, Written,
};
use crate::gaussians::GaussianRows;
use crate::ply::TrainedAs;

fn written(rows: &GaussianRows, path: &Path) -> GaussianRows {
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    formats::write(path, &scene, Format::Spz).unwrap().rows.into_owned()
}

fn write_spz<'a>(path: &Path, scene: &'a SceneFile, spz: SpzOptions) -> Result<Written<'a>, FileError> {
    formats::write_with(path, scene, Format::Spz, WriteOptions { spz, ..WriteOptions::default() })
}

/// Writes version 3.
fn written_three(rows: &GaussianRows, path: &Path) -> GaussianRows {
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    let options = SpzOptions { version: SpzVersion::Three, ..SpzOptions::default() };
    write_spz(path, &scene, options).unwrap().rows.into_owned()
}

fn read(path: &Path) -> GaussianRows {
    formats::read(path).unwrap().0.rows
}

/// Additional error of the reference, which rounds harmonics to eight bits before it rounds them to fewer; here they are
/// rounded once.
const TWICE: f32 = 0.5 / 128.0;
const ONCE: f32 = 1e-6;

/// Checks that each error is at most half a step of the quantisation; positions have `fraction` fractional bits.
fn assert_within_bits(written: &GaussianRows, read: &GaussianRows, fraction: i32, more: f32) {
    let loss = QuantisationError::between(written, read);
    let half = 0.5 / 2.0_f64.powi(fraction);
    assert!(loss.position.largest <= half * 3.0_f64.sqrt() + 1e-6 * half.max(1.0), "{loss:?}");
    assert!(loss.scale.largest <= (0.5_f64 / 16.0).exp_m1() + 1e-5, "{loss:?}");
    assert!(loss.opacity.largest <= 0.5 / 255.0 + 1e-6, "{loss:?}");
    assert!(loss.colour.largest <= 0.28209479 * 0.5 / (255.0 * 0.15) + 1e-6, "{loss:?}");
    // Three components are off by half a step of √½ / 511 each, the largest, at least one half, by up to three times that.
    let step = 0.5_f64.sqrt() / 1022.0;
    assert!(loss.rotation.largest <= (2.0 * 12.0_f64.sqrt() * step).to_degrees() * 1.01, "{loss:?}");
    let per_row = written.rest_per_row();
    for (i, (a, b)) in written.sh_rest.iter().zip(&read.sh_rest).enumerate() {
        let half = if i % per_row < 9 { 4.0 / 128.0 } else { 8.0 / 128.0 };
        assert!((a - b).abs() <= half + more, "coefficient {}: {a} became {b}", i % per_row);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn errors_are_within_half_a_step(
        (rows, reach) in (0_usize..=4, 1_usize..60, prop::sample::select(vec![1e-3_f32, 0.4, 1.0, 3.0, 900.0, 2e4]))
            .prop_flat_map(|(degree, count, reach)| (rows(count, degree, reach), Just(reach))),
    ) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("scene.spz");
        let written = written(&rows, &path);
        // 23 bits below the sign, at most 24 of them fractional.
        let fraction = (22 - reach.log2().floor() as i32).min(24);
        assert_within_bits(&written, &read(&path), fraction - 1, ONCE);
    }
}

/// A file with more bits is larger, and each error is at most half a step.
#[test]
fn harmonics_have_the_bits_that_are_asked_for() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.spz");
    let per_row = 45;
    // Without a period, which zstd finds.
    let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) as i32 as f32 / 2.0_f32.powi(31);
    let sh_rest: Vec<f32> = (0..200 * per_row).map(|i| 0.37 * noise(i * i)).collect();
    let rows = GaussianRows {
        means: vec![[1.0, 2.0, 3.0]; 200],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; 200],
        log_scales: vec![[-3.0; 3]; 200],
        logit_opacities: vec![0.0; 200],
        sh_dc: vec![[0.0; 3]; 200],
        sh_rest,
        sh_degree: 3,
        groups: Vec::new(),
    };
    let scene = SceneFile { rows, ..SceneFile::default() };
    let mut bytes = 0;
    for bits in [[3, 2], [5, 4], [6, 6], [8, 8]] {
        write_spz(&path, &scene, SpzOptions { sh_bits: bits, ..SpzOptions::default() }).unwrap();
        let found = read(&path);
        for (i, (a, b)) in scene.rows.sh_rest.iter().zip(&found.sh_rest).enumerate() {
            let half = 2.0_f32.powi(-i32::from(bits[usize::from(i % per_row >= 9)]));
            assert!((a - b).abs() <= half + ONCE, "{bits:?}, coefficient {}: {a} became {b}", i % per_row);
        }
        let size = fs::metadata(&path).unwrap().len();
        assert!(size > bytes, "{bits:?}: {size} bytes after {bytes}");
        bytes = size;
    }
    write_spz(&path, &scene, SpzOptions { version: SpzVersion::Four, sh_bits: [5, 4] }).unwrap();
    let same = fs::read(&path).unwrap();
    written(&scene.rows, &path);
    assert!(same == fs::read(&path).unwrap(), "the reference's version and bits are the default");
}

#[test]
fn the_frame_is_right_up_back() {
    let rows = GaussianRows {
        means: vec![[1.0, 2.0, 3.0]],
        rotations: vec![[0.1, 0.9, 0.2, -0.3]],
        log_scales: vec![[0.0; 3]],
        logit_opacities: vec![0.0],
        sh_dc: vec![[0.0; 3]],
        sh_rest: vec![],
        sh_degree: 0,
        groups: Vec::new(),
    };
    let [positions, _, _, _, rotations, _] = pack(&rows, 8, [5, 4]);
    assert_eq!(positions, [0, 1, 0, 0, 0xfe, 0xff, 0, 0xfd, 0xff]);
    let word = u32::from_le_bytes(rotations.try_into().unwrap());
    // `x` is the largest and is not stored; `y` is negative there, `z` and `w` are not.
    assert_eq!((word >> 30, word >> 29 & 1, word >> 19 & 1, word >> 9 & 1), (0, 1, 0, 0));
}

#[test]
fn what_is_out_of_range_is_taken_to_its_edge() {
    let rows = GaussianRows {
        means: vec![[1e9, -1e9, 0.0]],
        rotations: vec![[0.0, 0.0, 0.0, -2.0]],
        log_scales: vec![[-30.0, 30.0, 0.0]],
        logit_opacities: vec![80.0],
        sh_dc: vec![[40.0, -40.0, 0.0]],
        sh_rest: [3.0, -3.0, 0.0].repeat(3),
        sh_degree: 1,
        groups: Vec::new(),
    };
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.spz");
    written(&rows, &path);
    let read = read(&path);
    assert_eq!(read.means, [[8_388_607.0, -8_388_607.0, 0.0]]);
    assert_eq!(read.log_scales, [[-10.0, 5.9375, 0.0]]);
    // A quaternion and its negative are the same rotation.
    assert_eq!(read.rotations, [[0.0, 0.0, 0.0, -1.0]]);
    assert!((read.sh_dc[0][0] - 10.0 / 3.0).abs() < 1e-5 && (read.sh_dc[0][1] + 10.0 / 3.0).abs() < 1e-5, "{read:?}");
    // The second harmonic, of `z`, changes its sign, so the nearer end of the range changes too.
    assert_eq!(read.sh_rest[..3], [1.0, -127.0 / 128.0, 0.0]);
}

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut stream = GzEncoder::new(Vec::new(), Compression::fast());
    stream.write_all(bytes).unwrap();
    stream.finish().unwrap()
}

fn header(version: u32, count: u32, sh_degree: u8, fraction: u8) -> Vec<u8> {
    let mut bytes = [&MAGIC[..], &version.to_le_bytes(), &count.to_le_bytes()].concat();
    bytes.extend([sh_degree, fraction, 0, 0]);
    bytes
}

/// Files of versions that current writers no longer write.
#[test]
fn versions_one_and_two_are_read() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("old.spz");
    let rest = [128, 0, 64, 192, 160, 160, 160, 255, 128, 0];
    for version in [1, 2] {
        let layout = Layout { version, count: 1, sh_degree: 0, fraction: 8 };
        let position: Vec<u8> = match version {
            1 => [1.5, -2.0, 0.25].map(|x| f16::from_f32(x).to_le_bytes()).concat(),
            _ => vec![0x80, 1, 0, 0, 0xfe, 0xff, 0x40, 0, 0],
        };
        let bytes = [&header(version, 1, 0, 8), &position, &rest[..]].concat();
        assert_eq!(bytes.len() - 16, layout.bytes().iter().sum::<usize>());
        fs::write(&path, gzipped(&bytes)).unwrap();
        let rows = read(&path);
        assert_eq!(rows.means, [[1.5, 2.0, -0.25]], "version {version}");
        assert_eq!(rows.log_scales, [[0.0; 3]]);
        let [w, x, y, z] = rows.rotations[0];
        assert!(
            (w + 0.0).abs() < 0.1 && (x - 1.0).abs() < 1e-6 && y.abs() < 0.01 && (z - 1.0).abs() < 1e-6,
            "{rows:?}"
        );
    }
}

#[test]
fn headers_are_not_believed() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.spz");
    let refuse = |bytes: &[u8], part: &str| {
        fs::write(&path, bytes).unwrap();
        let message = formats::read(&path).unwrap_err().to_string();
        assert!(
            message.contains(part) && message.contains("scene.spz") && message.contains("export it again"),
            "{part}: {message}"
        );
    };
    let gzip = |header: Vec<u8>, part: &str| refuse(&gzipped(&[&header, &[0; 100][..]].concat()), part);
    gzip(header(3, u32::MAX, 3, 12), "4294967295 Gaussians");
    gzip(header(3, 7, 0, 12), "scales: 9 bytes, expected 21");
    gzip(header(3, 1, 5, 12), "degree 5");
    gzip(header(3, 1, 0, 31), "31 bits");
    gzip(header(0, 1, 0, 12), "version 0");
    gzip(header(4, 1, 0, 12), "version 4");
    gzip([&b"PGSN"[..], &header(3, 1, 0, 12)[4..]].concat(), "`PGSN`");
    let four = |count: u32, streams: u8, table: u32, part: &str| {
        let mut bytes = [header(4, count, 0, 12), table.to_le_bytes().to_vec(), vec![0; 200]].concat();
        bytes[15] = streams;
        refuse(&bytes, part);
    };
    four(1, 4, 32, "4 streams");
    four(1, 5, 31, "byte 31");
    four(1, 5, u32::MAX, "byte 4294967295");
    four(1, 5, 141, "byte 141");
    four(1, 5, 32, "positions of 0 bytes");
    four(u32::MAX, 5, 32, "4294967295 Gaussians");
    refuse(b"NGSP\x05\0\0\0", "header");
    refuse(&[header(5, 1, 0, 12), vec![0; 16]].concat(), "version 5");
}

#[test]
fn a_changed_byte_is_found_by_the_checksum() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.spz");
    let rows = crate::init::from_points(&crate::capture::PointCloud {
        positions: (0..50).map(|i| [i as f32, 0.5, -1.0]).collect(),
        colours: vec![[9, 8, 7]; 50],
    });
    written_three(&rows, &path);
    let bytes = fs::read(&path).unwrap();
    assert_eq!(bytes[..2], GZIP);
    let mut spoilt = bytes.clone();
    let last = bytes.len() - 6;
    spoilt[last] ^= 1;
    fs::write(&path, spoilt).unwrap();
    let message = formats::read(&path).unwrap_err().to_string();
    assert!(message.contains("checksum"), "{message}");
}

/// Compares the scene that the crate `spz` reads with the written rows.
fn assert_read(path: &Path, written: &GaussianRows) {
    use spz::{CoordinateSystem, GaussianSplat, UnpackOptions};
    let options = UnpackOptions::builder().to_coord_system(CoordinateSystem::RDF).build();
    let theirs = GaussianSplat::load_packed_from_file(path, &options).unwrap();
    assert_eq!(theirs.num_points as usize, written.len());
    assert_eq!(theirs.spherical_harmonics_degree as usize, written.sh_degree);
    let rows = GaussianRows {
        means: theirs.positions.as_chunks().0.to_vec(),
        rotations: theirs.rotations.as_chunks::<4>().0.iter().map(|&[x, y, z, w]| [w, x, y, z]).collect(),
        log_scales: theirs.scales.as_chunks().0.to_vec(),
        logit_opacities: theirs.alphas.clone(),
        sh_dc: theirs.colors.as_chunks().0.to_vec(),
        sh_rest: theirs.spherical_harmonics.clone(),
        sh_degree: written.sh_degree,
        groups: Vec::new(),
    };
    assert_within_bits(written, &rows, 18, ONCE);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Another project's crate reads our files of version 3, including their bits and frame.
    #[test]
    fn the_crate_spz_reads_our_files(rows in (0_usize..=3).prop_flat_map(|degree| rows(30, degree, 7.0))) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("scene.spz");
        let written = written_three(&rows, &path);
        assert_read(&path, &written);
    }
}

/// `splat-transform`, which uses the reference implementation, wrote these files; the last holds the values after its loss (see
/// `tests/scenes/README.md`).
#[test]
fn files_of_the_reference_are_read_as_it_reads_them() {
    let given = read(&fixture("given.ply"));
    let theirs = read(&fixture("splat-transform.spz.read.ply"));
    for name in ["splat-transform.v3.spz", "splat-transform.v4.spz"] {
        let (scene, format) = formats::read(&fixture(name)).unwrap();
        assert_eq!(format, Format::Spz);
        let loss = QuantisationError::between(&theirs, &scene.rows);
        assert!(
            loss.position.largest < 1e-6 && loss.scale.largest < 1e-5 && loss.colour.largest < 1e-6,
            "{name}: {loss:?}"
        );
        assert!(
            loss.rotation.largest < 1e-3 && loss.opacity.largest < 1e-3 && loss.harmonics.largest < 1e-6,
            "{name}: {loss:?}"
        );
        assert_within_bits(&given, &scene.rows, 12, TWICE);
    }
}

#[test]
fn spoilt_files_of_version_four_are_refused_or_read_and_nothing_else() {
    let bytes = fs::read(fixture("splat-transform.v4.spz")).unwrap();
    let [short, _] = spoil(&bytes, |path| formats::read(path).is_ok());
    assert_eq!(short, 0, "a part of a file was taken for the whole");
}

/// Both versions hold the same bits, and version 4 begins as the reference's does: a plain header, then the table of its streams.
#[test]
fn versions_three_and_four_hold_the_same() {
    let folder = TempDir::new().unwrap();
    let [three, four] = ["3.spz", "4.spz"].map(|name| folder.path().join(name));
    let given = read(&fixture("given.ply"));
    let trained = TrainedAs { antialias: true, ..TrainedAs::default() };
    for sh_degree in [0, 3] {
        let scene = SceneFile { rows: given.clone(), trained, ..SceneFile::default() };
        let scene = SceneFile { rows: formats::fit(&scene.rows, Format::Spz).rows.into_owned(), ..scene };
        let mut rows = GaussianRows { sh_degree, ..GaussianRows::default() };
        (0..scene.rows.len()).for_each(|row| rows.push(&scene.rows, row));
        let scene = SceneFile { rows, ..scene };
        for (path, version) in [(&three, SpzVersion::Three), (&four, SpzVersion::Four)] {
            write_spz(path, &scene, SpzOptions { version, ..SpzOptions::default() }).unwrap();
        }
        assert_eq!(formats::read(&three).unwrap(), formats::read(&four).unwrap());
        assert!(formats::read(&four).unwrap().0.trained.antialias);
        let (ours, theirs) = (fs::read(&four).unwrap(), fs::read(fixture("splat-transform.v4.spz")).unwrap());
        assert_eq!((&ours[..12], &ours[16..HEADER]), (&theirs[..12], &theirs[16..HEADER]));
        assert_eq!(
            ours[12..16],
            [
                sh_degree as u8,
                fraction(farthest(&scene.rows.means)) as u8,
                1,
                if sh_degree == 0 { 5 } else { theirs[15] }
            ]
        );
        // The plain sizes of the table's entries are those of the reference.
        for entry in 0..5 {
            let plain = HEADER + 16 * entry + 8..HEADER + 16 * entry + 16;
            assert_eq!(ours[plain.clone()], theirs[plain]);
        }
    }
}
