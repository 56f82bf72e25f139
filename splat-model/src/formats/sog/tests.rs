use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::Path;

use proptest::prelude::*;
use proptest::strategy::ValueTree;
use serde_json::{Value, json};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use super::META;
use crate::formats::testing::{fixture, rows};
use crate::formats::{self, Format, QuantisationError, SceneFile, SogOptions, WriteOptions};
use crate::gaussians::GaussianRows;

/// Writes with an entry of the palette for each Gaussian.
fn written(rows: &GaussianRows, path: &Path) -> GaussianRows {
    let scene = SceneFile { rows: rows.clone(), ..SceneFile::default() };
    let sog = SogOptions { entries: Some(rows.len().max(1)) };
    let options = WriteOptions { sog, ..WriteOptions::default() };
    formats::write_with(path, &scene, Format::Sog, options).unwrap().rows.into_owned()
}

fn read(path: &Path) -> GaussianRows {
    formats::read(path).unwrap().0.rows
}

/// Checks errors of at most 60 rows within ±`reach` against the steps of the format. The codebooks hold all their scales and colours, and harmonics
/// within ±1 to a hundredth.
fn assert_within_steps(written: &GaussianRows, read: &GaussianRows, reach: f64) {
    let loss = QuantisationError::between(written, read);
    // Half a place of the logarithm, relative to one plus the distance, in three axes.
    let place = 2.0 * reach.ln_1p() / 65_535.0;
    assert!(loss.position.largest <= 0.51 * 3.0_f64.sqrt() * place * (1.0 + reach), "{loss:?}");
    let step = 0.5_f64.sqrt() / 127.5;
    assert!(loss.rotation.largest <= (12.0_f64.sqrt() * step).to_degrees() * 1.01, "{loss:?}");
    assert!(loss.opacity.largest <= 0.5 / 255.0 + 1e-6, "{loss:?}");
    assert!(loss.scale.largest <= 1e-5 && loss.colour.largest <= 1e-5 && loss.harmonics.largest <= 0.02, "{loss:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Up to 64 Gaussians, the codebooks hold all scales and colours.
    #[test]
    fn errors_are_within_half_a_step(
        (rows, reach) in (0_usize..=3, 1_usize..60, prop::sample::select(vec![1e-3_f32, 1.0, 900.0, 2e4]))
            .prop_flat_map(|(degree, count, reach)| (rows(count, degree, reach), Just(reach))),
    ) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("scene.sog");
        let written = written(&rows, &path);
        let mut found = read(&path);
        let kept = written.len();
        prop_assert_eq!(found.len(), kept);
        if kept == 0 {
            found.sh_degree = written.sh_degree;
        }
        assert_within_steps(&written, &found, f64::from(reach));
    }
}

/// `splat-transform` wrote the first file, and read it for the second (see `tests/scenes/README.md`).
#[test]
fn files_of_splat_transform_are_read_as_it_reads_them() {
    let (scene, format) = formats::read(&fixture("splat-transform.sog")).unwrap();
    assert_eq!((format, scene.rows.len(), scene.rows.sh_degree), (Format::Sog, 20, 3));
    let theirs = read(&fixture("splat-transform.sog.read.ply"));
    let loss = QuantisationError::between(&theirs, &scene.rows);
    assert!(loss.position.largest < 1e-6 && loss.scale.largest < 1e-6 && loss.colour.largest < 1e-6, "{loss:?}");
    assert!(loss.rotation.largest < 1e-3 && loss.opacity.largest < 1e-3 && loss.harmonics.largest < 1e-6, "{loss:?}");
}

/// The files of an archive.
fn unpacked(path: &Path) -> Vec<(String, Vec<u8>)> {
    let mut archive = ZipArchive::new(Cursor::new(fs::read(path).unwrap())).unwrap();
    let count = archive.len();
    let file = |index: usize| {
        let mut file = archive.by_index(index).unwrap();
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).unwrap();
        (file.name().unwrap().into_owned(), bytes)
    };
    (0..count).map(file).collect()
}

fn packed(path: &Path, files: &[(String, Vec<u8>)]) {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        archive.start_file(name, SimpleFileOptions::default()).unwrap();
        archive.write_all(bytes).unwrap();
    }
    fs::write(path, archive.finish().unwrap().into_inner()).unwrap();
}

