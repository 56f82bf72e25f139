use std::fs;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Mutex;

use burn::tensor::DType;
use image::codecs::jpeg::JpegEncoder;
use image::{ImageEncoder, ImageFormat, Rgb, Rgb32FImage, RgbImage, Rgba};

use super::*;
use crate::capture::Capture;
use crate::capture::testing::{assert_says, real_capture};

/// A view of `width` × `height` px whose picture is at `image_path`.
fn view(image_path: PathBuf, width: usize, height: usize) -> View {
    let intrinsics = Intrinsics::pinhole(width, height, [50.0, 50.0], [width as f64 / 2.0, 3.0]);
    let cam_from_world = DAffine3::from_translation(glam::DVec3::X);
    View { name: "photo".into(), image_path, intrinsics, cam_from_world, cut: Cut::Whole }
}

fn saved(picture: &DynamicImage, format: ImageFormat) -> (tempfile::TempDir, View) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.img");
    picture.save_with_format(&path, format).unwrap();
    (folder, view(path, picture.width() as usize, picture.height() as usize))
}

fn gradient(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, 200]))
}

fn message(view: &View) -> String {
    let message = load(view, None).unwrap_err().to_string();
    assert_says(&message, &[&view.image_path.display().to_string()]);
    message
}

#[test]
fn a_picture_loads_row_by_row() {
    let (_folder, view) = saved(&gradient(5, 3).into(), ImageFormat::Png);
    let photo = load(&view, None).unwrap();
    assert_eq!(photo.rgb.len(), 5 * 3 * 3);
    assert_eq!(photo.rgb[3 * (2 * 5 + 4)..], [4, 2, 200], "row 2, column 4");
    assert_eq!((photo.alpha, photo.name.as_str()), (None, "photo"));
    assert_eq!((photo.intrinsics, photo.cam_from_world), (view.intrinsics, view.cam_from_world));
}

#[test]
fn the_format_is_that_of_the_content() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("really_a.png");
    gradient(16, 8).save_with_format(&path, ImageFormat::Jpeg).unwrap();
    assert_eq!(load(&view(path, 16, 8), None).unwrap().rgb.len(), 16 * 8 * 3);
}

#[test]
fn grey_and_16_bit_pictures_become_8_bit_colour() {
    let grey = DynamicImage::from(image::GrayImage::from_pixel(4, 2, image::Luma([77])));
    let (_folder, view) = saved(&grey, ImageFormat::Png);
    assert_eq!(load(&view, None).unwrap().rgb, [77; 24]);
    let deep = DynamicImage::ImageRgb16(image::ImageBuffer::from_pixel(4, 2, Rgb([257 * 9, 65535, 0])));
    let (_folder, view) = saved(&deep, ImageFormat::Png);
    assert_eq!(load(&view, None).unwrap().rgb[..3], [9, 255, 0]);
}

#[test]
fn alpha_is_kept_only_where_it_says_something() {
    let opaque = RgbaImage::from_pixel(3, 2, Rgba([1, 2, 3, 255]));
    let (_folder, view) = saved(&opaque.clone().into(), ImageFormat::Png);
    assert_eq!(load(&view, None).unwrap().alpha, None);
    let mut pierced = opaque;
    pierced.put_pixel(1, 1, Rgba([9, 8, 7, 40]));
    let (_folder, view) = saved(&pierced.into(), ImageFormat::Png);
    let photo = load(&view, None).unwrap();
    assert_eq!(photo.alpha.unwrap(), [255, 255, 255, 255, 40, 255]);
    assert_eq!(photo.rgb[12..15], [9, 8, 7], "not multiplied by alpha");
}

#[test]
fn large_pictures_shrink_with_their_cameras_and_small_ones_stay() {
    let (_folder, view) = saved(&gradient(60, 31).into(), ImageFormat::Png);
    let photo = load(&view, Some(20)).unwrap();
    assert_eq!((photo.intrinsics.width, photo.intrinsics.height), (20, 10), "31 / 3 rounds to 10");
    assert_eq!(photo.intrinsics, view.intrinsics.resized(20, 10));
    assert_eq!(photo.rgb.len(), 20 * 10 * 3);
    // Column 10 of 20 covers columns 30 to 32 of 60.
    assert!(photo.rgb[3 * 10].abs_diff(31) <= 1, "{}", photo.rgb[30]);
    for side in [60, 61, u32::MAX] {
        assert_eq!(load(&view, Some(side)).unwrap().intrinsics, view.intrinsics);
    }
}

