//! Tests of what the formats say of panoramas.

use super::*;
use crate::capture::exif::tests::{place, write_jpeg};
use crate::capture::scale::from_gps;

/// The files of [`model`] in COLMAP's binary encoding (`src/colmap/sensor/models.h`: number 17, parameters w and h).
fn binary_model(names: &[&str], width: u32) -> [(&'static str, Vec<u8>); 2] {
    let mut cameras = [1_u64.to_le_bytes().to_vec(), [1_u32, 17].map(u32::to_le_bytes).concat()].concat();
    for side in [width, width / 2] {
        cameras.extend(u64::from(side).to_le_bytes());
    }
    for side in [width, width / 2] {
        cameras.extend(f64::from(side).to_le_bytes());
    }
    let mut images = (names.len() as u64).to_le_bytes().to_vec();
    for (i, name) in names.iter().enumerate() {
        let (turn, t) = (DQuat::from_mat3(&pose(i).matrix3), pose(i).translation);
        images.extend((i as u32 + 1).to_le_bytes());
        images.extend([turn.w, turn.x, turn.y, turn.z, t.x, t.y, t.z].map(f64::to_le_bytes).concat());
        images.extend(1_u32.to_le_bytes());
        images.extend([name.as_bytes(), &[0], &0_u64.to_le_bytes()].concat());
    }
    [("cameras.bin", cameras), ("images.bin", images)]
}

#[test]
fn both_encodings_of_a_model_say_the_same() {
    let folder = smooth(&["a.png", "b.png"]);
    let text = Capture::load(folder.path()).unwrap();
    for (name, bytes) in binary_model(&["a.png", "b.png"], WIDTH) {
        fs::write(folder.path().join("sparse/0").join(name), bytes).unwrap();
    }
    let binary = Capture::load(folder.path()).unwrap();
    assert!(binary.files[0].ends_with("images.bin") && text.files[0].ends_with("images.txt"));
    assert_eq!(binary.views.len(), 12);
    for (binary, text) in binary.views.iter().zip(&text.views) {
        assert_eq!((&binary.name, &binary.cut, binary.intrinsics), (&text.name, &text.cut, text.intrinsics));
        assert!(binary.cam_from_world.abs_diff_eq(text.cam_from_world, 1e-12));
    }
}

/// Directions as nerfstudio's `cameras.py` has them for `EQUIRECTANGULAR`, in OpenGL's axes, which are the world's here.
#[test]
fn nerfstudio_means_the_same_directions() {
    let folder = tempfile::tempdir().unwrap();
    let world = |x: u32, y: u32| {
        let [x, y] = [x, y].map(|px| f64::from(px) + 0.5);
        let theta = -PI * (x - 32.0) / 32.0;
        let phi = PI * (0.5 + (y - 16.0) / 32.0);
        DVec3::new(-theta.sin() * phi.sin(), phi.cos(), -theta.cos() * phi.sin())
    };
    RgbImage::from_fn(64, 32, |x, y| Rgb(levels(colour(world(x, y))))).save(folder.path().join("a.png")).unwrap();
    fs::copy(folder.path().join("a.png"), folder.path().join("b.png")).unwrap();
    let frame = |name: &str, mask: &str| {
        format!(r#"{{"file_path": "{name}", {mask} "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}"#)
    };
    let frames = [frame("a.png", r#""mask_path": "m.png","#), frame("b.png", "")].join(", ");
    let lists = r#""train_filenames": ["b.png"], "test_filenames": ["a.png"]"#;
    // Without focal length and size, and with those of nerfstudio's converter.
    for fields in ["", r#""w": 64, "h": 32, "fl_x": 32, "fl_y": 32, "cx": 32, "cy": 16, "k1": 0.1,"#] {
        let text = format!(r#"{{"camera_model": "EQUIRECTANGULAR", {fields} {lists}, "frames": [{frames}]}}"#);
        fs::write(folder.path().join("transforms.json"), text).unwrap();
        let capture = Capture::load(folder.path()).unwrap();
        for view in &capture.views {
            assert!(error(&load(view, None).unwrap()) <= ERROR, "{}", view.name);
        }
        assert_eq!(capture.split, Some(Split { train: (6..12).collect(), test: (0..6).collect() }));
        let mask = Some(folder.path().join("m.png"));
        assert_eq!(masks::find(&capture), [vec![mask; 6], vec![None; 6]].concat());
    }
}

#[test]
fn panoramas_of_other_sizes_are_refused() {
    let folder = smooth(&["a.png"]);
    let file = folder.path().join("sparse/0/cameras.txt");
    let refused = |camera: &str| {
        fs::write(&file, camera).unwrap();
        Capture::load(folder.path()).unwrap_err().to_string()
    };
    let parts = ["images.txt", "a.png", "64 × 40 px", "twice as wide as high", "360° × 180°", "whole sphere"];
    assert_says(&refused("1 EQUIRECTANGULAR 64 40 64 40\n"), &parts);
    let parts = ["cameras.txt", "camera on line 1", "`PARAMS` is 64 31", "expected 64 32"];
    assert_says(&refused("1 EQUIRECTANGULAR 64 32 64 31\n"), &parts);
    assert_says(
        &refused("1 EQUIRECTANGULAR 64 32 64\n"),
        &["`PARAMS` is 1 numbers", "2 numbers for the camera model EQUIRECTANGULAR"],
    );
    let images = folder.path().join("sparse/0/images.txt");
    let both = fs::read_to_string(&images).unwrap() + "2 1 0 0 0 0 0 0 2 a.left.png\n\n";
    fs::write(&images, both).unwrap();
    let clash = refused("1 EQUIRECTANGULAR 64 32 64 32\n2 SIMPLE_PINHOLE 8 8 8 4 4\n");
    assert_says(&clash, &["images.txt", "a.left.png is a photograph and a face", "Rename"]);
    fs::write(&images, &model(&["a.png"], WIDTH)[1].1).unwrap();
    // The photograph has another size than its camera.
    fs::write(&file, "1 EQUIRECTANGULAR 128 64 128 64\n").unwrap();
    let view = &Capture::load(folder.path()).unwrap().views[3];
    assert_says(&load(view, None).unwrap_err().to_string(), &["a.png", "64 × 32 px, expected 128 × 64 px"]);
    fs::remove_file(folder.path().join("images/a.png")).unwrap();
    let missing = Capture::load(folder.path()).unwrap().check_photographs(&[2]).unwrap_err().to_string();
    assert_says(&missing, &["1 of 1 photographs", "a.png"]);
}

/// Three places do not become eighteen.
#[test]
fn a_panorama_has_one_place_by_gps() {
    let picture = |i: usize, path: &Path| {
        write_jpeg(
            path,
            &RgbImage::new(WIDTH, WIDTH / 2),
            &place([50.0, 1.0 + i as f64, 0.0], false, [7.0, 2.0, 0.0], false),
        );
    };
    let folder = written(&["a.jpg", "b.jpg", "c.jpg"], WIDTH, picture);
    let message = from_gps(&Capture::load(folder.path()).unwrap()).unwrap().unwrap_err().to_string();
    assert_says(&message, &["3 of 3 placed photographs have a GPS position"]);
}
