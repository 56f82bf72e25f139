//! Masks: the pixels of a photograph that count.
//!
//! A mask is a picture of the photograph's size that is dark (below half) where pixels are excluded: passers-by, the sky, a
//! turntable. A picture whose largest value is 1 is white where it is 1, and one with transparent parts is dark there. Two conventions are supported in a folder `masks` or `mask` of the capture: `<name>.png` after the
//! photograph's full name, as in COLMAP (`masks/a.jpg.png`), and the name with its extension replaced (`masks/a.png`).
//! Masks that the capture itself names (`mask_path` in `transforms.json`) come first. That of a panorama has the panorama's size.
//!
//! Excluded pixels have exactly no influence. The loss compares neighbourhoods, so weights on pixels would not suffice. Instead, excluded
//! pixels are black in render and photograph before the comparison, like the padding of SSIM beyond the border. The difference there is
//! zero, the gradient with respect to the render is exactly zero there for any loss, and the photograph's excluded colours are not used
//! anywhere. The loss stays a mean over all pixels, so the other pixels keep their full weight.

use std::path::{Path, PathBuf};

use burn::tensor::{Bool, Tensor};
use rayon::prelude::*;

use super::names::Names;
use super::{Capture, Cut, Photo, Result, View, image};

/// Folders of the capture that are searched for masks.
const FOLDERS: [&str; 2] = ["masks", "mask"];

pub(super) fn folders(capture: &Capture) -> Vec<PathBuf> {
    FOLDERS.iter().map(|name| capture.folder.join(name)).filter(|folder| folder.is_dir()).collect()
}

/// The mask file of each view. `None` for a view without a mask.
pub fn find(capture: &Capture) -> Vec<Option<PathBuf>> {
    of_views(capture, 0..capture.views.len())
}

fn of_views(capture: &Capture, views: impl IntoIterator<Item = usize>) -> Vec<Option<PathBuf>> {
    let (folders, mut files) = (folders(capture), Names::default());
    let mut of_view = |view: usize| {
        let stated = capture.masks.get(view).cloned().flatten();
        stated.or_else(|| by_name(&folders, capture.views[view].photograph(), &["png"], &mut files))
    };
    views.into_iter().map(&mut of_view).collect()
}

/// The names of a photograph's mask or depth map: its own with an extension added, and with that in place of its own.
pub(super) fn names(photograph: &str, extension: &str) -> [String; 2] {
    let replaced = Path::new(photograph).with_extension(extension);
    [format!("{photograph}.{extension}"), replaced.to_string_lossy().into_owned()]
}

/// The file for a photograph in one of some folders, with one of some extensions.
pub(super) fn by_name(
    folders: &[PathBuf],
    photograph: &str,
    extensions: &[&str],
    files: &mut Names,
) -> Option<PathBuf> {
    let names: Vec<String> = extensions.iter().flat_map(|extension| names(photograph, extension)).collect();
    let candidates = folders.iter().flat_map(|folder| names.iter().map(move |name| (folder, name)));
    candidates.into_iter().find_map(|(folder, name)| Some(folder.join(files.find(folder, name, &[])?)))
}

/// `[H, W]` row-major: whether each pixel of a view counts.
///
/// # Errors
/// A [`CaptureError`](crate::capture::CaptureError) if the file cannot be decoded or has another size than the view's photograph.
pub fn load(file: &Path, view: &View) -> Result<Vec<bool>> {
    let picture = image::decode(file, view.file_size())?;
    let levels = |values: Vec<u16>| {
        let largest = values.iter().copied().max().unwrap_or_default();
        // One of 255 is 257 of 65535.
        let kept_from = if largest <= 257 { 1 } else { 1 << 15 };
        let mask: Vec<bool> = values.into_iter().map(|value| value >= kept_from).collect();
        if let Cut::Face(face) = &view.cut { face.mask(&mask) } else { mask }
    };
    if picture.color().has_alpha() {
        let alpha: Vec<u16> = picture.to_rgba16().pixels().map(|pixel| pixel.0[3]).collect();
        if alpha.iter().min() != alpha.iter().max() {
            return Ok(levels(alpha));
        }
    }
    Ok(levels(picture.into_luma16().into_raw()))
}

/// Adds masks to `photos`, which are the photographs of `views` of the capture, at the size of the photographs. Photographs
/// without any included pixel are removed.
///
/// # Errors
/// Errors of [`load`].
pub fn attach(capture: &Capture, views: &[usize], photos: &mut Vec<Photo>) -> Result<()> {
    let found = of_views(capture, views.iter().copied());
    let masked = photos.par_iter_mut().zip(views).zip(&found);
    let masked = masked.filter_map(|((photo, &view), file)| Some((photo, view, file.as_ref()?)));
    masked.try_for_each(|(photo, view, file)| {
        let view = &capture.views[view];
        let [from, to] = [&view.intrinsics, &photo.intrinsics].map(|camera| [camera.width, camera.height]);
        let mask = image::resized_mask(&load(file, view)?, from, to);
        photo.mask = mask.contains(&false).then_some(mask);
        Ok(())
    })?;
    photos.retain(|photo| photo.mask.as_ref().is_none_or(|mask| mask.contains(&true)));
    Ok(())
}

/// Share of a mask's pixels that do not count.
pub fn excluded_share(mask: &[bool]) -> f64 {
    mask.iter().filter(|&&counts| !counts).count() as f64 / mask.len().max(1) as f64
}

/// `image`, `[H, W, C]`, with zeros where `excluded`, `[1, H, W]`, is true, if it is given. The gradient is exactly zero there.
pub fn cleared<'a>(image: Tensor<3>, excluded: impl Into<Option<&'a Tensor<3, Bool>>>) -> Tensor<3> {
    let Some(excluded) = excluded.into() else { return image };
    let excluded = if image.is_autodiff() { Tensor::from_inner(excluded.clone()) } else { excluded.clone() };
    // A picture is a permuted view of planes and keeps that layout.
    let planes = image.permute([2, 0, 1]);
    let size = planes.dims();
    planes.mask_fill(excluded.expand(size), 0.0).permute([1, 2, 0])
}

#[cfg(test)]
mod tests;
