//! Losses that turn Gaussians into surfaces: rendered normals against those of the rendered depth, and flat Gaussians. A scene trained with
//! them has smoother depth, as meshes and relighting need, and about the same pictures.
//!
//! Sources: Huang et al. 2024, "2D Gaussian Splatting", §4.2 and eq. 14 (normal consistency); Chen et al. 2024, "PGSR", §3.1 (flat
//! Gaussians, there by their thickness in scene units).

use burn::tensor::{Device, Int, Tensor};
use glam::DAffine3;
use splat_op::{CameraModel, Intrinsics};

use super::regularise::mean;
use crate::effects::background::directions_of;

/// Length below which a cross product has no direction. That of a surface that faces the camera is one.
const LEAST_LENGTH: f64 = 1e-3;

/// The rays of a picture's pixels in the camera's frame: the point at depth `z` is `origin + z direction`.
#[derive(Clone, Debug)]
pub struct PixelRays {
    intrinsics: Intrinsics,
    /// `[3, H, W]`; absent if all are zero.
    origin: Option<Tensor<3>>,
    /// `[3, H, W]`, z is one.
    direction: Tensor<3>,
    /// `[1, H, W]`: one where a ray leads forwards, else zero.
    seen: Tensor<3>,
}

impl PixelRays {
    /// Computes the rays of a camera of any model, on the host.
    pub fn new(intrinsics: &Intrinsics, device: &Device) -> Self {
        let &Intrinsics { width, height, fx, fy, cx, cy, .. } = intrinsics;
        let rays = directions_of(intrinsics, &DAffine3::IDENTITY, device);
        let z = rays.clone().narrow(0, 2, 1);
        let unseen = z.clone().lower_equal_elem(1e-3);
        let across = |side: usize, centre: f64, focal: f64| {
            (Tensor::<1, Int>::arange(0..side as i64, device).float() + (0.5 - centre)) / focal
        };
        let size = [1, height, width];
        let origin = || {
            let x = across(width, cx, fx).reshape([1, 1, width]).expand(size);
            let y = across(height, cy, fy).reshape([1, height, 1]).expand(size);
            Tensor::cat(vec![x, y, Tensor::zeros(size, device)], 0)
        };
        Self {
            intrinsics: *intrinsics,
            origin: (intrinsics.model == CameraModel::Orthographic).then(origin),
            direction: rays / z.mask_fill(unseen.clone(), 1.0),
            seen: unseen.bool_not().float(),
        }
    }

    /// The camera of the rays.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Returns the unit normals of the surface at the depths `[H, W, 1]`, `H` and `W` at least 3, scene units along the camera's z axis: `[H − 2, W − 2, 3]`, for all
    /// pixels but those at the border, in the camera's frame and towards the camera. Zero where no surface has a direction. Differentiable.
    ///
    /// They are cross products of central differences of the points.
    pub fn normals(&self, depth: Tensor<3>) -> Tensor<3> {
        let [height, width, _] = depth.dims();
        let constant = |planes: &Tensor<3>| constant(planes, &depth);
        let (direction, origin) = (constant(&self.direction), self.origin.as_ref().map(constant));
        let depth = depth.permute([2, 0, 1]);
        // The distance of neighbouring pixels' points, where the surface faces the camera.
        let depth_there = depth.clone().detach().narrow(1, 1, height - 2).narrow(2, 1, width - 2);
        let apart = if self.origin.is_some() { depth_there.ones_like() } else { depth_there };
        let spacing = apart * (2.0 / self.intrinsics.fx);
        let scale = spacing.clone().lower_equal_elem(0.0);
        let scale = spacing.mask_fill(scale.clone(), 1.0).recip().mask_fill(scale, 0.0);
        let mut points = direction * depth;
        if let Some(origin) = origin {
            points = points + origin;
        }
        let along = |dim: usize| {
            let other = 3 - dim;
            let inner = points.clone().narrow(other, 1, [height, width][other - 1] - 2);
            let count = [height, width][dim - 1] - 2;
            (inner.clone().narrow(dim, 2, count) - inner.narrow(dim, 0, count)) * scale.clone()
        };
        let normal = along(1).cross(along(2), 0);
        let length = (normal.clone().square().sum_dim(0) + LEAST_LENGTH * LEAST_LENGTH).sqrt();
        (normal / length).permute([1, 2, 0])
    }

    /// The mean over pixels of `α − n · N`, `[1]`: rendered `normals`, `[H, W, 3]`, not divided by alpha, in the camera's frame, against those of
    /// the mean `depth`, `[H, W, 1]`; `alpha`, `[H, W, 1]`, is a constant. Zero for pictures without inner pixels.
    ///
    /// Equation 14 of 2D Gaussian Splatting, weight 0.05 there.
    pub fn normal_consistency(&self, normals: Tensor<3>, depth: Tensor<3>, alpha: Tensor<3>) -> Tensor<1> {
        let [height, width, _] = depth.dims();
        if height < 3 || width < 3 {
            return normals.sum() * 0.0;
        }
        let inner = |picture: Tensor<3>| picture.narrow(0, 1, height - 2).narrow(1, 1, width - 2);
        let seen = inner(constant(&self.seen, &depth).permute([1, 2, 0]));
        let along = (inner(normals) * self.normals(depth)).sum_dim(2);
        mean((inner(alpha.detach()) - along) * seen)
    }
}

/// A tensor of a plain device as a constant beside another.
fn constant(values: &Tensor<3>, beside: &Tensor<3>) -> Tensor<3> {
    let values = values.clone().cast(beside.dtype());
    if beside.is_autodiff() { Tensor::from_inner(values) } else { values }
}

/// The mean ratio of the shortest to the middle axis of each Gaussian, `[1]`: zero for discs, one for balls and needles. `scales` are standard
/// deviations, `[N, 3]`, positive; their unit does not matter.
pub fn thickness(scales: Tensor<2>) -> Tensor<1> {
    let [a, b, c] = [0, 1, 2].map(|axis| scales.clone().narrow(1, axis, 1));
    let (less, more) = (a.clone().min_pair(b.clone()), a.max_pair(b));
    let middle = less.clone().max_pair(more.min_pair(c.clone()));
    mean(less.min_pair(c) / middle.clamp_min(1e-30))
}

#[cfg(test)]
mod tests;
