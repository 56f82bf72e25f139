use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use tempfile::TempDir;

use super::testing::{fixture, rows, spoil};
use super::*;

/// The formats that are both written and read.
const BOTH: [Format; 3] = [Format::Ply, Format::Spz, Format::Sog];

fn one() -> GaussianRows {
    GaussianRows {
        means: vec![[0.5, -1.0, 2.0]],
        rotations: vec![[0.9, 0.1, -0.3, 0.2]],
        log_scales: vec![[-3.0, -4.0, -2.0]],
        logit_opacities: vec![1.0],
        sh_dc: vec![[0.3, -0.2, 1.0]],
        sh_rest: vec![],
        sh_degree: 0,
        groups: Vec::new(),
    }
}

fn scene(rows: GaussianRows) -> SceneFile {
    SceneFile { rows, ..SceneFile::default() }
}

fn folder_and_file(format: Format) -> (TempDir, PathBuf) {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join(format!("scene{}", format.extension()));
    (folder, path)
}

#[test]
fn names_tell_formats() {
    let of = |name: &str| Format::of_name(Path::new(name));
    assert_eq!(of("a/scene.ply"), Some(Format::Ply));
    assert_eq!(of("SCENE.COMPRESSED.PLY"), Some(Format::CompressedPly));
    assert_eq!(of("scene.spz"), Some(Format::Spz));
    assert_eq!((of("a.GLB"), of("a.gltf"), of("a.sog")), (Some(Format::Glb), None, Some(Format::Sog)));
    // The extension alone is not a name.
    assert_eq!(of(".ply"), None);
    assert_eq!((of("scene"), of("scene.splat"), of("a.ply/"), of("..")), (None, None, Some(Format::Ply), None));
}

#[test]
fn contents_tell_formats_whatever_the_name() {
    for format in BOTH {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("scene.bin");
        let scene = scene(one());
        write(&path, &scene, format).unwrap();
        let (read, found) = read(&path).unwrap();
        assert_eq!((found, read.rows.len()), (format, 1));
    }
}

#[test]
fn gltf_is_written_and_the_way_back_is_named() {
    let (_folder, path) = folder_and_file(Format::Glb);
    write(&path, &scene(one()), Format::Glb).unwrap();
    let text = path.with_extension("gltf");
    fs::write(&text, "{\"asset\": {}}").unwrap();
    for path in [path, text] {
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("scene.gl") && message.contains("splat-transform"), "{message}");
    }
}

#[test]
fn what_is_no_scene_is_told_what_is_one() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("scene.ply");
    for content in [&b""[..], b"{\"a\": 1}", b"\x89PNG", b"\x1b[31mply"] {
        fs::write(&path, content).unwrap();
        let message = read(&path).unwrap_err().to_string();
        for part in ["scene.ply", "PLY", "SPZ", "compressed", "export"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        assert!(!message.contains(char::is_control), "{message:?}");
    }
    let message = read(&folder.path().join("none.spz")).unwrap_err().to_string();
    assert!(message.contains("none.spz") && message.contains("is the path right"), "{message}");
    assert!(read(folder.path()).is_err());
}

#[test]
fn a_scene_without_splats_replaces_no_file() {
    let folder = TempDir::new().unwrap();
    let mut unusable = one();
    unusable.push(&one(), 0);
    unusable.rotations.fill([0.0; 4]);
    for format in Format::WRITTEN {
        let to = folder.path().join(format!("precious{}", format.extension()));
        fs::write(&to, "precious").unwrap();
        let refused = |of: usize, error: FileError| {
            let said = format!("no splat is left, {of} of {of} cannot be rendered");
            assert!(error.to_string().contains(&said), "{error}");
            assert!(error.to_string().contains(to.to_str().unwrap()), "{error}");
            assert_eq!(fs::read_to_string(&to).unwrap(), "precious", "{format}");
        };
        for sh_degree in [0, 3] {
            let empty = scene(GaussianRows { sh_degree, ..GaussianRows::default() });
            refused(0, write(&to, &empty, format).unwrap_err());
        }
        refused(2, write(&to, &scene(unusable.clone()), format).unwrap_err());
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), Format::WRITTEN.len(), "a temporary file is left");
}

