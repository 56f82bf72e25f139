//! The 3D smoothing filter of Mip-Splatting (Yu et al. 2024, section 5.1): no Gaussian is finer than the sampling of the
//! photographs.
//!
//! A camera samples a point at depth `z` with `f/z` samples per scene unit. The camera with the highest rate,
//! `ν = max f/z`, shows the most detail of a Gaussian. The Gaussian is convolved with an isotropic Gaussian of variance
//! `s/ν²`, `s = 0.2`: its variances become `σ² + s/ν²`, and its opacity is multiplied by `√(|Σ|/|Σ′|)`, so that its
//! integral stays the same. From closer than in training, the scene then shows no needles that no photograph showed.
//!
//! [`splat_op::smooth`] has the equations.
//!
//! The filter is part of the render. A file holds Gaussians that are already convolved, as other viewers expect.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use splat_op::smooth::smoothed;
use splat_op::{Intrinsics, Projector, Splats};

use super::{Effect, EffectContext, EffectKind, RenderInput};
use crate::gaussians::{GaussianRows, Gaussians, values_of};
use crate::quantile::quantile;
use crate::state::{State, StateError};

/// Variance of the filter as a multiple of the squared sample spacing: 0.2, as in the original.
pub const VARIANCE: f64 = 0.2;

/// Steps between updates of the filter for Gaussians that have moved.
const EVERY: usize = 100;

/// A centre counts as visible up to this share of the picture beyond its border, because its Gaussian may extend into the
/// picture.
const MARGIN: f64 = 0.15;

/// Share of the seen centres that are sampled less than one that no camera sees is taken to be.
const COARSE: f64 = 0.1;

struct Sampler {
    projector: Projector,
    cam_from_world: DAffine3,
    size: [f64; 2],
    /// Pixels per unit of slope.
    focal_px: f64,
}

impl Sampler {
    /// Samples per scene unit at a point. Zero if the camera does not see it.
    fn rate(&self, world: DVec3) -> f64 {
        let cam = self.cam_from_world.transform_point3(world);
        let inside = |px: f64, size: f64| (-MARGIN * size..=(1.0 + MARGIN) * size).contains(&px);
        match self.projector.px_from_cam(cam) {
            Some(px) if inside(px.x, self.size[0]) && inside(px.y, self.size[1]) => self.focal_px / cam.z,
            _ => 0.0,
        }
    }
}

/// The smoothing filter of a run.
pub struct Smoothing {
    cameras: Vec<Sampler>,
    /// `[N, 1]`: `ln g` of the current Gaussians, and `g`.
    widths: Option<[Tensor<2>; 2]>,
    /// The step at which the widths were computed.
    found_at: usize,
}

impl Smoothing {
    /// A filter for photographs of these cameras.
    pub fn new<'a>(cameras: impl IntoIterator<Item = (&'a Intrinsics, &'a DAffine3)>) -> Self {
        let sampler = |(intrinsics, cam_from_world): (&Intrinsics, &DAffine3)| Sampler {
            projector: intrinsics.projector(),
            cam_from_world: *cam_from_world,
            size: [intrinsics.width as f64, intrinsics.height as f64],
            focal_px: (intrinsics.fx * intrinsics.fy).sqrt(),
        };
        Self { cameras: cameras.into_iter().map(sampler).collect(), widths: None, found_at: 0 }
    }

    /// Logarithms of the filter's standard deviations at these centres, scene units. A centre that no camera sees gets the
    /// filter that a tenth of the others exceed. (The widest in the original: that of one Gaussian far away would hide the scene.)
    pub fn ln_widths(&self, means: &[[f32; 3]]) -> Vec<f32> {
        let rate = |mean: &[f32; 3]| {
            let world = Vec3::from_array(*mean).as_dvec3();
            self.cameras.iter().map(|camera| camera.rate(world)).fold(0.0, f64::max)
        };
        let rates: Vec<f64> = means.par_iter().map(rate).collect();
        let mut seen: Vec<f64> = rates.iter().copied().filter(|rate| *rate > 0.0).collect();
        let coarsest = quantile(&mut seen, COARSE).unwrap_or(1.0);
        let ln_width = |rate: f64| (0.5 * VARIANCE.ln() - if rate > 0.0 { rate } else { coarsest }.ln()) as f32;
        rates.into_iter().map(ln_width).collect()
    }

    /// Computes the widths again if they were discarded or a hundred steps have passed.
    fn follow(&mut self, gaussians: &Gaussians, step: usize) {
        if self.widths.is_some() && step < self.found_at + EVERY {
            return;
        }
        let means = gaussians.means().inner();
        let device = means.device();
        let rows = values_of(means);
        let widths = self.ln_widths(rows.as_chunks::<3>().0);
        self.set(Tensor::<1>::from_floats(widths.as_slice(), &device).unsqueeze_dim(1));
        self.found_at = step;
    }

    fn set(&mut self, ln_widths: Tensor<2>) {
        let widths = ln_widths.clone().exp();
        self.widths = Some([ln_widths, widths]);
    }

    /// The convolved Gaussians. Differentiable.
    fn apply(&self, splats: Splats) -> Splats {
        let Some([_, widths]) = self.widths.clone() else { return splats };
        let widths = if splats.scales.is_autodiff() { Tensor::from_inner(widths) } else { widths };
        let (scales, opacities) =
            smoothed(&splats.scales, &splats.opacities, &widths).expect("a width for each Gaussian");
        Splats { scales, opacities, ..splats }
    }
}

impl Effect for Smoothing {
    fn name(&self) -> &'static str {
        EffectKind::Antialias.name()
    }

    fn before(&mut self, input: &mut RenderInput, gaussians: &Gaussians, at: EffectContext) {
        self.follow(gaussians, at.step);
        input.splats = self.apply(input.splats.clone());
    }

    fn forget_rows(&mut self) {
        self.widths = None;
    }

    /// The widths are saved because they were computed some steps ago.
    fn save(&self, to: &mut State) -> Result<(), StateError> {
        if let Some([ln_widths, _]) = &self.widths {
            to.put("ln_widths", ln_widths.clone());
        }
        to.tell("found_at", &self.found_at)
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.widths = None;
        if from.has("ln_widths") {
            self.set(from.take("ln_widths", device)?);
        }
        self.found_at = from.told("found_at")?;
        Ok(())
    }

    fn bake(&self, rows: &mut GaussianRows) {
        let widths = self.ln_widths(&rows.means);
        let of_row = rows.log_scales.iter_mut().zip(&mut rows.logit_opacities).zip(widths);
        for ((log_scales, logit), ln_width) in of_row {
            // An unusable Gaussian stays unchanged.
            if !(log_scales.iter().all(|scale| scale.is_finite()) && logit.is_finite()) {
                continue;
            }
            let mut ln_share = 0.0;
            for log_scale in log_scales {
                let grown = 0.5 * softplus(2.0 * (f64::from(ln_width) - f64::from(*log_scale)));
                ln_share -= grown;
                *log_scale = (f64::from(*log_scale) + grown) as f32;
            }
            *logit = logit_of_share(f64::from(*logit), ln_share) as f32;
        }
    }
}

/// `ln(1 + eˣ)`.
fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The logit of `σ(logit) · exp(ln_share)`, for shares up to 1: with `y = ln σ(logit) + ln_share` it is `y − ln(1 − eʸ)`.
fn logit_of_share(logit: f64, ln_share: f64) -> f64 {
    if ln_share == 0.0 {
        return logit;
    }
    let y = -softplus(-logit) + ln_share;
    y - (-y.exp_m1()).ln()
}

#[cfg(test)]
mod tests;
