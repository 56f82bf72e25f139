//! Decoding of photographs.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Seek};
use std::ops::{Add, Div, Mul, Sub};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use burn::tensor::{Device, Element, FloatDType, Tensor, TensorData};
use glam::DAffine3;
use image::imageops::{self, FilterType};
use image::{
    ColorType, DynamicImage, ImageBuffer, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits, Pixel, RgbImage,
    Rgba32FImage, RgbaImage,
};
use rayon::prelude::*;
use splat_op::Intrinsics;
use splat_op::camera::MAX_SIDE_PX;

use super::read::{read, regular_size, unreadable};
use super::{CaptureError, Cut, Result, View};
use crate::ply::brief;
use crate::sniff::{FileClass, FileKind};

mod jpeg;
mod shrink;
#[cfg(test)]
mod tests;

/// Bytes that a decoder may allocate beside the pixels: tables, metadata, a row or two.
const DECODER_BYTES: u64 = 64 << 20;

/// Bytes of the largest pixel that is decoded: four channels of 16 bits.
const PIXEL_BYTES: u64 = 8;

/// Scale at which premultiplied colours and their weights are resized. Lanczos overshoots at edges by less than a factor of two, and `image` clips at one. If it clipped a colour or its weight, their
/// ratio would be another colour.
const HEADROOM: f32 = 0.5;

/// A decoded photograph.
#[derive(Clone, Debug)]
pub struct Photo {
    /// The view's name.
    pub name: String,
    /// Size and projection, at the size that was loaded.
    pub intrinsics: Intrinsics,
    /// The view's pose.
    pub cam_from_world: DAffine3,
    /// `[H, W, 3]` row-major: display-referred colours, 0 to 255, not multiplied by alpha.
    pub rgb: Vec<u8>,
    /// `[H, W]` row-major: 255 where the photograph is opaque. None if it is opaque everywhere.
    pub alpha: Option<Vec<u8>>,
    /// `[H, W]` row-major: whether each pixel counts, in training and in scores. None if all do.
    pub mask: Option<Vec<bool>>,
}

impl Photo {
    /// `[H, W, 3]`, a view of planes as a render is: display-referred colours in 0..1, composited over `background`, RGB in 0..1.
    pub fn rgb_over(&self, background: [f32; 3], device: &Device) -> Tensor<3> {
        let shape = [3, self.intrinsics.height, self.intrinsics.width];
        let planes = match device.settings().float_dtype {
            FloatDType::F64 => TensorData::new(self.planes_over::<f64>(background), shape),
            _ => TensorData::new(self.planes_over::<f32>(background), shape),
        };
        Tensor::<3>::from_data(planes, device).permute([1, 2, 0])
    }

    /// [`Self::rgb_over`] as `[3, H, W]`, in the device's precision so that an f64 device gets all digits.
    fn planes_over<F>(&self, background: [f32; 3]) -> Vec<F>
    where
        F: Element + From<u8> + From<f32> + Add<Output = F> + Sub<Output = F> + Mul<Output = F> + Div<Output = F>,
    {
        let (width, height) = (self.intrinsics.width, self.intrinsics.height);
        let units: [F; 256] = std::array::from_fn(|byte| F::from(byte as u8) / F::from(u8::MAX));
        let mut planes = vec![F::from(0u8); 3 * width * height];
        let (red, rest) = planes.split_at_mut(width * height);
        let (green, blue) = rest.split_at_mut(width * height);
        let [red, green, blue] = [red, green, blue].map(|plane| plane.par_chunks_mut(width.max(1)));
        red.zip(green).zip(blue).with_min_len(16).enumerate().for_each(|(row, ((red, green), blue))| {
            let pixels = row * width..(row + 1) * width;
            let alpha = self.alpha.as_ref().map(|alpha| &alpha[pixels.clone()]);
            for (x, pixel) in self.rgb.as_chunks::<3>().0[pixels].iter().enumerate() {
                let opacity = alpha.map(|alpha| units[usize::from(alpha[x])]);
                for (channel, plane) in [&mut *red, &mut *green, &mut *blue].into_iter().enumerate() {
                    let value = units[usize::from(pixel[channel])];
                    plane[x] = match opacity {
                        None => value,
                        Some(opacity) => value * opacity + F::from(background[channel]) * (F::from(1u8) - opacity),
                    };
                }
            }
        });
        planes
    }

