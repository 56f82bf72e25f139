//! Photographs and renders of test views, downsized for a page.

use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::FilterType;
use image::{GenericImageView, RgbImage};
use splat_model::evaluate::Scores;

use super::super::{VIEWS, pictures};
use crate::output::OutputFolder;

/// Largest number of views with pictures on the page: half of them the worst, half the best.
pub const MOST: usize = 24;

/// Largest length of the longer side, px.
const MOST_SIDE: u32 = 800;

/// JPEG quality, so high that its blocks are not taken for faults of the render.
const QUALITY: u8 = 92;

/// Pictures of a view, as `data:` addresses.
#[derive(Clone, Debug)]
pub struct PictureComparison {
    /// Index of the view among the scores.
    pub view: usize,
    pub width: u32,
    pub height: u32,
    pub truth: String,
    pub render: String,
}

/// Pictures of the views that are shown, the worst first.
#[derive(Clone, Debug, Default)]
pub struct Comparisons {
    pub shown: Vec<PictureComparison>,
    /// Views in the order of their scores, the worst first.
    pub order: Vec<usize>,
}

impl Comparisons {
    /// Reads the pictures in `views/`. Views whose picture cannot be read are left out.
    pub fn of(scores: Option<&Scores>, out: &OutputFolder) -> Self {
        let Some(scores) = scores else { return Self::default() };
        let names = pictures::names(scores.views.iter().map(|view| view.name.as_str()), "png");
        let mut order: Vec<usize> = (0..names.len()).collect();
        order.sort_by(|&a, &b| scores.views[a].psnr.total_cmp(&scores.views[b].psnr).then(a.cmp(&b)));
        let shown = worst_and_best(&order);
        let shown = shown.iter().filter_map(|&view| PictureComparison::read(view, &out.join(VIEWS).join(&names[view])));
        Self { shown: shown.collect(), order }
    }
}

/// Returns all views, or as many from both ends as a page has room for.
fn worst_and_best(order: &[usize]) -> Vec<usize> {
    if order.len() <= MOST {
        return order.to_vec();
    }
    let (worst, rest) = order.split_at(MOST / 2);
    [worst, &rest[rest.len() - MOST / 2..]].concat()
}

impl PictureComparison {
    /// Reads a picture with ground truth, render and error side by side.
    fn read(view: usize, path: &Path) -> Option<Self> {
        let panels = image::open(path).ok()?.into_rgb8();
        let (width, height) = (panels.width() / 3, panels.height());
        let longer = width.max(height).max(1);
        let side = |length: u32| (u64::from(length) * u64::from(MOST_SIDE) / u64::from(longer)).max(1) as u32;
        let panel = |from: u32| {
            let panel = panels.view(from, 0, width, height).to_image();
            address(&match longer > MOST_SIDE {
                true => image::imageops::resize(&panel, side(width), side(height), FilterType::Triangle),
                false => panel,
            })
        };
        Some(Self { view, width, height, truth: panel(0)?, render: panel(width)? })
    }
}

/// Encodes a picture as a `data:` address.
fn address(picture: &RgbImage) -> Option<String> {
    let mut file = Vec::new();
    picture.write_with_encoder(JpegEncoder::new_with_quality(&mut file, QUALITY)).ok()?;
    Some(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(file)))
}

#[cfg(test)]
mod tests;
