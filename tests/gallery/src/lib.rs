//! What the gallery's examples share: the demo's photographs, a trained scene, and pictures side by side.
//!
//! `docs/GALLERY.md` describes the examples.
use std::error::Error;
use std::ops::Range;
use std::path::Path;

use burn::tensor::{Bool, Device, Tensor, TensorData};
use glam::DAffine3;
use image::imageops::FilterType;
use splat_demo::DemoOptions;
use splat_model::capture::{Capture, Photo, PointCloud, load_all, masks};
use splat_model::loss::Truth;
use splat_model::metrics::{psnr, scores_without};
use splat_model::trainer::{TrainConfig, Trainer};
use splat_op::{Camera, Extras, RenderOptions, Rendered, SplatError, Splats, render_view};

/// A photograph as a training loop uses it.
pub struct Shot {
    /// The photograph.
    pub photo: Photo,
    /// Its camera.
    pub camera: Camera,
    /// Its pixels, prepared for the loss; black where its mask excludes.
    pub truth: Truth,
    /// `[1, H, W]`: the pixels that its mask excludes.
    excluded: Option<Tensor<3, Bool>>,
}

impl Shot {
    /// Moves a photograph to a device.
    pub fn new(photo: Photo, device: &Device) -> Self {
        let plain = device.clone().inner();
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, device);
        let excluded = photo.mask.as_ref().map(|mask| {
            let excluded: Vec<bool> = mask.iter().map(|counts| !counts).collect();
            Tensor::from_data(TensorData::new(excluded, [1, photo.intrinsics.height, photo.intrinsics.width]), &plain)
        });
        let truth = Truth::new(masks::cleared(photo.rgb_over([0.0; 3], &plain), excluded.as_ref()));
        Self { photo, camera, truth, excluded }
    }

    /// A render, `[H, W, C]`, as it is compared with the photograph: black where the mask excludes.
    pub fn seen(&self, image: Tensor<3>) -> Tensor<3> {
        masks::cleared(image, self.excluded.as_ref())
    }

    /// dB of some columns of a render, `[H, W, 3]`, over the pixels that count.
    pub fn score(&self, image: Tensor<3>, columns: Range<usize>) -> f64 {
        let part = |picture: Tensor<3>| untracked(picture).narrow(1, columns.start, columns.len());
        let (image, truth) = (part(image), part(self.image()));
        match &self.excluded {
            Some(excluded) => scores_without(image, truth, &excluded.clone().narrow(2, columns.start, columns.len())).0,
            None => psnr(image, truth),
        }
    }

    /// The photograph, `[H, W, 3]`, untracked.
    pub fn image(&self) -> Tensor<3> {
        self.truth.image()
    }
}

/// 24 photographs of the demo, 96 × 72 px, without effects.
pub const SMALL: DemoOptions = DemoOptions { width: 96, height: 72, views: 24, ..DemoOptions::PLAIN };

/// Photographs and points of the demo.
///
/// # Errors
/// If the demo cannot be written to a temporary folder, or read from there.
pub fn demo(options: DemoOptions, device: &Device) -> Result<(Vec<Shot>, PointCloud), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    splat_demo::write(folder.path(), &options)?;
    capture(folder.path(), device)
}

/// Photographs, with their masks, and points of a capture, at most 96 px a side.
///
/// # Errors
/// If the capture cannot be read.
pub fn capture(folder: &Path, device: &Device) -> Result<(Vec<Shot>, PointCloud), Box<dyn Error>> {
    let capture = Capture::load(folder)?;
    let mut photos = load_all(&capture.views, Some(96), |_| {})?;
    masks::attach(&capture, &(0..photos.len()).collect::<Vec<_>>(), &mut photos)?;
    let shots = photos.into_iter().map(|photo| Shot::new(photo, device));
    Ok((shots.collect(), capture.points))
}

