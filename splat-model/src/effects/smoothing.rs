//! The 3D smoothing filter of Mip-Splatting (Yu et al. 2024, section 5.1): no Gaussian is finer than the sampling of the photographs.
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
use glam::DAffine3;
use splat_op::argsort::argsort_floats;
use splat_op::smooth::smoothed;
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, Splats, project};

use super::{Effect, EffectContext, EffectKind, RenderInput};
use crate::density::counts;
use crate::gaussians::{GaussianRows, Gaussians, values_of};
use crate::state::{State, StateError};

/// Variance of the filter as a multiple of the squared sample spacing: 0.2, as in the original.
pub const VARIANCE: f64 = 0.2;

/// Steps between updates of the filter for Gaussians that have moved.
const EVERY: usize = 100;

/// A centre counts as visible up to this share of the picture beyond its border, because its Gaussian may extend into the picture.
const MARGIN: f32 = 0.15;

/// Share of the seen centres that are sampled less than one that no camera sees is taken to be.
const COARSE: f64 = 0.1;

/// The smoothing filter of a run.
pub struct Smoothing {
    cameras: Vec<(Intrinsics, DAffine3)>,
    /// `[N, 1]`: `ln g` of the current Gaussians, and `g`.
    widths: Option<[Tensor<2>; 2]>,
    /// The step at which the widths were computed.
    found_at: usize,
}

impl Smoothing {
    /// A filter for photographs of these cameras.
    pub fn new<'a>(cameras: impl IntoIterator<Item = (&'a Intrinsics, &'a DAffine3)>) -> Self {
        let cameras = cameras.into_iter().map(|(intrinsics, pose)| (*intrinsics, *pose)).collect();
        Self { cameras, widths: None, found_at: 0 }
    }

    /// `[N]`: samples per scene unit at these centres, `[N, 3]`, in the photograph that has most. Zero if no camera sees a centre.
    fn rates(&self, means: &Tensor<2>) -> Tensor<1> {
        let ([count, _], device) = (means.dims(), means.device());
        // Points: the stage culls those behind a camera and outside the domain of its lens, and no others.
        let splats = Splats {
            means: means.clone(),
            rotations: Tensor::<2>::ones([count, 4], &device),
            scales: means.zeros_like(),
            opacities: Tensor::ones([count], &device),
            colour: Colour::Features(means.zeros_like()),
        };
        let options = RenderOptions::standard().with_near(0.0);
        self.cameras.iter().fold(Tensor::zeros([count], &device), |most: Tensor<1>, (intrinsics, pose)| {
            let camera = Camera::new(*intrinsics, pose, &device);
            let seen =
                project(&splats, &camera, &Extras::default(), &options).expect("centres are `[N, 3]`").ellipses();
            let half = [intrinsics.width, intrinsics.height].map(|side| 0.5 * side as f32);
            let [half, reach] = [1.0, 1.0 + 2.0 * MARGIN]
                .map(|share| Tensor::<1>::from_floats(half.map(|half| half * share), &device).unsqueeze::<2>());
            let off_centre = ((seen.mean2d - half) / reach).abs().max_dim(1).squeeze_dim::<1>(1);
            let shown = off_centre.lower_equal_elem(1.0).bool_and(seen.depth.clone().greater_elem(0.0));
            let focal_px = (intrinsics.fx * intrinsics.fy).sqrt();
            most.max_pair((seen.depth.recip() * focal_px).mask_fill(shown.bool_not(), 0.0))
        })
    }

    /// `[N, 1]`: logarithms of the filter's standard deviations at these centres, `[N, 3]`, scene units. A centre that no camera sees gets
    /// the filter that a tenth of the others exceed. (The widest in the original: that of one Gaussian far away would hide the scene.)
    pub fn ln_widths(&self, means: &Tensor<2>) -> Tensor<2> {
        let rows = means.dims()[0];
        if rows == 0 {
            return means.clone().narrow(1, 0, 1);
        }
        let rates = self.rates(means);
        let unseen = rates.clone().equal_elem(0.0);
        let [hidden] = counts([unseen.clone()]);
        let rates = match rows - hidden {
            0 => rates.ones_like(),
            seen => {
                // Those that no camera sees come first.
                let at = hidden + (COARSE * (seen - 1) as f64).round() as usize;
                let coarsest = rates.clone().select(0, argsort_floats(rates.clone()).narrow(0, at, 1));
                rates.mask_where(unseen, coarsest.expand([rows]))
            }
        };
        (rates.log().neg() + 0.5 * VARIANCE.ln()).unsqueeze_dim(1)
    }

    /// Computes the widths again if they were discarded or a hundred steps have passed.
    fn follow(&mut self, gaussians: &Gaussians, step: usize) {
        if self.widths.is_some() && step < self.found_at + EVERY {
            return;
        }
        self.set(self.ln_widths(&gaussians.untracked().means()));
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
        let means = Tensor::<1>::from_floats(rows.means.as_flattened(), &Device::flex());
        let widths = values_of(self.ln_widths(&means.reshape([rows.len(), 3])));
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
