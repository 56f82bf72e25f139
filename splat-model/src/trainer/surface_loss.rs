//! A loss for scenes whose surfaces matter.

use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Bool, Tensor};
use splat_op::{RenderOptions, mixed};

use super::{Loss, LossInputs};
use crate::effects::masks;
use crate::loss::photometric;
use crate::loss::surface::{PixelRays, thickness};

/// Number of cameras whose rays are kept: a capture has few, but some have one for each photograph.
const CAMERAS: usize = 8;

/// L1 + D-SSIM with the losses of [`surface`](crate::loss::surface): a scene whose depth is smooth, for meshes.
#[derive(Clone, Debug)]
pub struct SurfaceLoss {
    /// Share of D-SSIM in the photometric loss.
    pub lambda: f64,
    /// Weight of [`PixelRays::normal_consistency`]; 0.05 in 2D Gaussian Splatting.
    pub consistency: f64,
    /// Weight of [`thickness`].
    pub flatness: f64,
    /// First step with normals, which say little before there are surfaces.
    pub from: usize,
    /// Of the cameras met so far.
    rays: Vec<PixelRays>,
}

impl SurfaceLoss {
    /// Creates the loss of a run of `steps` steps: with normals after a quarter, as in 2D Gaussian Splatting.
    pub fn new(lambda: f64, steps: usize) -> Self {
        Self { lambda, consistency: 0.05, flatness: 0.01, from: steps / 4, rays: Vec::new() }
    }

    fn rays(&mut self, seen: &LossInputs) -> &PixelRays {
        let intrinsics = &seen.input.camera.intrinsics;
        let known = self.rays.iter().position(|rays| rays.intrinsics() == intrinsics);
        let at = known.unwrap_or_else(|| {
            if self.rays.len() == CAMERAS {
                self.rays.remove(0);
            }
            self.rays.push(PixelRays::new(intrinsics, &seen.image.clone().inner().device()));
            self.rays.len() - 1
        });
        &self.rays[at]
    }
}

impl Loss for SurfaceLoss {
    fn outputs(&self, options: RenderOptions, step: usize) -> RenderOptions {
        let on = step >= self.from;
        options.with_depth(on || options.depth).with_normals(on || options.normals)
    }

    fn loss(&mut self, seen: &LossInputs) -> Tensor<1> {
        let mut loss = photometric(seen.image.clone(), seen.truth, self.lambda)
            + thickness(seen.input.splats.scales.clone()) * self.flatness;
        if let (Some(depth), Some(normals), true) = (&seen.depth, &seen.normals, seen.step >= self.from) {
            let rotation = seen.input.camera.cam_from_world.clone().narrow(1, 0, 3).detach();
            let normals = mixed(rotation, normals.clone().permute([2, 0, 1])).permute([1, 2, 0]);
            let mean_depth = depth.clone() / seen.alpha.clone().clamp_min(1e-3);
            let unsure = seen.excluded.map(widened);
            let [normals, alpha] = [normals, seen.alpha.clone()].map(|of| masks::cleared(of, unsure.as_ref()));
            let consistency = self.rays(seen).normal_consistency(normals, mean_depth, alpha);
            loss = loss + consistency * self.consistency;
        }
        loss
    }
}

/// The pixels that are excluded, `[1, H, W]`, and those beside them: their normals from depth take that of excluded pixels.
fn widened(excluded: &Tensor<3, Bool>) -> Tensor<3, Bool> {
    let around = MaxPoolOptions::new([3, 3]).with_stride([1, 1]).with_padding([1, 1]);
    max_pool2d(excluded.clone().float().unsqueeze_dim::<4>(0), around).squeeze_dim::<3>(0).greater_elem(0.5)
}

#[cfg(test)]
mod tests;