/// A scene that the library's trainer makes of photographs, untracked.
///
/// # Errors
/// If the trainer refuses the photographs.
pub fn trained<'a>(
    shots: impl IntoIterator<Item = &'a Shot>,
    points: &PointCloud,
    config: TrainConfig,
) -> Result<Splats, Box<dyn Error>> {
    let photos: Vec<Photo> = shots.into_iter().map(|shot| shot.photo.clone()).collect();
    let mut trainer = Trainer::new(photos, points, config, &Device::flex())?;
    while !trainer.is_done() {
        trainer.step()?;
    }
    Ok(trainer.gaussians().untracked().splats())
}

/// A render with the options of training.
///
/// # Errors
/// If a shape is wrong.
pub fn shown(splats: &Splats, camera: &Camera) -> Result<Rendered<3>, SplatError> {
    render_view(splats, camera, &Extras::default(), &RenderOptions::standard())
}

/// Mean dB over items, of each of which `pair` returns the render and the photograph.
///
/// # Errors
/// If a render fails.
pub fn quality<T>(
    items: impl IntoIterator<Item = T>,
    mut pair: impl FnMut(T) -> Result<(Tensor<3>, Tensor<3>), SplatError>,
) -> Result<f64, SplatError> {
    let mut scores = Vec::new();
    for item in items {
        let (image, truth) = pair(item)?;
        scores.push(psnr(untracked(image).clamp(0.0, 1.0), truth));
    }
    Ok(scores.iter().sum::<f64>() / scores.len() as f64)
}

fn untracked(image: Tensor<3>) -> Tensor<3> {
    if image.is_autodiff() { image.inner() } else { image }
}

/// The rays through the middles of a photograph's pixels, row by row: `[H W, 3]`, the camera's frame, of depth 1. For cameras without
/// distortion.
pub fn rays(photo: &Photo, device: &Device) -> Tensor<2> {
    let of = photo.intrinsics;
    let across = |x: usize| ((x as f64 + 0.5 - of.cx) / of.fx) as f32;
    let down = |y: usize| ((y as f64 + 0.5 - of.cy) / of.fy) as f32;
    let rays: Vec<f32> =
        (0..of.height).flat_map(|y| (0..of.width).flat_map(move |x| [across(x), down(y), 1.0])).collect();
    Tensor::from_data(TensorData::new(rays, [of.height * of.width, 3]), device)
}

/// A map `[1, C, H, W]`, as Burn's convolutions have it, as rows `[H W, C]`.
pub fn rows(map: Tensor<4>) -> Tensor<2> {
    let [_, channels, height, width] = map.dims();
    map.permute([0, 2, 3, 1]).reshape([height * width, channels])
}

/// Points `[N, 3]` in another frame.
pub fn transformed(transform: &DAffine3, points: Tensor<2>) -> Tensor<2> {
    let columns: Vec<f64> = transform.matrix3.to_cols_array().into();
    let device = points.device();
    let transposed = Tensor::from_data(TensorData::new(columns, [3, 3]), &device);
    let translation = Tensor::from_data(TensorData::new(transform.translation.to_array().to_vec(), [1, 3]), &device);
    points.matmul(transposed) + translation
}

/// The picture to write: the program's first argument.
///
/// # Errors
/// If there is none.
pub fn picture() -> Result<String, &'static str> {
    std::env::args().nth(1).ok_or("pass the picture to write, such as picture.png")
}

/// Saves pictures `[H, W, 3]` of one size side by side, three times as large.
///
/// # Errors
/// If the file cannot be written.
pub fn save(file: &str, pictures: Vec<Tensor<3>>) -> Result<(), Box<dyn Error>> {
    let whole = Tensor::cat(pictures.into_iter().map(untracked).collect(), 1).clamp(0.0, 1.0) * 255.0;
    let [height, width, _] = whole.dims();
    let bytes = whole.into_data().iter::<f32>().map(|value| value.round() as u8).collect();
    let (width, height) = (width as u32, height as u32);
    let picture = image::RgbImage::from_raw(width, height, bytes).ok_or("a picture of three channels")?;
    image::imageops::resize(&picture, 3 * width, 3 * height, FilterType::Nearest).save(file)?;
    Ok(())
}
