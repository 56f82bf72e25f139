//! Tests on panoramas whose colour is a smooth function of the direction in the world.

mod readers;
mod training;

use std::f64::consts::{PI, TAU};
use std::fs;
use std::path::Path;

use ::image::{GrayImage, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use glam::DQuat;

use super::*;
use crate::capture::blocks::{Block, BlockFile, Bounds};
use crate::capture::image::{load, load_all};
use crate::capture::testing::assert_says;
use crate::capture::{depth_maps, masks};

/// Width of most panoramas. A face has 21 px.
const WIDTH: u32 = 64;

/// The direction in the camera's frame of the middle of a pixel, as COLMAP's `CamRayFromImg` has it.
fn cam_from_pixel(x: u32, y: u32, width: u32) -> DVec3 {
    let theta = TAU * ((f64::from(x) + 0.5) / f64::from(width) - 0.5);
    let phi = PI * (0.5 - (f64::from(y) + 0.5) / f64::from(width / 2));
    DVec3::new(phi.cos() * theta.sin(), -phi.sin(), phi.cos() * theta.cos())
}

/// The colour of a direction in the world, levels.
fn colour(world: DVec3) -> DVec3 {
    let DVec3 { x, y, z } = world.normalize();
    DVec3::new(128.0 + 100.0 * x, 128.0 + 100.0 * y, 128.0 + 70.0 * z + 40.0 * x * y)
}

fn levels(colour: DVec3) -> [u8; 3] {
    colour.to_array().map(|channel| channel.round() as u8)
}

/// A pose that is turned about no axis of its own.
fn pose(i: usize) -> DAffine3 {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7 + i as f64);
    DAffine3::from_rotation_translation(turn, DVec3::new(0.1, 0.2, 0.3 * i as f64))
}

fn panorama(pose: &DAffine3, width: u32) -> RgbImage {
    let world = |x, y| pose.matrix3.transpose() * cam_from_pixel(x, y, width);
    RgbImage::from_fn(width, width / 2, |x, y| Rgb(levels(colour(world(x, y)))))
}

/// The lines of COLMAP's files for photographs of one equirectangular camera, without points.
fn model(names: &[&str], width: u32) -> [(&'static str, String); 2] {
    let camera = format!("1 EQUIRECTANGULAR {width} {0} {width} {0}\n", width / 2);
    let image = |(i, name): (usize, &&str)| {
        let (turn, t) = (DQuat::from_mat3(&pose(i).matrix3), pose(i).translation);
        format!("{} {} {} {} {} {} {} {} 1 {name}\n\n", i + 1, turn.w, turn.x, turn.y, turn.z, t.x, t.y, t.z)
    };
    [("cameras.txt", camera), ("images.txt", names.iter().enumerate().map(image).collect())]
}

/// A folder with a model and its photographs.
fn written(names: &[&str], width: u32, picture: impl Fn(usize, &Path)) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("sparse/0")).unwrap();
    for (name, text) in model(names, width) {
        fs::write(at("sparse/0").join(name), text).unwrap();
    }
    for (i, name) in names.iter().enumerate() {
        let path = at("images").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        picture(i, &path);
    }
    folder
}

fn smooth(names: &[&str]) -> tempfile::TempDir {
    written(names, WIDTH, |i, path| panorama(&pose(i), WIDTH).save(path).unwrap())
}

/// The largest difference of a photograph from the colours of its rays, levels.
fn error(photo: &crate::capture::Photo) -> f64 {
    let (Intrinsics { width, height, fx, fy, cx, cy, .. }, mut largest) = (photo.intrinsics, 0.0);
    for (pixel, found) in photo.rgb.as_chunks::<3>().0.iter().enumerate() {
        assert!(pixel < width * height);
        let [x, y] = [pixel % width, pixel / width].map(|at| at as f64 + 0.5);
        let ray = DVec3::new((x - cx) / fx, (y - cy) / fy, 1.0);
        let expected = colour(photo.cam_from_world.matrix3.transpose() * ray);
        let found = DVec3::from_array(found.map(f64::from));
        largest = f64::max(largest, (found - expected).abs().max_element());
    }
    largest
}

/// Two roundings to levels, and the curvature of the colours between pixels.
const ERROR: f64 = 1.2;

#[test]
fn every_face_has_the_colours_of_its_rays_across_seam_and_poles() {
    let folder = smooth(&["a.png", "b/c.d.png"]);
    let capture = Capture::load(folder.path()).unwrap();
    let names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    let [a, b] = ["a.NAME.png", "b/c.d.NAME.png"].map(|name| NAMES.map(|face| name.replace("NAME", face)));
    assert_eq!(names, [a, b].concat());
    assert!(capture.remarks.iter().any(|said| said == "2 panoramas are cut into 12 views of 90°"));
    let photos = load_all(&capture.views, None, |_| ()).unwrap();
    for (view, photo) in capture.views.iter().zip(&photos) {
        assert_eq!((&photo.name, &photo.alpha), (&view.name, &None));
        assert_eq!(photo.intrinsics, Intrinsics::centred(21, 21, 10.5));
        assert!(error(photo) <= ERROR, "{}: {}", view.name, error(photo));
        assert_eq!(load(view, None).unwrap().rgb, photo.rgb, "alone and with the others");
    }
    // An even number of pixels has the pole between them.
    let folder = written(&["a.png"], 62, |i, path| panorama(&pose(i), 62).save(path).unwrap());
    for photo in load_all(&Capture::load(folder.path()).unwrap().views, None, |_| ()).unwrap() {
        assert_eq!(photo.intrinsics.width, 20);
        assert!(error(&photo) <= ERROR, "{}: {}", photo.name, error(&photo));
    }
}

