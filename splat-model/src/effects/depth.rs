//! Depth supervision: known depths constrain the scene where few photographs do.
//!
//! Known depths come from the depth maps of a capture, or else from the sparse points in the photographs of their tracks
//! (Deng et al. 2022, "Depth-supervised NeRF"). The render's depth is `D/α` with `D = Σ wᵢ zᵢ`. The loss is the mean of the
//! relative error `|D/α − z| / z` over the known pixels, so that near and far count alike. Pixels with an alpha below one
//! half are left out. One of three steps is supervised, with three times the weight.
//!
//! The gradient includes the opacity `α = Σ wᵢ`. If `α` is held constant, as is sometimes done, lower opacities reduce `D`
//! as well as movement does. On the capture of `known_depths_pull_the_scene`, depths are then further off at the end (0.73
//! scene units) than without supervision (0.46). With the full derivative they are nearer (less than 0.28). It is
//! `(zᵢ − D/α)/α` for each weight: Gaussians that are too far fade, and nearer ones gain.

use std::path::Path;

use burn::tensor::{DType, Device, Int, Tensor};
use glam::Vec2;
use rayon::prelude::*;
use serde::Deserialize;
use splat_op::Rendered;
use splat_op::depth_miss::depth_miss;

use self::relative::Quantity;
use super::{Effect, EffectContext, EffectKind, Falling, RenderInput};
pub use crate::capture::depth_maps::folder;
use crate::capture::depth_maps::{self, DepthMap, UNIT, find};
use crate::capture::{Capture, CaptureError, Result};
use crate::gaussians::Gaussians;
use crate::json;
use crate::quantile::quantile;

mod relative;

options! {
    /// Options of depth supervision.
    #[derive(Copy)]
    pub struct DepthConfig {
        /// Weight of the relative error in the loss, 0.5 throughout. A larger weight helps where little else is known and harms
        /// where photographs are more accurate (`docs/EFFECTS.md`).
        pub weight: Falling = Falling { from: 0.5, to: 0.5 },
        /// Steps whose number is a multiple of this, 3, are supervised, with as many times the weight. Other steps do not render depth.
        /// Values up to 4 were measured, with nearly the same gain (`docs/EFFECTS.md`). 0 acts as 1.
        pub every: usize = 3,
    }
}

/// A position in a photograph with known depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSample {
    /// Position, as shares of the picture's width and height.
    pub at: [f32; 2],
    /// Camera z, scene units, positive.
    pub depth: f32,
}

/// Largest distance between an observation and its projected point, as a share of the picture's longer side: 4 px in a
/// thousand. Observations beyond it are taken as wrong.
const LARGEST_MISS: f64 = 0.004;

/// The depths of the sparse points in the photographs `views`, by their tracks.
pub fn from_tracks(capture: &Capture, views: &[usize]) -> Vec<Vec<DepthSample>> {
    capture.misses(views.iter().copied(), |view, observation, cam, miss_px| {
        let size = Vec2::new(view.intrinsics.width as f32, view.intrinsics.height as f32);
        let found = Vec2::from_array(observation.at_px);
        let inside = found.cmpge(Vec2::ZERO).all() && found.cmplt(size).all();
        (inside && miss_px <= LARGEST_MISS * f64::from(size.max_element()))
            .then(|| DepthSample { at: (found / size).to_array(), depth: cam.z as f32 })
    })
}

/// What `depth.json` holds: scene units per level, or what the levels grow with.
#[derive(Deserialize)]
#[serde(untagged, expecting = "neither a number `scale` nor one of the words for `relative`")]
enum Stated {
    Scale { scale: f64 },
    Relative { relative: Quantity },
}