#[test]
fn each_side_keeps_at_least_a_pixel() {
    let (_folder, view) = saved(&gradient(40, 2).into(), ImageFormat::Png);
    for (side, expected) in [(0, 1), (1, 1), (5, 5)] {
        let photo = load(&view, Some(side)).unwrap();
        assert_eq!((photo.intrinsics.width, photo.intrinsics.height), (expected, 1));
    }
}

/// The left half is opaque and orange. The right half is transparent: black, as renderers leave it, or any other colour.
#[test]
fn transparent_colours_do_not_bleed_across_an_edge() {
    for hidden in [[0, 0, 0], [0, 255, 0]] {
        let [r, g, b] = hidden;
        let half = |x, _| if x < 31 { Rgba([250, 120, 10, 255]) } else { Rgba([r, g, b, 0]) };
        let (_folder, view) = saved(&RgbaImage::from_fn(60, 60, half).into(), ImageFormat::Png);
        let photo = load(&view, Some(20)).unwrap();
        let alpha = photo.alpha.unwrap();
        let row = 20 * 9;
        assert!((40..215).contains(&alpha[row + 10]), "the edge is partly transparent: {}", alpha[row + 10]);
        for column in (0..20).filter(|column| alpha[row + column] > 8) {
            let pixel = &photo.rgb[3 * (row + column)..][..3];
            let close = pixel.iter().zip([250, 120, 10]).all(|(a, b): (&u8, u8)| a.abs_diff(b) <= 3);
            assert!(close, "column {column} beside {hidden:?}: {pixel:?}");
        }
    }
}

/// Orientation 6, "turn by 90° to show", as in pictures of a phone held upright.
#[test]
fn rotation_tags_are_not_applied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("upright.jpg");
    let entry = [0x12, 0x01, 3, 0, 1, 0, 0, 0, 6, 0, 0, 0];
    let exif = [b"II*\0\x08\0\0\0\x01\0".as_slice(), &entry, &[0; 4]].concat();
    let mut bytes = Vec::new();
    let mut encoder = JpegEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    encoder.encode_image(&gradient(16, 8)).unwrap();
    let mut decoder = image::codecs::jpeg::JpegDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!(decoder.orientation().unwrap(), image::metadata::Orientation::Rotate90, "the tag is there");
    fs::write(&path, &bytes).unwrap();
    let photo = load(&view(path, 16, 8), None).unwrap();
    assert_eq!(photo.rgb.len(), 16 * 8 * 3);
    assert!(photo.rgb[3 * 15] > photo.rgb[0] + 8, "red still grows along the row");
}

#[test]
fn a_missing_picture_is_named() {
    let view = view(PathBuf::from("/nowhere/images/a.jpg"), 4, 4);
    assert_says(&message(&view), &["no picture found", "/nowhere/images/a.jpg", "Put the photographs", "`images/`"]);
}

#[test]
fn a_folder_is_no_picture() {
    let folder = tempfile::tempdir().unwrap();
    assert_says(&message(&view(folder.path().to_owned(), 4, 4)), &["not a regular file", "ordinary file"]);
}

#[test]
fn another_size_than_the_cameras_is_refused() {
    let (_folder, mut view) = saved(&gradient(16, 8).into(), ImageFormat::Png);
    (view.intrinsics.width, view.intrinsics.height) = (8, 16);
    assert_says(&message(&view), &["is 16 × 8 px", "expected 8 × 16 px", "Use the pictures"]);
}

#[test]
fn damaged_pictures_are_refused() {
    let (_folder, view) = saved(&gradient(16, 8).into(), ImageFormat::Png);
    let whole = fs::read(&view.image_path).unwrap();
    for length in 0..whole.len() - 16 {
        fs::write(&view.image_path, &whole[..length]).unwrap();
        assert_says(&message(&view), &["cannot decode", "Expected a JPEG or PNG picture"]);
    }
    fs::write(&view.image_path, "no picture at all").unwrap();
    assert_says(&message(&view), &["cannot decode", "Expected a JPEG or PNG picture"]);
}

