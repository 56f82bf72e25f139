//! Masks: which pixels of a photograph count.
//!
//! A mask is a picture of the photograph's size, dark (below half) where pixels are to be left out: people who walk through,
//! the sky, a turntable. Two conventions are read, below a folder `masks` or `mask` of the capture: `<name>.png` after the
//! photograph's full name, as COLMAP has it (`masks/a.jpg.png`), or with the extension in its place (`masks/a.png`). A capture
//! that names the masks itself (`mask_path` in `transforms.json`) is believed first.
//!
//! What is left out has exactly no influence. The loss compares neighbourhoods, so that weighting pixels would not do: where
//! a mask excludes, render and photograph are both black before anything is compared, as SSIM has them beyond the border.
//! Then the difference there is zero, the gradient with respect to the render is cut off there whatever the loss makes of
//! it, and the photograph's colours there are nowhere. The loss stays a mean over all pixels: those that count pull as hard
//! as ever.

use std::path::{Path, PathBuf};

use burn::tensor::{Bool, Tensor};
use rayon::prelude::*;
use splat_op::Intrinsics;

use crate::capture::{Capture, CaptureError, Photo, View, image};

/// Folders below the capture in which masks are looked for.
const FOLDERS: [&str; 2] = ["masks", "mask"];

/// Values from this on count as white.
const KEPT_FROM: u8 = 128;

/// The mask file of each view; none for a view without.
pub fn find(capture: &Capture) -> Vec<Option<PathBuf>> {
    let folders: Vec<PathBuf> =
        FOLDERS.iter().map(|name| capture.folder.join(name)).filter(|folder| folder.is_dir()).collect();
    let of_view = |(index, view): (usize, &View)| {
        let stated = capture.masks.get(index).cloned().flatten();
        stated.or_else(|| by_name(&folders, &view.name))
    };
    capture.views.iter().enumerate().map(of_view).collect()
}

/// The PNG file that is named after a photograph: after its whole name, or with the extension in its place.
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

/// Gives `photos`, which are those of `views` of the capture, their masks at their size. A photograph of which no pixel
/// counts is left out.
///
/// # Errors
/// Those of [`load`].
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

/// A mask for a picture of another size: a pixel counts if all that it covers counts.
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

/// `image`, `[H, W, C]`, with zeros where `excluded`, `[1, H, W]`, says so; the gradient is exactly zero there.
pub fn cleared(image: Tensor<3>, excluded: &Tensor<3, Bool>) -> Tensor<3> {
    let excluded = if image.is_autodiff() { Tensor::from_inner(excluded.clone()) } else { excluded.clone() };
    // A picture is a permuted view of planes, and stays one.
    let planes = image.permute([2, 0, 1]);
    let size = planes.dims();
    planes.mask_fill(excluded.expand(size), 0.0).permute([1, 2, 0])
}

#[cfg(test)]
mod tests;
