//! Pictures: comparisons of a render with its photograph, and plain renders.

use std::collections::HashSet;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Component, Path, PathBuf};

use anyhow::Result;
use image::{ImageFormat, RgbImage};
use splat_model::evaluate::Comparison;
use splat_model::gaussians::values_of;

/// Magnification of the error: a twentieth of the range, plainly visible in the pictures side by side, becomes a fifth,
/// and a quarter and more becomes white.
pub const ERROR_GAIN: f32 = 4.0;

/// Returns paths for the pictures of views, below their folder: the view's name with another extension. Folders in
/// names are kept; a picture whose name is already taken (`0001.jpg` beside `0001.png`) keeps its own extension within
/// the new name.
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

/// Whether a path stays below the folder that it is joined to. Names of a capture do; names in any other file may not.
pub fn stays_inside(path: &Path) -> bool {
    path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
}

/// Writes ground truth | render | error side by side as an 8-bit PNG. The error is the absolute difference of each
/// channel, magnified by [`ERROR_GAIN`].
///
/// # Errors
/// If it cannot be written.
pub fn write_comparison(comparison: &Comparison, file: &mut BufWriter<File>) -> Result<()> {
    Ok(self::comparison(comparison).write_to(file, ImageFormat::Png)?)
}

/// Returns the picture that [`write_comparison`] writes.
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

/// Whether a file is a picture of [`write_comparison`]: its third panel is the difference of the others, to the level that they are
/// rounded to.
pub fn is_comparison(path: &Path) -> bool {
    let Ok(picture) = image::open(path).map(|picture| picture.into_rgb8()) else { return false };
    let (width, height) = (picture.width() / 3, picture.height());
    let matches = |(x, y): (u32, u32)| {
        let [truth, render, error] = [0, 1, 2].map(|panel| picture.get_pixel(panel * width + x, y).0);
        (0..3).all(|channel| {
            let expected = ERROR_GAIN * f32::from(truth[channel].abs_diff(render[channel]));
            (expected.min(255.0) - f32::from(error[channel])).abs() <= ERROR_GAIN + 1.0
        })
    };
    picture.width() == 3 * width && (0..height).all(|y| (0..width).all(|x| matches((x, y))))
}

/// Converts a value in 0..1 to one of 256 levels. The conversion saturates, and NaN becomes 0.
pub(crate) fn level(value: f32) -> u8 {
    (value * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_named_after_their_views() {
        let named = names(["0001.jpg", "left/0001.jpg", "no extension", "a.b.jpeg", "./c.png"], "png");
        let expected = ["0001.png", "left/0001.png", "no extension.png", "a.b.png", "./c.png"];
        assert_eq!(named, expected.map(PathBuf::from));
    }

    #[test]
    fn no_two_pictures_share_a_name() {
        let named = names(["1.jpg", "1.png", "1.tif", "1.tif.png.jpg", "1.tif.jpg"], "png");
        let distinct: HashSet<_> = named.iter().collect();
        assert_eq!(distinct.len(), named.len(), "{named:?}");
        assert_eq!(named[..3], ["1.png", "1.png.png", "1.tif.png"].map(PathBuf::from));
    }

    #[test]
    fn only_paths_below_stay_inside() {
        assert!(stays_inside(Path::new("left/0001.png")));
        assert!(!stays_inside(Path::new("../0001.png")) && !stays_inside(Path::new("/0001.png")));
    }

    #[test]
    fn panels_are_truth_render_and_error() {
        let (truth, render) = ([0.2, 0.4, 1.0, 0.0, 0.0, 0.0], [0.2, 0.5, 0.0, 0.0, 0.0, 0.1]);
        let picture = side_by_side(&truth, &render, 2, 1);
        assert_eq!(picture.dimensions(), (6, 1));
        let pixels: Vec<[u8; 3]> = picture.pixels().map(|pixel| pixel.0).collect();
        assert_eq!(pixels[..4], [[51, 102, 255], [0, 0, 0], [51, 128, 0], [0, 0, 26]]);
        assert_eq!(pixels[4..], [[0, 102, 255], [0, 0, 102]]);
    }

    #[test]
    fn a_comparison_is_known_by_its_third_panel() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let of = |i: usize, by: f32| (0..3 * 24).map(|at| ((at * i % 17) as f32 * by).fract()).collect::<Vec<f32>>();
        let (truth, render) = (of(5, 0.0613), of(7, 0.0592));
        let mut picture = side_by_side(&truth, &render, 6, 4);
        picture.save(&path).unwrap();
        assert!(is_comparison(&path));
        picture.get_pixel_mut(17, 3).0[1] ^= 0x40;
        picture.save(&path).unwrap();
        assert!(!is_comparison(&path), "painted on");
        RgbImage::from_pixel(9, 4, image::Rgb([90, 30, 30])).save(&path).unwrap();
        assert!(!is_comparison(&path), "of one colour: no difference is none");
        std::fs::write(&path, "mine").unwrap();
        assert!(!is_comparison(&path) && !is_comparison(&folder.path().join("none.png")));
    }
}
