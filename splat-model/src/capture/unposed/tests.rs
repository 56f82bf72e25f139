use std::fs;

use image::RgbImage;
use splat_op::Intrinsics;

use super::super::View;
use super::super::exif::tests::{turned, write_jpeg};
use super::super::image::load;
use super::super::testing::assert_says;
use super::*;

fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| image::Rgb([(8 * x) as u8, (8 * y) as u8, 90]))
}

#[test]
fn photographs_are_listed_by_name_without_masks_and_strangers() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["b.JPG", "a/c.png", "masks/b.JPG.png", "depth/b.png", ".hidden.png", "clip.heic", "notes.txt"] {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "x").unwrap();
    }
    let found = PhotographFolder::list(folder.path()).unwrap();
    assert_eq!(found.names, ["a/c.png", "b.JPG"]);
    assert_eq!(found.other, [("heic".to_string(), 1)].into());
    fs::create_dir(folder.path().join("images")).unwrap();
    fs::write(folder.path().join("images/z.png"), "x").unwrap();
    let found = PhotographFolder::list(folder.path()).unwrap();
    assert_eq!((found.root, found.names), (folder.path().join("images"), vec!["z.png".to_string()]));
    assert!(PhotographFolder::list(&folder.path().join("none")).is_err());
}

/// COLMAP does not either: `train/tests/cli/reconstruct.rs` looks at the installed one.
#[test]
fn a_rotation_tag_turns_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("turned.jpg");
    write_jpeg(&file, &picture(24, 16), &[turned()]);
    let all = PhotographFolder::list(folder.path()).unwrap().look(|_| ()).unwrap();
    assert_eq!(all[0].size, [24, 16]);
    let intrinsics = Intrinsics::centred(24, 16, 20.0);
    let (cam_from_world, cut) = Default::default();
    let view = View { name: String::new(), image_path: file, intrinsics, cam_from_world, cut };
    let photo = load(&view, None).unwrap();
    // Red grows to the right as stored.
    assert!(photo.rgb[3 * 20] > photo.rgb[3 * 2] + 80, "{:?}", &photo.rgb[..72]);
}

#[test]
fn a_broken_photograph_is_named() {
    let folder = tempfile::tempdir().unwrap();
    picture(24, 16).save(folder.path().join("good.png")).unwrap();
    let bytes = fs::read(folder.path().join("good.png")).unwrap();
    fs::write(folder.path().join("cut.png"), &bytes[..bytes.len() - 40]).unwrap();
    let error = PhotographFolder::list(folder.path()).unwrap().look(|_| ()).unwrap_err().to_string();
    assert_says(&error, &["cut.png", "cannot decode", "export or copy it again"]);
}

#[test]
fn photographs_of_one_camera_and_size_share_it() {
    let photograph = |camera: Option<&str>, focal_35mm: Option<f64>, size: [usize; 2], digest: u8| Unposed {
        name: String::new(),
        size,
        exif: Exif { camera: camera.map(str::to_owned), focal_35mm, ..Exif::default() },
        digest: [digest; 32],
    };
    let all = [
        photograph(None, None, [40, 30], 0),
        photograph(Some("A"), Some(28.0), [40, 30], 1),
        photograph(Some("A"), Some(28.01), [40, 30], 1),
        photograph(Some("A"), Some(50.0), [40, 30], 2),
        photograph(Some("A"), Some(28.0), [30, 40], 3),
    ];
    let groups = by_camera(&all);
    let members: Vec<&[usize]> = groups.iter().map(|group| &group.members[..]).collect();
    assert_eq!(members, [&[1, 2][..], &[0], &[3], &[4]]);
    assert_eq!(groups[1].focal_px, None);
    assert!((groups[0].focal_px.unwrap() - 28.0 / 43.2666 * 50.0).abs() < 1e-3);
    assert_eq!(different(&all), 4);
}