/// Reads the depth maps of the photographs `views`, in the capture's [folder] of them: PNG, EXR or NumPy files of any size, named
/// like masks (see [`masks`](super::masks)). Levels are camera z at pixel centres, and zero where the depth is unknown. The
/// file `depth.json` holds the scene units per level: `{"scale": 0.001}`. With `{"relative": "depth"}` or `{"relative": "disparity"}` levels grow with
/// camera z or its reciprocal, as networks for single pictures have them, and scale and shift of each map are solved from the photograph's
/// sparse points. Large maps are sampled evenly. A photograph without a map has no samples. Nor has one whose scale cannot be solved; `note`
/// receives a sentence about those. `None` without any map.
///
/// # Errors
/// If `depth.json` is missing or states neither, or its scale is not positive, if a map cannot be read or is not grey, or if the scale of no map
/// can be solved.
pub fn from_maps(capture: &Capture, views: &[usize], note: impl Fn(&str)) -> Result<Option<Vec<Vec<DepthSample>>>> {
    let Some(folder) = folder(capture) else { return Ok(None) };
    let unit_file = capture.folder.join(folder).join(UNIT);
    let wrong = |file: &Path, reason: String| {
        let expected = "grey PNG pictures of 8 or 16 bits, EXR pictures or NumPy arrays [H, W] of float16 or float32, and beside them `depth.json` \
                        with scene units per level, {\"scale\": 0.001}, or {\"relative\": \"depth\"} or {\"relative\": \"disparity\"}";
        let detail = format!("{reason}. Expected {expected}; `--effects=-depth-supervision` does without");
        CaptureError::content(file, detail)
    };
    let stated = json::read(&unit_file, LARGEST_TEXT, |reason| wrong(&unit_file, reason))?;
    let points = match stated {
        Stated::Scale { scale } if !(scale > 0.0 && scale.is_finite()) => {
            return Err(wrong(&unit_file, format!("`scale` is {scale}, expected a number above 0")));
        }
        Stated::Scale { .. } => Vec::new(),
        Stated::Relative { .. } => from_tracks(capture, views),
    };
    let found = find(capture);
    let of_view = |(i, &view): (usize, &usize)| {
        let Some(file) = &found[view] else { return Ok((Vec::new(), None)) };
        let mut map = depth_maps::load(file).map_err(|reason| wrong(file, reason.to_string()))?;
        let (unit, solved) = match stated {
            Stated::Scale { scale } => (scale, Ok(())),
            Stated::Relative { relative } => (1.0, relative.solve(&mut map, &points[i])),
        };
        let refused = solved.err().map(|reason| format!("{}: {reason}", capture.views[view].name));
        Ok((if refused.is_none() { samples(&map, unit) } else { Vec::new() }, refused))
    };
    let read = views.par_iter().enumerate().map(of_view).collect::<Result<Vec<_>, _>>()?;
    let (samples, refused): (Vec<_>, Vec<Option<String>>) = read.into_iter().unzip();
    if let Some(first) = refused.iter().flatten().next() {
        let count = refused.iter().flatten().count();
        let maps = views.iter().filter(|&&view| found[view].is_some()).count();
        let said = format!("{count} of {maps} depth maps have no scale and shift: {first}");
        if samples.iter().all(Vec::is_empty) {
            return Err(wrong(&unit_file, said));
        }
        note(&said);
    }
    Ok(Some(samples))
}

/// The known depths of a map of camera z, evenly spaced; a level has `unit` scene units.
fn samples(map: &DepthMap, unit: f64) -> Vec<DepthSample> {
    let (width, height) = (map.width() as f32, map.height() as f32);
    let sample = |(x, y, depth): (u32, u32, &image::Luma<f32>)| DepthSample {
        at: [(x as f32 + 0.5) / width, (y as f32 + 0.5) / height],
        depth: (f64::from(depth.0[0]) * unit) as f32,
    };
    let known = map.enumerate_pixels().filter(|(.., depth)| depth.0[0].is_finite() && depth.0[0] > 0.0);
    known.step_by(map.len().div_ceil(MOST_SAMPLES)).map(sample).collect()
}

/// Largest accepted size of `depth.json`, bytes.
const LARGEST_TEXT: u64 = 1 << 16;

/// Largest number of samples of a depth map.
const MOST_SAMPLES: usize = 16_384;

