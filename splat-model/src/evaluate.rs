//! Scores of a scene on photographs that it was not trained on.

use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::{Camera, Extras, RenderOptions, SplatError, Splats, render};

use crate::capture::Photo;
use crate::metrics::{mean_over_views, psnr, ssim};

/// Scores of one photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    /// Its name.
    pub name: String,
    /// Peak signal-to-noise ratio, dB.
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
}

/// Scores of a set of photographs: the means over them, and each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Mean of the views' PSNR, dB.
    pub psnr: f64,
    /// Mean of the views' SSIM.
    pub ssim: f64,
    /// By view.
    pub views: Vec<ViewScore>,
}

/// A photograph and the scene's render of it, `[H, W, 3]` each, without autodiff.
pub struct Comparison<'a> {
    /// The photograph.
    pub photo: &'a Photo,
    /// It as a tensor, over the background.
    pub truth: Tensor<3>,
    /// What the scene shows there, clamped to 0..1.
    pub image: Tensor<3>,
}

/// Renders `splats`, which must not be tracked, as each photograph's camera sees them, scores the renders and hands each
/// to `look`.
///
/// # Errors
/// If the operation refuses the scene.
pub fn evaluate(
    splats: &Splats,
    photos: &[Photo],
    background: [f32; 3],
    options: &RenderOptions,
    mut look: impl FnMut(&Comparison, &ViewScore),
) -> Result<Scores, SplatError> {
    let device: Device = splats.means.device();
    let mut views = Vec::with_capacity(photos.len());
    for photo in photos {
        let camera = Camera::new(photo.intrinsics, &photo.cam_from_world, &device);
        let extras = Extras { background: Some(Tensor::from_floats(background, &device)), ..Extras::default() };
        let rendered = render(splats, &[camera], &extras, options)?;
        let image = rendered.colour.squeeze_dim::<3>(0).clamp(0.0, 1.0);
        let comparison = Comparison { photo, truth: photo.rgb_over(background, &device), image };
        let score = ViewScore {
            name: photo.name.clone(),
            psnr: psnr(comparison.image.clone(), comparison.truth.clone()),
            ssim: ssim(comparison.image.clone(), comparison.truth.clone()),
        };
        look(&comparison, &score);
        views.push(score);
    }
    let mean = |of: fn(&ViewScore) -> f64| mean_over_views(&views.iter().map(of).collect::<Vec<_>>());
    Ok(Scores { psnr: mean(|view| view.psnr), ssim: mean(|view| view.ssim), views })
}

#[cfg(test)]
mod tests;