/// The format's document allows the same files side by side, which are not read.
#[test]
fn an_unpacked_scene_is_told_how_to_be_packed() {
    let folder = TempDir::new().unwrap();
    for (name, bytes) in unpacked(&fixture("splat-transform.sog")) {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    let path = folder.path().join(META);
    let message = formats::read(&path).unwrap_err().to_string();
    assert!(message.contains("unpacked SOG scene") && message.contains("zip -0 scene.sog"), "{message}");
}

#[test]
fn the_same_scene_gives_the_same_file() {
    let folder = TempDir::new().unwrap();
    let [first, second] = ["a.sog", "b.sog"].map(|name| folder.path().join(name));
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let scene = rows(3_000, 3, 5.0).new_tree(&mut runner).unwrap().current();
    let kept = written(&scene, &first);
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| written(&scene, &second));
    assert!(fs::read(&first).unwrap() == fs::read(&second).unwrap());
    let loss = QuantisationError::between(&kept, &read(&first));
    assert!(loss.scale.rms < 0.03 && loss.colour.rms < 0.005 && loss.harmonics.rms < 0.01, "{loss:?}");
    // Random harmonics cannot be compressed, and there are fewer entries without an option.
    let scene = SceneFile { rows: scene, ..SceneFile::default() };
    let plain = formats::write(&second, &scene, Format::Sog).unwrap().rows.into_owned();
    let smaller = QuantisationError::between(&plain, &read(&second));
    assert!(smaller.harmonics.rms > 0.1 && smaller.colour == loss.colour, "{smaller:?}");
    assert!(fs::metadata(&second).unwrap().len() < fs::metadata(&first).unwrap().len());
}

/// Gaussians far away take no precision from the colours and scales of the others.
#[test]
fn extremes_cost_others_little() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.sog");
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut scene = rows(500, 0, 1.0).new_tree(&mut runner).unwrap().current();
    scene.log_scales[0] = [-1e30, 60.0, -50.0];
    scene.sh_dc[0] = [1e4, -1e4, 1e6];
    let kept = written(&scene, &path);
    let found = read(&path);
    let odd = kept.sh_dc.iter().position(|dc| dc[0] == 1e4).unwrap();
    for i in (0..500).filter(|i| *i != odd) {
        for axis in 0..3 {
            assert!((kept.log_scales[i][axis] - found.log_scales[i][axis]).abs() < 0.1);
            assert!((kept.sh_dc[i][axis] - found.sh_dc[i][axis]).abs() < 0.05);
        }
    }
}

#[test]
fn what_is_wrong_in_a_document_is_named() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.sog");
    let files = unpacked(&fixture("splat-transform.sog"));
    let change = |change: &dyn Fn(&mut Value)| {
        let mut files = files.clone();
        let meta = &mut files.iter_mut().find(|(name, _)| name == META).unwrap().1;
        let mut document: Value = serde_json::from_slice(meta).unwrap();
        change(&mut document);
        *meta = document.to_string().into_bytes();
        packed(&path, &files);
        formats::read(&path).map(|(scene, _)| scene).map_err(|error| error.to_string())
    };
    let scene = change(&|document| document["extras"] = json!({ "origin": [1e6, 2, 3] })).unwrap();
    assert_eq!(scene.origin.to_array(), [1e6, 2.0, 3.0]);
    assert!(change(&|document| document["extras"] = json!({ "origin": "here" })).is_ok());
    type Change = fn(&mut Value);
    let cases: [(Change, &str); 12] = [
        (|document| document["version"] = json!(3), "version 3, expected 2"),
        (|document| _ = document.as_object_mut().unwrap().remove("version"), "version 1, expected 2"),
        (|document| document["count"] = json!(4_000_000_000_u64), "claims 4000000000 Gaussians"),
        (|document| document["count"] = json!(50), "pixels, expected 50 to"),
        (|document| document["count"] = json!(-1), "`meta.json`: invalid value"),
        (|document| document["scales"]["codebook"] = json!([1.0]), "`scales.codebook` has 1 values, expected 256"),
        (|document| document["shN"]["bands"] = json!(2), "960 pixels wide, expected 512"),
        (|document| document["shN"]["bands"] = json!(9), "`shN.bands` is 9"),
        (|document| document["shN"]["count"] = json!(2), "in a palette of 2 entries"),
        (|document| document["shN"]["count"] = json!(u64::MAX), "pixels, expected 18446744073709551615 to"),
        (|document| document["quats"]["files"] = json!(["none.webp"]), "`none.webp` in its archive"),
        (|document| document["quats"]["files"] = json!(["meta.json"]), "`meta.json`:"),
    ];
    for (spoil, part) in cases {
        let message = change(&|document| spoil(document)).unwrap_err();
        assert!(
            message.contains(part) && message.contains("scene.sog") && message.contains("export it again"),
            "{part}: {message}"
        );
    }
}

/// An archive whose document is longer than any scene's is not unpacked as a whole.
#[test]
fn archives_are_unpacked_within_bounds() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.sog");
    let bomb = [b"{\"version\":2,".to_vec(), vec![b' '; 60_000_000]].concat();
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    archive
        .start_file(META, SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated))
        .unwrap();
    archive.write_all(&bomb).unwrap();
    fs::write(&path, archive.finish().unwrap().into_inner()).unwrap();
    assert!(fs::metadata(&path).unwrap().len() < 100_000);
    let message = formats::read(&path).unwrap_err().to_string();
    assert!(message.contains("`meta.json`"), "{message}");
}
