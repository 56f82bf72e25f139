use burn::tensor::{Device, Distribution, TensorData};
use glam::DAffine3;
use splat_op::Intrinsics;

use super::*;
use crate::capture::image::resized_mask;
use crate::capture::{PointCloud, View};
use crate::gaussians::testing::devices;
use crate::gaussians::values_of;
use crate::loss::{Truth, photometric};
use crate::trainer::testing::{HEIGHT, WIDTH, photos, points};
use crate::trainer::{TrainConfig, Trainer};

/// A mask that excludes every third pixel, and a block as wide as the window of SSIM.
fn mask(width: usize, height: usize) -> Vec<bool> {
    let counts = |i: usize| (i % width >= 12 || i / width >= 12) && !i.is_multiple_of(3);
    (0..width * height).map(counts).collect()
}

fn excluded(mask: &[bool], [width, height]: [usize; 2], device: &Device) -> Tensor<3, Bool> {
    let excluded: Vec<bool> = mask.iter().map(|counts| !counts).collect();
    Tensor::from_data(TensorData::new(excluded, [1, height, width]), device)
}

/// D-SSIM compares neighbourhoods, so every pixel would have a gradient without the mask.
#[test]
fn excluded_pixels_have_exactly_no_gradient_and_no_say() {
    let (width, height) = (31, 23);
    let mask = mask(width, height);
    for device in devices() {
        let random = || Tensor::<3>::random([height, width, 3], Distribution::Uniform(0.0, 1.0), &device);
        let excluded = excluded(&mask, [width, height], &device);
        let differing = |picture: &Tensor<3>| {
            let (planes, other) = (picture.clone().permute([2, 0, 1]), random().permute([2, 0, 1]));
            planes.mask_where(excluded.clone().expand([3, height, width]), other).permute([1, 2, 0])
        };
        let (image, truth) = (random(), random());
        let others = (differing(&image), differing(&truth));
        let results = [(image, truth), others].map(|(image, truth)| {
            let image = Tensor::from_inner(image).require_grad();
            let truth = Truth::new(cleared(truth, &excluded));
            let loss = photometric(cleared(image.clone(), &excluded), &truth, 0.5);
            let gradient = values_of(image.grad(&loss.backward()).unwrap());
            (loss.into_scalar::<f32>(), gradient)
        });
        let (loss, gradient) = &results[0];
        for (pixel, &counts) in gradient.as_chunks::<3>().0.iter().zip(&mask) {
            match counts {
                true => assert!(pixel.iter().any(|value| *value != 0.0)),
                false => assert_eq!(*pixel, [0.0; 3]),
            }
        }
        assert_eq!((loss, gradient), (&results[1].0, &results[1].1), "an excluded pixel has a say");
    }
}

/// The colours of excluded pixels do not change a bit of the trained scene.
#[test]
fn a_run_does_not_see_what_is_excluded() {
    let mask = mask(WIDTH, HEIGHT);
    let trained = |colour: u8, masked: bool| {
        let mut photos = photos([0.0; 3]);
        for photo in &mut photos {
            photo.mask = masked.then(|| mask.clone());
            let pixels = photo.rgb.as_chunks_mut::<3>().0.iter_mut().zip(&mask);
            pixels.filter(|(_, counts)| !**counts).for_each(|(pixel, _)| *pixel = [colour; 3]);
        }
        let config = TrainConfig { steps: 8, ..TrainConfig::default() };
        let mut run = Trainer::new(photos, &points(), config, &Device::flex()).unwrap();
        while !run.is_done() {
            run.step().unwrap();
        }
        values_of(run.gaussians().splats().means.inner())
    };
    assert_eq!(trained(0, true), trained(255, true));
    assert_ne!(trained(0, false), trained(255, false), "the pixels would matter");
}

#[test]
fn a_smaller_mask_keeps_only_what_is_whole() {
    let mut mask = vec![true; 24];
    mask[2 * 6 + 3] = false;
    assert_eq!(resized_mask(&mask, [6, 4], [6, 4]), mask);
    assert_eq!(resized_mask(&mask, [6, 4], [3, 2]), [true, true, true, true, false, true]);
    // Pixel 1 of 4 covers the range 1.5 to 3 of 6, pixel 2 the range 3 to 4.5.
    assert_eq!(resized_mask(&mask, [6, 4], [4, 1]), [true, true, false, true]);
}