#[test]
fn what_cannot_be_rendered_is_left_out_where_it_would_be_drawn_after_all() {
    let mut rows = one();
    rows.push(&one(), 0);
    rows.push(&one(), 0);
    rows.means[0][1] = f32::NAN;
    rows.rotations[1] = [0.0; 4];
    let scene = scene(rows);
    for format in BOTH {
        let (_folder, path) = folder_and_file(format);
        let written = write(&path, &scene, format).unwrap();
        let read = read(&path).unwrap().0.rows;
        let expected = if format == Format::Ply { (0, 3, 2) } else { (2, 1, 0) };
        assert_eq!((written.left_out, read.len(), read.unusable()), expected, "{format}");
    }
}

#[test]
fn origins_stay_where_there_is_a_place_for_them() {
    let scene = SceneFile { origin: DVec3::new(4e6, -2.5, 0.125), ..scene(one()) };
    for format in BOTH {
        let (_folder, path) = folder_and_file(format);
        write(&path, &scene, format).unwrap();
        let expected = if format.holds_origin() { scene.origin } else { DVec3::ZERO };
        assert_eq!(read(&path).unwrap().0.origin, expected, "{format}");
    }
}

#[test]
fn the_size_of_a_unit_stays_where_there_is_a_place_for_it() {
    let scene = SceneFile { metres_per_unit: Some(0.1 + 0.2), ..scene(one()) };
    for format in BOTH {
        let (_folder, path) = folder_and_file(format);
        write(&path, &scene, format).unwrap();
        assert_eq!(
            read(&path).unwrap().0.metres_per_unit,
            scene.metres_per_unit.filter(|_| format.holds_origin()),
            "{format}"
        );
        for metres in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let scene = SceneFile { metres_per_unit: Some(metres), ..scene.clone() };
            let message = write(&path, &scene, format).unwrap_err().to_string();
            assert!(message.contains("metres_per_unit") && message.contains("positive"), "{message}");
        }
    }
}

#[test]
fn a_file_says_how_its_scene_was_trained() {
    let trained = TrainedAs { ray_max: true, background: [1.0, 0.1, 0.0], environment: true, ..TrainedAs::default() };
    let scene = SceneFile { trained: TrainedAs { antialias: true, ..trained }, ..scene(one()) };
    for format in BOTH {
        let (_folder, path) = folder_and_file(format);
        write(&path, &scene, format).unwrap();
        let found = read(&path).unwrap().0;
        assert!(found.trained.antialias, "{format}");
        let expected = if format == Format::Spz { TrainedAs::default() } else { trained };
        assert_eq!(TrainedAs { antialias: false, ..found.trained }, expected, "{format}");
    }
}

/// The first and last of 256 levels have no finite logit of their own.
#[test]
fn opacities_of_zero_and_one_stay_finite() {
    for level in 0..=u8::MAX {
        let logit = opacity::logit(level);
        assert!(logit.is_finite());
        assert_eq!(opacity::level(logit), level);
        let opacity = 255.0 * crate::gaussians::sigmoid(logit);
        assert!((opacity - f64::from(level)).abs() < 0.2501, "{level}: {opacity}");
    }
    assert_eq!([-1e30, 1e30].map(opacity::level), [0, 255]);
}