    /// The photograph resized to `width` × `height` px (Lanczos, a = 3), with its camera scaled to match.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        self.clone().into_resized(width, height)
    }

    fn into_resized(self, width: usize, height: usize) -> Self {
        let size = [self.intrinsics.width, self.intrinsics.height];
        let (to_width, to_height) = (width as u32, height as u32);
        let (rgb, alpha) = match &self.alpha {
            Some(alpha) => {
                let (colours, _) = self.rgb.as_chunks::<3>();
                let pixels = colours.iter().zip(alpha).flat_map(|(&[r, g, b], &alpha)| [r, g, b, alpha]).collect();
                split_alpha(resize_with_alpha(picture(size, pixels), to_width, to_height))
            }
            None => {
                let rgb: RgbImage = picture(size, self.rgb);
                (imageops::resize(&rgb, to_width, to_height, FilterType::Lanczos3).into_raw(), None)
            }
        };
        let intrinsics = self.intrinsics.resized(width, height);
        let mask = self.mask.map(|mask| resized_mask(&mask, size, [width, height]));
        Self { intrinsics, rgb, alpha, mask, ..self }
    }
}

/// `rgb`, `[H, W, 3]`, with opacities `[H, W, 1]`, over `background`; `rgb` itself where it is opaque everywhere.
pub(super) fn over(rgb: Tensor<3>, alpha: Option<Tensor<3>>, background: [f32; 3]) -> Tensor<3> {
    let Some(alpha) = alpha else { return rgb };
    let background = Tensor::<1>::from_floats(background, &rgb.device()).reshape([1, 1, 3]);
    rgb * alpha.clone() + background * (alpha.neg() + 1.0)
}

fn picture<P: Pixel<Subpixel = u8>>([width, height]: [usize; 2], bytes: Vec<u8>) -> ImageBuffer<P, Vec<u8>> {
    ImageBuffer::from_raw(width as u32, height as u32, bytes).expect("a photograph has as many bytes as its size says")
}

fn split_alpha(picture: RgbaImage) -> Pixels {
    let pixels = picture.into_raw();
    let (pixels, _) = pixels.as_chunks::<4>();
    let alpha = pixels.iter().map(|&[.., alpha]| alpha).collect();
    (pixels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect(), Some(alpha))
}

/// Decodes the picture of a view and, if its longer side exceeds `max_side` px, downsizes it to that (Lanczos, a = 3).
///
/// Rotation tags (EXIF) are not applied, as COLMAP does not apply them either. 16-bit pictures are rounded to 8 bits.
///
/// # Errors
/// A [`CaptureError`] if the file is missing, is not a JPEG or PNG picture, is damaged or cut short, or differs in size from the view's
/// camera.
pub fn load(view: &View, max_side: Option<u32>) -> Result<Photo> {
    Ok(photo(view, &mut pixels(view)?, max_side))
}

/// Colours and opacities, as a [`Photo`] has them.
pub(super) type Pixels = (Vec<u8>, Option<Vec<u8>>);

/// Decodes the file of a view.
fn pixels(view: &View) -> Result<Pixels> {
    let picture = decode(&view.image_path, view.file_size())?;
    Ok(match with_alpha(&picture) {
        Some(rgba) => split_alpha(rgba),
        None => (picture.into_rgb8().into_raw(), None),
    })
}

/// The photograph of a view whose file was decoded. A view that is the whole file takes its pixels.
fn photo(view: &View, of_file: &mut Pixels, max_side: Option<u32>) -> Photo {
    let (rgb, alpha) = match &view.cut {
        Cut::Face(face) => face.pixels(of_file),
        Cut::Whole | Cut::Panorama => std::mem::take(of_file),
    };
    let View { ref name, intrinsics, cam_from_world, .. } = *view;
    let photo = Photo { name: name.clone(), intrinsics, cam_from_world, rgb, alpha, mask: None };
    let Intrinsics { width, height, .. } = view.intrinsics_within(max_side);
    if [width, height] == [intrinsics.width, intrinsics.height] { photo } else { photo.into_resized(width, height) }
}

