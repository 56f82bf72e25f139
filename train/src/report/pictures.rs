//! Pictures: comparisons of a render with its photograph, and plain renders.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use image::RgbImage;
use splat_model::evaluate::Comparison;
use splat_model::gaussians::values_of;

/// Magnification of the error: a twentieth of the range, plainly visible in the pictures side by side, becomes a fifth,
/// and a quarter and more becomes white.
pub const ERROR_GAIN: f32 = 4.0;

/// Returns paths for the pictures of views, below their folder: the view's name with another extension. Folders in names are kept; a
/// picture whose name is already taken (`0001.jpg` beside `0001.png`) keeps its own extension within the new name.
pub fn names<'a>(views: impl IntoIterator<Item = &'a str>, extension: &str) -> Vec<PathBuf> {
    let mut taken = HashSet::new();
    let mut free = |path: PathBuf| taken.insert(path.clone()).then_some(path);
    let mut name = |view: &str| {
        let whole = |number: usize| match number {
            0 => PathBuf::from(format!("{view}.{extension}")),
            _ => PathBuf::from(format!("{view}-{number}.{extension}")),
        };
        let short = free(Path::new(view).with_extension(extension));
        // Terminates: there are more numbers than names.
        short.or_else(|| (0..).map(whole).find_map(&mut free)).unwrap_or_default()
    };
    views.into_iter().map(&mut name).collect()
}

/// Returns ground truth | render | error side by side. The error is the absolute difference of each channel, magnified by [`ERROR_GAIN`].
pub fn comparison(comparison: &Comparison) -> RgbImage {
    let [height, width, _] = comparison.image.dims();
    let (truth, render) = (values_of(comparison.truth.clone()), values_of(comparison.image.clone()));
    side_by_side(&truth, &render, width, height)
}

/// Places two pictures `[height, width, 3]` in 0..1 and their error side by side.
fn side_by_side(truth: &[f32], render: &[f32], width: usize, height: usize) -> RgbImage {
    let pixel = |picture: &[f32], at: usize| [0, 1, 2].map(|channel| picture[3 * at + channel]);
    // Three times the largest side that a camera may have fits a u32.
    RgbImage::from_fn(3 * width as u32, height as u32, |x, y| {
        let (panel, column) = (x as usize / width, x as usize % width);
        let at = y as usize * width + column;
        let (truth, render) = (pixel(truth, at), pixel(render, at));
        image::Rgb(match panel {
            0 => truth.map(level),
            1 => render.map(level),
            _ => [0, 1, 2].map(|channel| level(ERROR_GAIN * (truth[channel] - render[channel]).abs())),
        })
    })
}

/// Converts a value in 0..1 to one of 256 levels. The conversion saturates, and NaN becomes 0.
pub(crate) fn level(value: f32) -> u8 {
    (value * 255.0).round() as u8
}

#[cfg(test)]
mod tests;