fn view([width, height]: [usize; 2]) -> View {
    let (intrinsics, cam_from_world) = (Intrinsics::centred(width, height, 5.0), DAffine3::IDENTITY);
    View { name: String::new(), image_path: "picture".into(), intrinsics, cam_from_world, cut: Cut::Whole }
}

#[test]
fn both_conventions_are_found_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let named = |name: &str| View { name: name.into(), ..view([3, 2]) };
    let mut capture = Capture {
        format: "COLMAP",
        scale: None,
        folder: folder.path().to_owned(),
        views: ["a.jpg", "b.jpg", "c/d.e.png", "f.jpg"].map(named).to_vec(),
        points: PointCloud::default(),
        tracks: Default::default(),
        origin: glam::DVec3::ZERO,
        split: None,
        masks: Vec::new(),
        focus: None,
        files: Vec::new(),
        remarks: Vec::new(),
    };
    assert_eq!(find(&capture), [const { None }; 4]);
    let write = |name: &str, bytes: Vec<u8>| {
        let file = folder.path().join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        ::image::GrayImage::from_raw(3, 2, bytes).unwrap().save(&file).unwrap();
        file
    };
    let whole = write("masks/a.jpg.png", vec![0, 127, 128, 255, 1, 254]);
    let stem = write("masks/b.png", vec![255; 6]);
    let below = write("mask/c/d.e.png", vec![255; 6]);
    assert_eq!(find(&capture), [Some(whole.clone()), Some(stem), Some(below), None]);
    let stated = folder.path().join("elsewhere.png");
    capture.masks = vec![None, Some(stated.clone()), None, None];
    assert_eq!(find(&capture)[..2], [Some(whole.clone()), Some(stated)], "masks that the capture names come first");
    let mask = load(&whole, &capture.views[0]).unwrap();
    assert_eq!(mask, [false, false, true, true, false, true]);
    assert_eq!(excluded_share(&mask), 0.5);
    let message = load(&whole, &view([3, 3])).unwrap_err().to_string();
    assert!(message.contains("a.jpg.png") && message.contains("3 × 2") && message.contains("3 × 3"), "{message}");
}

#[test]
fn masks_of_every_range_say_the_same() {
    use ::image::{DynamicImage, GrayAlphaImage, GrayImage, ImageBuffer, RgbaImage};

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mask.png");
    let kept = [true, false, false, true, false, true];
    let of = |low: u8, high: u8| kept.map(|kept| if kept { high } else { low }).to_vec();
    let grey = |values: Vec<u8>| DynamicImage::from(GrayImage::from_raw(3, 2, values).unwrap());
    let deep = |high: u16| {
        let values = kept.map(|kept| if kept { high } else { 0 }).to_vec();
        DynamicImage::from(ImageBuffer::<::image::Luma<u16>, _>::from_raw(3, 2, values).unwrap())
    };
    // The colour of a cut-out picture says nothing, and an alpha that is the same everywhere does not either.
    let cut_out = kept.iter().flat_map(|&kept| [9, 200, 30, if kept { 255 } else { 0 }]).collect();
    let with_alpha = of(0, 1).into_iter().flat_map(|value| [value, 128]).collect();
    let pictures = [
        grey(of(0, 255)),
        grey(of(127, 128)),
        grey(of(0, 1)),
        deep(u16::MAX),
        deep(1),
        grey(of(0, 1)).into_rgb8().into(),
        RgbaImage::from_raw(3, 2, cut_out).unwrap().into(),
        GrayAlphaImage::from_raw(3, 2, with_alpha).unwrap().into(),
    ];
    for (i, picture) in pictures.iter().enumerate() {
        picture.save(&file).unwrap();
        assert_eq!(load(&file, &view([3, 2])).unwrap(), kept, "picture {i}");
    }
    for (value, all) in [(0, false), (1, true), (255, true), (100, false)] {
        grey(vec![value; 6]).save(&file).unwrap();
        assert_eq!(load(&file, &view([3, 2])).unwrap(), [all; 6], "all {value}");
    }
}