/// Stripes a pixel wide are grey where a face is made smaller, and not one of their colours.
#[test]
fn smaller_faces_are_not_aliased() {
    let stripes = |_: usize, path: &Path| {
        RgbImage::from_fn(256, 128, |x, _| Rgb([if x % 2 == 0 { 0 } else { u8::MAX }; 3])).save(path).unwrap();
    };
    let folder = written(&["a.png"], 256, stripes);
    let capture = Capture::load(folder.path()).unwrap();
    let whole = load(&capture.views[0], None).unwrap();
    assert_eq!(whole.intrinsics.width, 82);
    assert!(whole.rgb.contains(&0) && whole.rgb.contains(&u8::MAX));
    let small = load(&capture.views[0], Some(10)).unwrap();
    assert_eq!(small.intrinsics, whole.intrinsics.resized(10, 10));
    let middle = (0..100).filter(|pixel| (1..9).contains(&(pixel % 10)));
    let levels: Vec<u8> = middle.map(|pixel| small.rgb[3 * pixel]).collect();
    assert!(levels.iter().all(|level| (115..=140).contains(level)), "{levels:?}");
}

#[test]
fn opacities_are_cut_too_and_what_is_transparent_colours_nothing() {
    let half = |_: usize, path: &Path| {
        let pixel =
            |x, y| if cam_from_pixel(x, y, WIDTH).x < 0.0 { Rgba([255, 0, 0, 0]) } else { Rgba([9, 90, 200, 255]) };
        RgbaImage::from_fn(WIDTH, WIDTH / 2, pixel).save(path).unwrap();
    };
    let folder = written(&["a.png"], WIDTH, half);
    let photos = load_all(&Capture::load(folder.path()).unwrap().views, None, |_| ()).unwrap();
    let [ahead, right, _, left, ..] = &photos[..] else { panic!() };
    assert_eq!(right.alpha, None);
    assert_eq!(left.alpha, Some(vec![0; 21 * 21]));
    let alpha = ahead.alpha.as_ref().unwrap();
    for (pixel, (colour, &alpha)) in ahead.rgb.as_chunks::<3>().0.iter().zip(alpha).enumerate() {
        let column = pixel % 21;
        assert!(column == 10 || alpha == if column < 10 { 0 } else { 255 }, "column {column}: {alpha}");
        assert!(alpha == 0 || *colour == [9, 90, 200], "column {column}: {colour:?}");
    }
    assert!((1..255).contains(&alpha[10]), "the border is in the middle of a column");
}

#[test]
fn a_mask_of_a_panorama_is_cut_likewise() {
    let folder = smooth(&["a.jpg", "b.jpg"]);
    fs::create_dir(folder.path().join("masks")).unwrap();
    // Nothing above the horizon counts.
    let mask = GrayImage::from_fn(WIDTH, WIDTH / 2, |_, y| Luma([if y < WIDTH / 4 { 0 } else { 255 }]));
    mask.save(folder.path().join("masks/a.png")).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!(capture.remarks.len(), 1, "the mask belongs to a photograph: {:?}", capture.remarks);
    let views: Vec<usize> = (0..12).collect();
    let mut photos = load_all(&capture.views, None, |_| ()).unwrap();
    masks::attach(&capture, &views, &mut photos).unwrap();
    let names: Vec<&str> = photos.iter().map(|photo| photo.name.as_str()).collect();
    assert!(photos.len() == 11 && !names.contains(&"a.up.jpg"), "{names:?}");
    for photo in &photos {
        let horizon = |pixel: usize| pixel / 21 >= 10;
        let around = ["a.ahead.jpg", "a.right.jpg", "a.behind.jpg", "a.left.jpg"].contains(&photo.name.as_str());
        let expected = around.then(|| (0..21 * 21).map(horizon).collect::<Vec<bool>>());
        let rows =
            |mask: &Vec<bool>| mask.chunks(21).map(|row| row.iter().filter(|&&on| on).count()).collect::<Vec<_>>();
        // The middle row looks along the horizon.
        let skip = |mut rows: Vec<usize>| (rows.remove(10), rows).1;
        assert_eq!(photo.mask.as_ref().map(rows).map(skip), expected.as_ref().map(rows).map(skip), "{}", photo.name);
    }
}