/// Calls [`load`] for each of `views` on all threads; results are in the views' order. `progress` receives the number done, from any thread.
///
/// # Errors
/// Those of [`load`]. If several pictures are faulty, the error is of any one of them.
pub fn load_all<'a>(
    views: impl IntoIterator<Item = &'a View>,
    max_side: Option<u32>,
    progress: impl Fn(usize) + Sync,
) -> Result<Vec<Photo>> {
    let views: Vec<&View> = views.into_iter().collect();
    let done = AtomicUsize::new(0);
    // The file of a panorama is decoded once for its views, which stand together.
    let files = views.par_chunk_by(|a, b| a.cut != Cut::Whole && a.image_path == b.image_path);
    let load_file = |views: &[&View]| {
        let mut of_file = pixels(views[0])?;
        let photos = views.iter().map(|view| photo(view, &mut of_file, max_side));
        Ok(photos.inspect(|_| progress(1 + done.fetch_add(1, Ordering::Relaxed))).collect())
    };
    let photos: Vec<Vec<Photo>> = files.map(load_file).collect::<Result<_, _>>()?;
    Ok(photos.into_iter().flatten().collect())
}

/// Decodes a whole picture. Decoders refuse a PNG that is cut short, but not a JPEG.
///
/// The size of the file is compared with the camera's before any pixel is decoded, so that a picture allocates no more
/// than its camera implies.
pub(crate) fn decode(file: &Path, size: [usize; 2]) -> Result<DynamicImage> {
    let reader = reader(file)?;
    if reader.format() != Some(ImageFormat::Jpeg) {
        return decoded(file, reader, size);
    }
    let bytes = read(file)?;
    if !jpeg::has_end(&bytes) {
        return Err(undecodable(file, "it is cut short or damaged: the marker of its end is missing".into()));
    }
    decoded(file, ImageReader::with_format(Cursor::new(&bytes), ImageFormat::Jpeg), size)
}

fn decoded<R: BufRead + Seek>(file: &Path, mut reader: ImageReader<R>, size: [usize; 2]) -> Result<DynamicImage> {
    let fail = |error: ImageError| undecodable(file, error.to_string());
    reader.limits(limits(size));
    let decoder = reader.into_decoder().map_err(fail)?;
    let (width, height) = decoder.dimensions();
    if [width as usize, height as usize] != size {
        let detail = format!(
            "the picture is {width} × {height} px, expected {} × {} px as its camera states. Use the pictures that the reconstruction was \
             made from, or run it again on these",
            size[0], size[1]
        );
        return Err(CaptureError::content(file, detail));
    }
    if matches!(decoder.color_type(), ColorType::Rgb32F | ColorType::Rgba32F) {
        let reason = "it holds linear light as floating-point numbers, not display-referred colours";
        return Err(undecodable(file, reason.into()));
    }
    DynamicImage::from_decoder(decoder).map_err(fail)
}

fn reader(file: &Path) -> Result<ImageReader<BufReader<File>>> {
    let reader = ImageReader::new(BufReader::new(open(file)?));
    reader.with_guessed_format().map_err(|error| undecodable(file, error.to_string()))
}

/// The error for a file that is no whole picture. What it is instead says more than that the decoder does not know it.
fn undecodable(file: &Path, reason: String) -> CaptureError {
    let other = FileKind::of(file).filter(|kind| matches!(kind.class, FileClass::Other | FileClass::Video));
    let reason = other.map_or(reason, |kind| format!("it is {}, whatever its name says: {}", kind.what, kind.remedy));
    // Decoders say several lines.
    let (file, reason) = (file.display(), brief(&reason));
    CaptureError::Content(format!(
        "cannot decode {file}: {reason}. Expected a JPEG or PNG picture: export or copy it again"
    ))
}

/// A decoder that has read a picture's header.
pub(crate) fn header(file: &Path) -> Result<impl ImageDecoder + use<>> {
    reader(file)?.into_decoder().map_err(|error| undecodable(file, error.to_string()))
}