/// Converters write the infinite logits of opacities 0 and 1, and the logarithm of a disc's thickness.
#[test]
fn limits_of_opacity_and_thickness_are_kept_by_every_format() {
    let (_folder, given) = folder_and_file(Format::Ply);
    let mut rows = GaussianRows::default();
    // The last is an ordinary one: a scene that cannot be rendered at all is not written.
    (0..6).for_each(|_| rows.push(&one(), 0));
    rows.logit_opacities = vec![f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 1.0, 1.0, 1.0];
    rows.log_scales[3][2] = f32::NEG_INFINITY;
    rows.log_scales[4] = [f32::INFINITY, -1.0, -1.0];
    write(&given, &scene(rows), Format::Ply).unwrap();
    let read_back = read(&given).unwrap().0;
    let usable = [true, true, false, true, false, true];
    assert_eq!([0, 1, 2, 3, 4, 5].map(|row| read_back.rows.is_usable(row)), usable);
    let opacities =
        |rows: &GaussianRows| rows.logit_opacities.iter().map(|&l| crate::gaussians::sigmoid(l)).collect::<Vec<_>>();
    for format in BOTH {
        let (_folder, path) = folder_and_file(format);
        write(&path, &read_back, format).unwrap();
        let found = read(&path).unwrap().0.rows;
        let usable: Vec<usize> = (0..found.len()).filter(|&row| found.is_usable(row)).collect();
        assert!(usable.len() >= 4, "{format}: {usable:?}");
        let found_opacities = opacities(&found);
        let within = if format.is_exact() { 1e-7 } else { 1.0 / 255.0 };
        let shows = |wanted: f64| usable.iter().any(|&row| (found_opacities[row] - wanted).abs() <= within);
        assert!(shows(1.0) && shows(0.0), "{format}: {found_opacities:?}");
        // The thinnest that the format holds: e⁻¹⁰ in SPZ.
        assert!(usable.iter().any(|&row| found.log_scales[row][2] <= -10.0), "{format}: {:?}", found.log_scales);
    }
}