/// Least depth of a sample, in medians of all depths. The error is relative to the depth, so that one level above zero, where a map means that
/// nothing is known, would outweigh the whole picture.
const LEAST_OF_MEDIAN: f64 = 0.01;

/// Indices of pixels, row-major, ascending, and their depths, `[M]` each.
type KnownPixels = (Tensor<1, Int>, Tensor<1>);

/// The known depths of a run.
pub struct Depths {
    config: DepthConfig,
    samples: Vec<Vec<DepthSample>>,
    /// For the size of the pictures.
    on_device: Vec<Option<([usize; 2], KnownPixels)>>,
    device: Device,
}

impl Depths {
    /// The known depths, one list for each photograph.
    pub fn new(config: DepthConfig, mut samples: Vec<Vec<DepthSample>>, device: &Device) -> Self {
        let usable = |sample: &DepthSample| {
            sample.depth > 0.0 && sample.depth.is_finite() && sample.at.iter().all(|at| (0.0..1.0).contains(at))
        };
        samples.iter_mut().for_each(|list| list.retain(usable));
        let mut depths: Vec<f64> = samples.iter().flatten().map(|sample| f64::from(sample.depth)).collect();
        let least = LEAST_OF_MEDIAN * quantile(&mut depths, 0.5).unwrap_or_default();
        samples.iter_mut().for_each(|list| list.retain(|sample| f64::from(sample.depth) >= least));
        let on_device = samples.iter().map(|_| None).collect();
        Self { config, samples, on_device, device: device.clone() }
    }

    /// Whether a view's depth must be rendered: the step is supervised, and the photograph has known depths.
    fn supervises(&self, at: EffectContext) -> bool {
        at.step.is_multiple_of(self.config.every.max(1))
            && self.samples.get(at.view).is_some_and(|samples| !samples.is_empty())
    }

    /// The loss of a supervised view, `[1]`, from the render's accumulated depth and alpha, `[H, W, 1]` each.
    fn miss(&mut self, depth: Tensor<3>, alpha: Tensor<3>, at: EffectContext) -> Option<Tensor<1>> {
        if !self.supervises(at) {
            return None;
        }
        let EffectContext { view, step, steps, .. } = at;
        let weight = self.config.weight.at(step, steps) * self.config.every.max(1) as f64;
        let samples = &self.samples[view];
        let [height, width, _] = depth.dims();
        let size = [width, height];
        let kept = &mut self.on_device[view];
        if kept.as_ref().is_none_or(|kept| kept.0 != size) {
            *kept = Some((size, on_device(samples, size, &self.device)));
        }
        let (_, (pixels, depths)) = kept.as_ref()?;
        let miss = depth_miss(&depth, &alpha, depths, pixels).expect("depth and alpha of one render, on one device");
        Some(miss * weight)
    }
}

/// Known depths do not change, so there is no state to save.
impl Effect for Depths {
    fn name(&self) -> &'static str {
        EffectKind::DepthSupervision.name()
    }

    fn before(&mut self, input: &mut RenderInput, _: &Gaussians, at: EffectContext) {
        input.options = input.options.with_depth(input.options.depth || self.supervises(at));
    }

    fn penalty(&mut self, _: &RenderInput, picture: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        self.miss(picture.depth.clone()?, picture.alpha.clone(), at)
    }
}

/// The pixels that hold the samples in a picture of a size.
fn on_device(samples: &[DepthSample], [width, height]: [usize; 2], device: &Device) -> KnownPixels {
    let pixel = |sample: &DepthSample| {
        let along = |share: f32, side: usize| ((share * side as f32) as usize).min(side - 1);
        (along(sample.at[1], height) * width + along(sample.at[0], width)) as i32
    };
    let mut known: Vec<(i32, f32)> = samples.iter().map(|sample| (pixel(sample), sample.depth)).collect();
    known.sort_by_key(|&(pixel, _)| pixel);
    let (pixels, depths): (Vec<i32>, Vec<f32>) = known.into_iter().unzip();
    (Tensor::from_data(&pixels[..], (device, DType::I32)), Tensor::from_floats(&depths[..], device))
}

#[cfg(test)]
mod tests;