/// Width and height of a picture, px, from its header.
pub(crate) fn size(file: &Path) -> Result<[usize; 2]> {
    let (width, height) = reader(file)?.into_dimensions().map_err(|error| undecodable(file, error.to_string()))?;
    match [width, height].map(|side| side as usize) {
        size if size.iter().all(|&side| (1..=MAX_SIDE_PX).contains(&side)) => Ok(size),
        _ => {
            let reason = format!("it is {width} × {height} px, and the most is {MAX_SIDE_PX} along a side");
            Err(undecodable(file, reason))
        }
    }
}

/// Whether a picture has an alpha channel, from its header. False if the header cannot be read; decoding reports that error.
pub(crate) fn has_alpha(file: &Path) -> bool {
    let decoder = || ImageReader::open(file).ok()?.with_guessed_format().ok()?.into_decoder().ok();
    decoder().is_some_and(|decoder| decoder.color_type().has_alpha())
}

fn limits([width, height]: [usize; 2]) -> Limits {
    let pixels = (width as u64).saturating_mul(height as u64);
    let mut limits = Limits::default();
    limits.max_alloc = Some(pixels.saturating_mul(PIXEL_BYTES).saturating_add(DECODER_BYTES));
    limits
}

fn open(file: &Path) -> Result<File> {
    regular_size(file).and_then(|_| File::open(file)).map_err(|reason| match reason.kind() {
        io::ErrorKind::NotFound => CaptureError::Missing {
            what: "picture",
            looked_for: vec![file.to_owned()],
            fix: "Put the photographs that the reconstruction was made from where it lists them: below `images/`, or for \
                  `transforms.json` below its folder",
        },
        _ => unreadable(file, reason),
    })
}

/// The picture with its alpha channel, if that is not opaque everywhere.
fn with_alpha(picture: &DynamicImage) -> Option<RgbaImage> {
    if !picture.color().has_alpha() {
        return None;
    }
    let rgba = picture.to_rgba8();
    let seen_through = rgba.pixels().any(|pixel| pixel.0[3] != 255);
    seen_through.then_some(rgba)
}

/// `size` shrunk so that its longer side is at most `max_side`; each side is rounded and at least one pixel.
pub(super) fn size_within(size: [u32; 2], max_side: Option<u32>) -> [u32; 2] {
    let longer = size[0].max(size[1]);
    let Some(max_side) = max_side.map(|side| side.max(1)).filter(|&side| side < longer) else {
        return size;
    };
    let scale = f64::from(max_side) / f64::from(longer);
    size.map(|side| ((f64::from(side) * scale).round() as u32).max(1))
}

/// Resizes a mask. A pixel counts if all pixels that it covers count.
pub(super) fn resized_mask(mask: &[bool], from: [usize; 2], to: [usize; 2]) -> Vec<bool> {
    let [width, height] = from;
    let covered = |at: usize, from: usize, to: usize| at * from / to..((at + 1) * from).div_ceil(to);
    let rows = (0..to[1]).map(|row| covered(row, height, to[1]));
    let counts = rows.flat_map(|rows| {
        let columns = (0..to[0]).map(|column| covered(column, width, to[0]));
        columns.map(move |columns| {
            rows.clone().all(|row| mask[row * width..][columns.clone()].iter().all(|&counts| counts))
        })
    });
    counts.collect()
}

/// Resizes colours weighted by opacity, so that the colour of transparent pixels does not bleed across edges.
fn resize_with_alpha(rgba: RgbaImage, width: u32, height: u32) -> RgbaImage {
    if rgba.dimensions() == (width, height) {
        return rgba;
    }
    let mut weighted: Rgba32FImage = DynamicImage::ImageRgba8(rgba).into_rgba32f();
    for pixel in weighted.pixels_mut() {
        let [r, g, b, alpha] = pixel.0;
        pixel.0 = [r * alpha, g * alpha, b * alpha, alpha].map(|value| value * HEADROOM);
    }
    let mut resized = imageops::resize(&weighted, width, height, FilterType::Lanczos3);
    for pixel in resized.pixels_mut() {
        let [r, g, b, alpha] = pixel.0;
        pixel.0 = if alpha > 0.0 { [r / alpha, g / alpha, b / alpha, alpha / HEADROOM] } else { [0.0; 4] };
    }
    DynamicImage::ImageRgba32F(resized).into_rgba8()
}
