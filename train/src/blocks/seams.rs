//! The check of a merged scene: its renders against those of its blocks, where a block's own cell fills the pixel.

use std::collections::HashMap;

use anyhow::Result;
use burn::tensor::Device;
use glam::Vec3;
use splat_model::capture::blocks::BlockFile;
use splat_model::capture::{Capture, Photo};
use splat_model::effects::background::Background;
use splat_model::gaussians::{DC, GaussianRows, Gaussians, values_of};
use splat_model::ply::TrainedAs;
use splat_model::trainer::TrainConfig;
use splat_op::{RenderOptions, Splats};

use super::job;
use super::planned::PlanFolder;
use crate::report::SCENE;
use crate::{input, progress};

/// Share of a pixel's colour that must come from the block's own cell for the pixel to count.
const FILLED: f32 = 0.9;

/// A loss of more than this at a block's pixels is worth a warning, dB.
const WORTH_A_WARNING: f64 = 0.5;

/// A merged scene, ready to be compared with its blocks.
pub struct Seams<'a> {
    capture: &'a Capture,
    merged: Splats,
    options: RenderOptions,
    background: [f32; 3],
    max_side: Option<u32>,
    masked: bool,
    device: &'a Device,
}

/// Sums over the pixels that a block's cell fills.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    photographs: usize,
    pixels: usize,
    of: usize,
    own: f64,
    merged: f64,
    apart: f64,
}

impl<'a> Seams<'a> {
    /// Prepares the comparison, with the options of the blocks' training.
    pub fn new(
        capture: &'a Capture,
        options: &[String],
        rows: &GaussianRows,
        trained: &TrainedAs,
        device: &'a Device,
    ) -> Result<Self> {
        let training = job::training(&capture.folder, options)?;
        let config = TrainConfig { antialias: trained.antialias, ..training.config()? };
        Ok(Self {
            capture,
            merged: Gaussians::from_rows(rows, device)?.splats(),
            options: config.render_options(input::extent(capture)),
            background: trained.background,
            max_side: training.photos.max_side,
            masked: options.iter().any(|option| option.starts_with("--effects=") && option.contains("masks")),
            device,
        })
    }

    /// Compares on up to `views` held-out photographs of each block, and prints a line for each.
    pub fn check(&self, folder: &PlanFolder, files: &[BlockFile], views: usize) -> Result<()> {
        let by_name: HashMap<&str, usize> =
            self.capture.views.iter().enumerate().map(|(i, view)| (view.name.as_str(), i)).collect();
        progress::say("where a block's own cell fills the pixels of held-out photographs, PSNR in dB:");
        progress::say(&format!(
            "{:<12}{:>12}{:>8}{:>8}{:>8}{:>8}{:>20}",
            "block", "photographs", "pixels", "block", "merged", "change", "merged to block"
        ));
        for (name, file) in folder.plan.blocks.iter().zip(files) {
            let step = file.test.len().div_ceil(views).max(1);
            let test: Vec<usize> =
                file.test.iter().step_by(step).filter_map(|name| by_name.get(name.as_str()).copied()).collect();
            let photos = input::photographs(self.capture, &test, self.max_side, self.masked)?;
            let (rows, _) = input::rows("--scene", &folder.run(name).join(SCENE), Some(self.capture))?;
            let own = Gaussians::from_rows(&rows, self.device)?.splats();
            let cell = Gaussians::from_rows(&painted(&rows, file), self.device)?.splats();
            let mut sums = Sums::default();
            for photo in &photos {
                self.compare(photo, &own, &cell, &mut sums)?;
            }
            say(name, &sums);
        }
        Ok(())
    }

    fn compare(&self, photo: &Photo, own: &Splats, cell: &Splats, sums: &mut Sums) -> Result<()> {
        let truth = values_of(photo.rgb_over(self.background, self.device));
        let (own, merged) =
            (self.render(own, photo, self.background)?, self.render(&self.merged, photo, self.background)?);
        let filled = self.render(cell, photo, [0.0; 3])?;
        sums.photographs += 1;
        for pixel in 0..truth.len() / 3 {
            if photo.mask.as_ref().is_some_and(|mask| !mask[pixel]) {
                continue;
            }
            sums.of += 1;
            if !(filled[3 * pixel] >= FILLED) {
                continue;
            }
            sums.pixels += 1;
            for i in 3 * pixel..3 * pixel + 3 {
                let squared = |a: f32, b: f32| f64::from(a - b).powi(2);
                sums.own += squared(own[i], truth[i]);
                sums.merged += squared(merged[i], truth[i]);
                sums.apart += squared(merged[i], own[i]);
            }
        }
        Ok(())
    }

    /// `[H, W, 3]` row-major, 0 to 1.
    fn render(&self, splats: &Splats, photo: &Photo, background: [f32; 3]) -> Result<Vec<f32>> {
        let background = Background::Colour(background);
        let picture = background.render(splats, &photo.intrinsics, &photo.cam_from_world, &self.options)?;
        Ok(values_of(picture.colour.clamp(0.0, 1.0)))
    }
}

/// The rows of a block, white in its cell and black elsewhere.
fn painted(rows: &GaussianRows, file: &BlockFile) -> GaussianRows {
    let is_in_cell = |mean: &[f32; 3]| file.cell.contains(Vec3::from(*mean).as_dvec3());
    let colour = |mean: &[f32; 3]| [if is_in_cell(mean) { 0.5 } else { -0.5 } / DC as f32; 3];
    let sh_dc = rows.means.iter().map(colour).collect();
    GaussianRows { sh_dc, sh_rest: Vec::new(), sh_degree: 0, ..rows.clone() }
}

fn say(name: &str, sums: &Sums) {
    let db = |squared: f64| -10.0 * (squared / (3 * sums.pixels) as f64).log10();
    let share = 100.0 * sums.pixels as f64 / sums.of.max(1) as f64;
    let start = format!("{name:<12}{:>12}{share:>7.0}%", sums.photographs);
    if sums.pixels == 0 {
        return progress::say(&start);
    }
    let change = db(sums.merged) - db(sums.own);
    let (own, merged, apart) = (db(sums.own), db(sums.merged), db(sums.apart));
    progress::say(&format!("{start}{own:>8.2}{merged:>8.2}{change:>+8.2}{apart:>20.2}"));
    if change < -WORTH_A_WARNING {
        progress::note(&format!(
            "{name}: the merged scene is {:.2} dB worse where this block alone fills the picture: its neighbours' splats cover it. \
             Plan again with a wider `--margin`",
            -change
        ));
    }
}
