//! Masks: the pixels of a photograph that count.
//!
//! A mask is a picture of the photograph's size that is dark (below half) where pixels are excluded: passers-by, the sky, a
//! turntable. Two conventions are supported in a folder `masks` or `mask` of the capture: `<name>.png` after the
//! photograph's full name, as in COLMAP (`masks/a.jpg.png`), and the name with its extension replaced (`masks/a.png`).
//! Masks that the capture itself names (`mask_path` in `transforms.json`) come first.
//!
//! Excluded pixels have exactly no influence. The loss compares neighbourhoods, so weights on pixels would not suffice.
//! Instead, excluded pixels are black in render and photograph before the comparison, like the padding of SSIM beyond the
//! border. The difference there is zero, the gradient with respect to the render is exactly zero there for any loss, and
//! the photograph's excluded colours are not used anywhere. The loss stays a mean over all pixels, so the other pixels keep
//! their full weight.

use std::path::{Path, PathBuf};

use burn::tensor::{Bool, Tensor};
use rayon::prelude::*;
use splat_op::Intrinsics;

use crate::capture::{Capture, CaptureError, Photo, View, image};

/// Folders of the capture that are searched for masks.
const FOLDERS: [&str; 2] = ["masks", "mask"];

/// Smallest value that counts as white.
const KEPT_FROM: u8 = 128;

/// The mask file of each view. `None` for a view without a mask.
pub fn find(capture: &Capture) -> Vec<Option<PathBuf>> {
    let folders: Vec<PathBuf> =
        FOLDERS.iter().map(|name| capture.folder.join(name)).filter(|folder| folder.is_dir()).collect();
    let of_view = |(index, view): (usize, &View)| {
        let stated = capture.masks.get(index).cloned().flatten();
        stated.or_else(|| by_name(&folders, &view.name))
    };
    capture.views.iter().enumerate().map(of_view).collect()
}

/// The PNG file for a photograph: named after its full name, or with the extension replaced.
pub(super) fn by_name(folders: &[PathBuf], name: &str) -> Option<PathBuf> {
    let candidates = folders.iter().flat_map(|folder| {
        let whole = folder.join(format!("{name}.png"));
        [whole, folder.join(name).with_extension("png")]
    });
    candidates.into_iter().find(|file| file.is_file())
}

/// `[H, W]` row-major: whether each pixel counts.
///
/// # Errors
/// A [`CaptureError`] if the file cannot be decoded or has another size than `camera`.
pub fn load(file: &Path, camera: &Intrinsics) -> Result<Vec<bool>, CaptureError> {
    let picture = image::decode(file, camera)?.into_luma8();
    Ok(picture.into_raw().into_iter().map(|value| value >= KEPT_FROM).collect())
}

/// Adds masks to `photos`, which are the photographs of `views` of the capture, at the size of the photographs. Photographs
/// without any included pixel are removed.
///
/// # Errors
/// Errors of [`load`].
pub fn attach(capture: &Capture, views: &[usize], photos: &mut Vec<Photo>) -> Result<(), CaptureError> {
    let found = find(capture);
    let masked =
        photos.par_iter_mut().zip(views).filter_map(|(photo, &view)| Some((photo, view, found[view].as_ref()?)));
    masked.try_for_each(|(photo, view, file)| {
        let camera = &capture.views[view].intrinsics;
        let to = [photo.intrinsics.width, photo.intrinsics.height];
        let mask = resized(&load(file, camera)?, [camera.width, camera.height], to);
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

/// Resizes a mask. A pixel counts if all pixels that it covers count.
pub fn resized(mask: &[bool], from: [usize; 2], to: [usize; 2]) -> Vec<bool> {
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

/// `image`, `[H, W, C]`, with zeros where `excluded`, `[1, H, W]`, is true. The gradient is exactly zero there.
pub fn cleared(image: Tensor<3>, excluded: &Tensor<3, Bool>) -> Tensor<3> {
    let excluded = if image.is_autodiff() { Tensor::from_inner(excluded.clone()) } else { excluded.clone() };
    // A picture is a permuted view of planes and keeps that layout.
    let planes = image.permute([2, 0, 1]);
    let size = planes.dims();
    planes.mask_fill(excluded.expand(size), 0.0).permute([1, 2, 0])
}

#[cfg(test)]
mod tests;
