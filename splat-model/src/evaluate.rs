//! Scores of a scene on held-out photographs.

use std::borrow::Borrow;

use burn::tensor::{Bool, Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};
use splat_op::{RenderOptions, SplatError, Splats};

use crate::capture::Photo;
use crate::effects::background::Background;
use crate::gaussians::values_of;
use crate::metrics::lpips::Lpips;
use crate::metrics::{colour_corrected, mean_over_views, psnr, scores_without, ssim};

/// The reason for a missing LPIPS when it was not requested.
const NO_WEIGHTS: &str = "no weights were named (`--lpips FILE`)";

/// Scores of one photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    /// Name of the photograph.
    pub name: String,
    /// Peak signal-to-noise ratio, dB.
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
    /// PSNR after the affine map of colours that fits the render to the photograph best (see [`colour_corrected`]), dB.
    pub psnr_corrected: f64,
    /// SSIM after the same correction.
    pub ssim_corrected: f64,
    /// LPIPS, lower is better (see [`crate::metrics::lpips`]); `None` if it was not measured.
    pub lpips: Option<f64>,
    /// The reason why LPIPS was not measured.
    pub lpips_missing: Option<String>,
}

/// Scores of a set of photographs: the means over them, and the scores of each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Mean of the views' PSNR, dB.
    pub psnr: f64,
    /// Mean of the views' SSIM.
    pub ssim: f64,
    /// Mean of the views' PSNR after colour correction, dB.
    pub psnr_corrected: f64,
    /// Mean of the views' SSIM after colour correction.
    pub ssim_corrected: f64,
    /// Mean of the views' LPIPS; `None` unless all views were measured, because a mean over some views is not comparable.
    pub lpips: Option<f64>,
    /// The reason why there is no mean.
    pub lpips_missing: Option<String>,
    /// The network of LPIPS, `alex` or `vgg`; `None` without weights.
    pub lpips_net: Option<String>,
    /// Scores of each view.
    pub views: Vec<ViewScore>,
}

/// A photograph and the scene's render of it, `[H, W, 3]` each, without autodiff.
pub struct Comparison<'a> {
    /// The photograph.
    pub photo: &'a Photo,
    /// The photograph as a tensor, composited over the background.
    pub truth: Tensor<3>,
    /// The render, clamped to 0..1.
    pub image: Tensor<3>,
}

/// Renders `splats`, which must not be tracked, with each photograph's camera, scores the renders and passes each to `look`.
/// Pixels that a photograph's mask excludes do not affect the scores.
///
/// # Errors
/// If the renderer refuses the scene.
pub fn evaluate(
    splats: &Splats,
    photos: &[Photo],
    background: &Background,
    options: &RenderOptions,
    look: impl FnMut(&Comparison, &ViewScore),
) -> Result<Scores, SplatError> {
    evaluate_each(splats, photos.iter().map(Ok::<_, SplatError>), background, options, None, look)
}

/// Evaluates like [`evaluate`], with photographs that are loaded one after the other, and with LPIPS if there are weights for it.
///
/// # Errors
/// If a photograph cannot be loaded, or the renderer refuses the scene.
pub fn evaluate_each<P: Borrow<Photo>, E: From<SplatError>>(
    splats: &Splats,
    photos: impl IntoIterator<Item = Result<P, E>>,
    background: &Background,
    options: &RenderOptions,
    lpips: Option<&Lpips>,
    mut look: impl FnMut(&Comparison, &ViewScore),
) -> Result<Scores, E> {
    let device: Device = splats.means.device();
    let mut views = Vec::new();
    for photo in photos {
        let photo = photo?;
        let photo: &Photo = photo.borrow();
        let image =
            background.render(splats, &photo.intrinsics, &photo.cam_from_world, options)?.colour.clamp(0.0, 1.0);
        let comparison = Comparison { photo, truth: photo.rgb_over(background.colour(), &device), image };
        let (psnr, ssim) = scored(&comparison, comparison.image.clone());
        let (psnr_corrected, ssim_corrected) = scored(&comparison, corrected(&comparison));
        let (lpips, lpips_missing) = match perceived(lpips, &comparison) {
            Ok(lpips) => (Some(lpips), None),
            Err(reason) => (None, Some(reason)),
        };
        let name = photo.name.clone();
        let score = ViewScore { name, psnr, ssim, psnr_corrected, ssim_corrected, lpips, lpips_missing };
        look(&comparison, &score);
        views.push(score);
    }
    let perceived: Option<Vec<f64>> = views.iter().map(|view| view.lpips).collect();
    let mean_lpips = perceived.filter(|values| !values.is_empty()).map(|values| mean_over_views(&values));
    let mean = |of: fn(&ViewScore) -> f64| mean_over_views(&views.iter().map(of).collect::<Vec<_>>());
    Ok(Scores {
        psnr: mean(|view| view.psnr),
        ssim: mean(|view| view.ssim),
        psnr_corrected: mean(|view| view.psnr_corrected),
        ssim_corrected: mean(|view| view.ssim_corrected),
        lpips: mean_lpips,
        lpips_missing: missing_lpips(lpips, &views),
        lpips_net: lpips.map(|lpips| lpips.net().name().to_owned()),
        views,
    })
}

/// PSNR and SSIM of `image` as a render of the photograph.
fn scored(comparison: &Comparison, image: Tensor<3>) -> (f64, f64) {
    let truth = comparison.truth.clone();
    let Some(mask) = &comparison.photo.mask else { return (psnr(image.clone(), truth.clone()), ssim(image, truth)) };
    let [height, width, _] = image.dims();
    let excluded: Vec<bool> = mask.iter().map(|counts| !counts).collect();
    let excluded = Tensor::<3, Bool>::from_data(TensorData::new(excluded, [1, height, width]), &image.device());
    scores_without(image, truth, &excluded)
}

/// LPIPS of the render, or the reason why it is not measured.
fn perceived(lpips: Option<&Lpips>, comparison: &Comparison) -> Result<f64, String> {
    let lpips = lpips.ok_or(NO_WEIGHTS)?;
    if comparison.photo.mask.as_ref().is_some_and(|mask| mask.contains(&false)) {
        return Err("a mask excludes a part of the photograph, and features of LPIPS extend across its border".into());
    }
    let found = lpips.distance(comparison.image.clone(), comparison.truth.clone());
    let found = found.map_err(|error| error.to_string())?;
    // JSON would hold null, without a reason.
    if found.is_finite() { Ok(found) } else { Err("the render is not finite".into()) }
}

/// The reason why there is no mean of the views' LPIPS; `None` if there is one.
fn missing_lpips(lpips: Option<&Lpips>, views: &[ViewScore]) -> Option<String> {
    if lpips.is_none() {
        return Some(NO_WEIGHTS.into());
    }
    if views.is_empty() {
        return Some("there are no views".into());
    }
    let mut missing = views.iter().filter_map(|view| Some((&view.name, view.lpips_missing.as_ref()?)));
    let (name, reason) = missing.next()?;
    let count = 1 + missing.count();
    Some(format!("{count} of {} views cannot be measured; {name}: {reason}", views.len()))
}

fn corrected(comparison: &Comparison) -> Tensor<3> {
    let (image, truth) = (values_of(comparison.image.clone()), values_of(comparison.truth.clone()));
    let values = colour_corrected(&image, &truth, comparison.photo.mask.as_deref());
    Tensor::from_data(TensorData::new(values, comparison.image.dims()), &comparison.image.device())
}

#[cfg(test)]
mod tests;