#[test]
fn depth_maps_are_those_of_faces() {
    let folder = smooth(&["a.jpg", "b.jpg"]);
    fs::create_dir(folder.path().join("depth")).unwrap();
    GrayImage::new(WIDTH, WIDTH / 2).save(folder.path().join("depth/a.png")).unwrap();
    fs::write(folder.path().join("depth/depth.json"), r#"{"scale": 0.001}"#).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!(depth_maps::find(&capture), vec![None; 12]);
    let [_, depth] = &capture.remarks[..] else { panic!("{:?}", capture.remarks) };
    assert_says(
        depth,
        &["depth/ holds 1 pictures, and none belongs", "depth/a.ahead.jpg.png or depth/a.ahead.png, found a.png"],
    );
    let of_face = folder.path().join("depth/a.up.png");
    fs::rename(folder.path().join("depth/a.png"), &of_face).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!((depth_maps::find(&capture)[4].as_ref(), capture.remarks.len()), (Some(&of_face), 1));
}

/// Each point is observed where it is in the photograph, and then where it is in the face.
#[test]
fn observations_move_to_the_face_that_shows_them() {
    let folder = smooth(&["a.png", "b.png"]);
    let mut keypoints = [String::new(), String::new()];
    let mut points = String::new();
    for i in 0..60 {
        let angle = 2.4 * f64::from(i);
        let height = (f64::from(i) + 0.5) / 30.0 - 1.0;
        let world = 5.0
            * DVec3::new(
                angle.cos() * (1.0 - height * height).sqrt(),
                height,
                angle.sin() * (1.0 - height * height).sqrt(),
            );
        for (photograph, line) in keypoints.iter_mut().enumerate() {
            let cam = pose(photograph).transform_point3(world).normalize();
            let x = (cam.x.atan2(cam.z) / TAU + 0.5) * f64::from(WIDTH);
            let y = (0.5 + cam.y.asin() / PI) * f64::from(WIDTH / 2);
            line.push_str(&format!("{x} {y} {i} "));
        }
        points.push_str(&format!("{i} {} {} {} 1 2 3 0.5 1 {i} 2 {i}\n", world.x, world.y, world.z));
    }
    let images = model(&["a.png", "b.png"], WIDTH)[1].1.clone();
    let [first, second] = keypoints;
    let lines: Vec<&str> = images.lines().collect();
    let images = [lines[0], &first, lines[2], &second].join("\n");
    fs::write(folder.path().join("sparse/0/images.txt"), images).unwrap();
    fs::write(folder.path().join("sparse/0/points3D.txt"), points).unwrap();
    let capture = Capture::load(folder.path()).unwrap();
    assert_eq!((capture.views.len(), capture.tracks.observations()), (12, 120));
    let misses = capture.misses(0..12, |_, _, cam, miss_px| Some((cam, miss_px)));
    for (view, misses) in capture.views.iter().zip(&misses) {
        assert!(misses.len() >= 3, "{}: {} observations", view.name, misses.len());
        for (cam, miss_px) in misses {
            assert!(*miss_px < 1e-3 && cam.z >= cam.truncate().abs().max_element(), "{}: {cam}, {miss_px}", view.name);
        }
    }
}

/// Names between which faces of another photograph stand by name.
#[test]
fn the_faces_of_a_photograph_are_held_out_together() {
    let names = ["a.png", "a.b.png", "a.v.png", "b.png", "c.png"];
    let capture = Capture::load(smooth(&names).path()).unwrap();
    for k in 1..6 {
        let split = Split::every(&capture.views, k);
        let photographs = |views: &[usize]| -> Vec<&str> {
            assert!(views.chunks(6).all(|views| {
                views.iter().all(|&view| capture.views[view].photograph() == capture.views[views[0]].photograph())
            }));
            views.iter().step_by(6).map(|&view| capture.views[view].photograph()).collect()
        };
        let mut sorted = names;
        sorted.sort_unstable();
        let held_out: Vec<&str> = sorted.into_iter().step_by(k).collect();
        assert_eq!(photographs(&split.test), held_out, "every {k}th");
        assert_eq!(split.train.len(), 6 * (names.len() - held_out.len()));
    }
}

#[test]
fn a_block_has_faces_by_their_names() {
    let folder = smooth(&["a.png", "b.png"]);
    let capture = Capture::load(folder.path()).unwrap();
    let everything = Bounds::everything(glam::DMat3::IDENTITY);
    let block = Block {
        cell: everything,
        region: everything,
        train: vec![1, 4, 7],
        test: vec![0],
        points: vec![],
        points_in_cell: 0,
    };
    let out = folder.path().join("block");
    fs::create_dir(&out).unwrap();
    BlockFile::of(&capture, "..".into(), &block).write(&out).unwrap();
    let part = Capture::load(&out).unwrap();
    let names: Vec<&str> = part.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a.ahead.png", "a.right.png", "a.up.png", "b.right.png"]);
    assert_eq!(part.split, Some(Split { train: vec![1, 2, 3], test: vec![0] }));
    for view in &part.views {
        assert!(error(&load(view, None).unwrap()) <= ERROR, "{}", view.name);
    }
}