#[test]
fn rows_that_do_not_fit_together_are_refused_and_nothing_is_written() {
    for format in Format::WRITTEN {
        let (folder, path) = folder_and_file(format);
        let mut rows = one();
        rows.logit_opacities.clear();
        let message = write(&path, &scene(rows), format).unwrap_err().to_string();
        assert!(message.contains("logit_opacities"), "{message}");
        let far = SceneFile { origin: DVec3::NAN, ..scene(one()) };
        assert!(write(&path, &far, format).is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

#[test]
fn a_failed_write_leaves_the_old_file_and_nothing_else() {
    for format in Format::WRITTEN {
        let (folder, path) = folder_and_file(format);
        // The rename at the end must fail, because a folder has that name.
        fs::create_dir(&path).unwrap();
        let message = write(&path, &scene(one()), format).unwrap_err().to_string();
        assert!(message.contains("scene."), "{message}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// A second round trip loses nothing more.
    #[test]
    fn a_second_round_trip_changes_next_to_nothing(rows in rows(40, 2, 3.0)) {
        for format in [Format::Spz, Format::Sog] {
            let (_folder, path) = folder_and_file(format);
            write(&path, &scene(rows.clone()), format).unwrap();
            let once = read(&path).unwrap().0;
            let written = write(&path, &once, format).unwrap();
            let loss = QuantisationError::between(&written.rows, &read(&path).unwrap().0.rows);
            // A palette of a palette may have other entries.
            let harmonics = if format == Format::Sog { loss.colour } else { loss.harmonics };
            for deviation in [loss.position, loss.scale, loss.opacity, loss.colour, harmonics] {
                prop_assert!(deviation.largest < 1e-4, "{format}: {loss:?}");
            }
            // The largest component, which is not stored, has a small error after rounding.
            let angle = if format == Format::Sog { 1.0 } else { 0.2 };
            prop_assert!(loss.rotation.largest < angle, "{format}: {loss:?}");
        }
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), start in 0_usize..6) {
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("scene");
        let head: [&[u8]; 6] = [b"", b"ply\n", b"PK\x03\x04", b"glTF\x02\0\0\0", b"\x1f\x8b\x08\0\0\0\0\0\0\0", b"NGSP\x04\0\0\0\x01\0\0\0\0\x0c\0\x05\x20\0\0\0"];
        fs::write(&path, [head[start], &bytes].concat()).unwrap();
        prop_assert!(read(&path).is_err());
    }
}

/// Ordinary Gaussians of degree 1 within ±3.
fn drawn(count: usize) -> GaussianRows {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    rows(count, 1, 3.0).new_tree(&mut runner).unwrap().current()
}

/// The scene with a Gaussian a million units away, one at the same distance elsewhere, and one of a colour beyond all bounds.
fn with_outliers(rows: &GaussianRows) -> GaussianRows {
    let mut spoilt = rows.clone();
    for (mean, colour) in [([0.0, 0.0, -1e6], 0.3), ([2e5, -3e5, -1e6], 0.3), ([0.1, 0.2, -0.3], -1e4)] {
        spoilt.push(rows, 0);
        *spoilt.means.last_mut().unwrap() = mean;
        *spoilt.sh_dc.last_mut().unwrap() = [colour; 3];
    }
    spoilt
}

fn written_and_read(rows: &GaussianRows, format: Format) -> (GaussianRows, [usize; 2], GaussianRows) {
    let (_folder, path) = folder_and_file(format);
    let scene = scene(rows.clone());
    let Written { rows, left_out, moved } = write(&path, &scene, format).unwrap();
    (rows.into_owned(), [left_out, moved], read(&path).unwrap().0.rows)
}

#[test]
fn outliers_do_not_make_the_grid_coarse() {
    let rows = drawn(300);
    let spoilt = with_outliers(&rows);
    let (written, counts, read) = written_and_read(&spoilt, Format::Spz);
    assert_eq!(counts, [0, 2]);
    let loss = QuantisationError::between(&written, &read);
    // Half a step of 2⁻¹¹, a 12,000th of the scene's width.
    assert!(loss.position.largest <= 0.87 * 0.5_f64.powi(11), "{loss:?}");
    assert_eq!(written.means[..300], rows.means);
    // From the middle of the scene, those that were moved have the direction and the angle that they had.
    for row in 300..302 {
        let [was, is] = [&spoilt, &written].map(|rows| DVec3::from_array(rows.means[row].map(f64::from)));
        assert!(is.length() > 500.0 * 5.0 && is.length() < 1e4, "{is}");
        assert!(was.angle_between(is) < 2e-4, "{was} and {is}");
        let shrunk = f64::from(written.log_scales[row][0] - spoilt.log_scales[row][0]);
        assert!((shrunk - (is.length() / was.length()).ln()).abs() < 1e-3, "{shrunk}");
    }
    // A scene in one place has no width to compare with.
    let mut still = one();
    (0..30).for_each(|_| still.push(&one(), 0));
    still.push(&one(), 0);
    still.means[31] = [1e4; 3];
    assert_eq!(written_and_read(&still, Format::Spz).1, [0; 2]);
}

/// A few Gaussians with harmonics, so that a file has every part.
fn handful() -> SceneFile {
    let mut rows = GaussianRows { sh_degree: 1, ..GaussianRows::default() };
    let mut from = one();
    from.sh_rest = (0..9).map(|i| 0.1 * i as f32 - 0.4).collect();
    from.sh_degree = 1;
    (0..3).for_each(|_| rows.push(&from, 0));
    for (i, mean) in rows.means.iter_mut().enumerate() {
        mean[0] += i as f32;
    }
    SceneFile {
        rows,
        origin: DVec3::new(1e6, 0.0, 0.0),
        metres_per_unit: Some(0.125),
        trained: TrainedAs { antialias: true, ..TrainedAs::default() },
    }
}

#[test]
fn spoilt_files_are_refused_or_read_and_nothing_else() {
    for format in Format::READ {
        let (_folder, mut path) = folder_and_file(format);
        match format {
            Format::CompressedPly => path = fixture("splat-transform.compressed.ply"),
            _ => drop(write(&path, &handful(), format).unwrap()),
        }
        let bytes = fs::read(&path).unwrap();
        let [short, _] = spoil(&bytes, |path| match read(path) {
            Ok((scene, _)) => {
                scene.rows.check().unwrap();
                true
            }
            Err(error) => {
                let message = error.to_string();
                assert!(message.contains("spoilt") && !message.contains(char::is_control), "{message:?}");
                false
            }
        });
        assert_eq!(short, 0, "{format}: a part of a file was taken for the whole");
    }
}