#[test]
fn floating_point_pictures_are_refused() {
    let linear = DynamicImage::from(Rgb32FImage::from_pixel(4, 4, Rgb([0.5, 2.0, 0.1])));
    let (_folder, view) = saved(&linear, ImageFormat::OpenExr);
    assert_says(&message(&view), &["cannot decode", "linear light", "Expected a JPEG or PNG picture"]);
}

/// A header of a few bytes that announces three billion pixels must not take memory for them.
#[test]
fn a_giant_header_is_refused_unless_the_camera_is_as_large() {
    let (_folder, view) = saved(&gradient(16, 8).into(), ImageFormat::Png);
    let mut bytes = fs::read(&view.image_path).unwrap();
    bytes[16..24].copy_from_slice(&[0, 0, 255, 255, 0, 0, 255, 255]);
    let check = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&check.to_be_bytes());
    fs::File::create(&view.image_path).unwrap().write_all(&bytes).unwrap();
    assert_says(&message(&view), &["is 65535 × 65535 px", "expected 16 × 8 px"]);
}

/// Checksum of a PNG chunk, computed bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 * (crc & 1)))
    })
}

#[test]
fn limits_grow_with_the_camera() {
    let limits = limits([100, 10]);
    assert_eq!(limits.max_alloc, Some(8 * 1000 + (64 << 20)));
}

#[test]
fn tensors_are_in_the_unit_range() {
    let pixels = [Rgba([0, 255, 51, 255]), Rgba([1, 2, 3, 51]), Rgba([0; 4]), Rgba([102; 4])];
    let picture = RgbaImage::from_fn(1, 4, |_, y| pixels[y as usize]);
    let (_folder, view) = saved(&picture.into(), ImageFormat::Png);
    let device = Device::flex();
    let rgb = load(&view, None).unwrap().rgb_over([0.0, 1.0, 0.0], &device);
    assert_eq!((rgb.dims(), rgb.dtype()), ([4, 1, 3], DType::F32));
    let found = rgb.into_data().try_to_vec::<f32>().unwrap();
    assert_eq!(found[..4], [0.0, 1.0, 0.2, 1.0 / 255.0 * 0.2]);
    assert_eq!(found[6..9], [0.0, 1.0, 0.0], "the background");
}

#[test]
fn all_photos_load_in_order_and_report_progress() {
    let folder = tempfile::tempdir().unwrap();
    let save = |i: usize| {
        let path = folder.path().join(format!("{i}.png"));
        RgbImage::from_pixel(4, 3, Rgb([i as u8; 3])).save(&path).unwrap();
        view(path, 4, 3)
    };
    let views: Vec<View> = (0..20).map(save).collect();
    let reported = Mutex::new(Vec::new());
    let photos = load_all(&views, Some(2), |done| reported.lock().unwrap().push(done)).unwrap();
    for (i, photo) in photos.iter().enumerate() {
        assert_eq!((photo.rgb[0], photo.intrinsics.width), (i as u8, 2));
    }
    let mut reported = reported.into_inner().unwrap();
    reported.sort_unstable();
    assert_eq!(reported, (1..=20).collect::<Vec<usize>>());
    fs::remove_file(&views[7].image_path).unwrap();
    let message = load_all(&views, None, |_| ()).unwrap_err().to_string();
    assert_says(&message, &["7.png"]);
}

#[test]
fn real_photos_load() {
    for (name, count) in [("fox_small", 50), ("statue_wild", 84)] {
        let Some(folder) = real_capture(name) else { continue };
        let capture = Capture::load(&folder).unwrap();
        let photos = load_all(&capture.views, Some(64), |_| ()).unwrap();
        assert_eq!(photos.len(), count);
        for (photo, view) in photos.iter().zip(&capture.views) {
            let (width, height) = (photo.intrinsics.width, photo.intrinsics.height);
            assert_eq!((width.max(height), photo.rgb.len()), (64, width * height * 3));
            assert_eq!((&photo.name, &photo.alpha), (&view.name, &None));
        }
    }
}

#[test]
fn a_header_tells_of_an_alpha_channel() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    image::RgbaImage::new(4, 3).save(file("with.png")).unwrap();
    image::RgbImage::new(4, 3).save(file("without.png")).unwrap();
    std::fs::write(file("broken.png"), b"no picture").unwrap();
    let found = ["with.png", "without.png", "broken.png", "missing.png"].map(|name| has_alpha(&file(name)));
    assert_eq!(found, [true, false, false, false]);
}
