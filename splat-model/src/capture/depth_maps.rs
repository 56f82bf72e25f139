//! The files of depth maps.

use std::error::Error;
use std::path::{Path, PathBuf};

use half::f16;
use image::{DynamicImage, ImageBuffer, Luma};
use npyz::{NpyFile, Order};

use super::masks::by_name;
use super::names::Names;
use super::read::read;
use super::{Capture, View};

/// Folders of a capture in which tools keep depth maps.
const FOLDERS: [&str; 3] = ["depth", "depths", "depth_maps"];

/// The file beside depth maps that states their unit.
pub(crate) const UNIT: &str = "depth.json";

/// Longest header of an array, bytes. Two dimensions need less, and the parser follows nested brackets by recursion.
const LONGEST_HEADER: u16 = 256;

pub(crate) fn folders(capture: &Capture) -> Vec<PathBuf> {
    FOLDERS.iter().map(|name| capture.folder.join(name)).filter(|folder| folder.is_dir()).collect()
}

/// The depth map of each view: a file named like a mask (see [`masks`](super::masks)), in the first folder that has one for any view. `None`
/// for a view without a map.
pub(crate) fn find(capture: &Capture) -> Vec<Option<PathBuf>> {
    let mut files = Names::default();
    for folder in folders(capture) {
        let folder = [folder];
        let of_view = |view: &View| by_name(&folder, &view.name, &["png", "npy", "exr"], &mut files);
        let found: Vec<Option<PathBuf>> = capture.views.iter().map(of_view).collect();
        if found.iter().any(Option::is_some) {
            return found;
        }
    }
    vec![None; capture.views.len()]
}

/// The folder of a capture's depth maps, relative to the capture; `None` if no photograph has one.
pub fn folder(capture: &Capture) -> Option<PathBuf> {
    let first = find(capture).into_iter().flatten().next()?;
    Some(first.strip_prefix(&capture.folder).ok()?.components().next()?.as_os_str().into())
}

/// The levels of a depth map as its file holds them. Zero, infinite or not a number where nothing is known.
pub(crate) type DepthMap = ImageBuffer<Luma<f32>, Vec<f32>>;

/// Reads a grey PNG picture of 8 or 16 bits, the red of an EXR picture, or an array of NumPy, `[H, W]` of 16- or 32-bit
/// floating-point numbers in C's order. The error says what the file holds instead.
pub(crate) fn load(file: &Path) -> Result<DepthMap, Box<dyn Error>> {
    let ([width, height], levels) = if file.extension().is_some_and(|kind| kind.eq_ignore_ascii_case("npy")) {
        array(&read(file)?)?
    } else {
        let map = image::open(file)?;
        let levels = match &map {
            DynamicImage::ImageLuma8(map) => map.iter().map(|&level| level.into()).collect(),
            DynamicImage::ImageLuma16(map) => map.iter().map(|&level| level.into()).collect(),
            DynamicImage::ImageRgb32F(map) => map.pixels().map(|pixel| pixel.0[0]).collect(),
            DynamicImage::ImageRgba32F(map) => map.pixels().map(|pixel| pixel.0[0]).collect(),
            _ => return Err(format!("its pixels are {:?}", map.color()).into()),
        };
        ([map.width(), map.height()], levels)
    };
    DepthMap::from_raw(width, height, levels).filter(|map| !map.is_empty()).ok_or_else(|| "it is empty".into())
}

/// Width and height of an array, and its values, row-major.
fn array(bytes: &[u8]) -> Result<([u32; 2], Vec<f32>), Box<dyn Error>> {
    if !matches!(bytes.get(6..10), Some(&[1, 0, low, high]) if u16::from_le_bytes([low, high]) <= LONGEST_HEADER) {
        return Err("it has no header of version 1 for an array of two dimensions".into());
    }
    let array = NpyFile::new(bytes)?;
    let (shape, order) = (array.shape().to_vec(), array.order());
    let levels = match array.try_data::<f16>() {
        Ok(levels) => levels.map(|level| level.map(f32::from)).collect::<Result<_, _>>()?,
        Err(array) => array.into_vec()?,
    };
    match shape[..] {
        [height, width] if order == Order::C => Ok(([u32::try_from(width)?, u32::try_from(height)?], levels)),
        _ => Err(format!("its shape is {shape:?} in {order:?}'s order").into()),
    }
}
