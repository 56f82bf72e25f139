//! What each Gaussian contributes to pictures.
//!
//! The colour of pixel `p` is `Cₚ = Σᵢ wᵢₚ cᵢ` with the blending weights `w`. With a map `m` of the pixels and `cᵢ` a feature,
//! `∂/∂cᵢ Σₚ mₚ Cₚ = Σₚ mₚ wᵢₚ`. One render with its backward pass, in which only the features are tracked, so gives the weights of
//! all Gaussians, summed with any maps.

use burn::tensor::{Device, Tensor};
use glam::{DAffine3, DVec3};
use splat_op::{Camera, Colour, Extras, Intrinsics, RenderOptions, SplatError, Splats, render_view};

use crate::gaussians::{GaussianRows, Gaussians, values_of};

/// Sum of a Gaussian's weights below which it changes no pixel by half a level of 255.
pub const UNSEEN_PX: f32 = 0.5 / 255.0;

/// Opacity of a pixel from which on its depth is that of a surface.
const SURFACE: f32 = 0.5;

/// Largest difference of the depths of a Gaussian and of the surface that it is a part of, relative to the depth.
const SAME_DEPTH: f64 = 0.05;

/// What each Gaussian contributes to the pictures of some cameras.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Contribution {
    /// Covered pixels, weighted by the Gaussian's share in their colours, summed over the pictures.
    pub total_px: Vec<f32>,
    /// The same of the picture with the largest number.
    pub most_px: Vec<f32>,
    /// Whether the Gaussian is the front of a picture: it covers half a pixel or more of the surface, which there is as far away as
    /// its centre. The surface is where the layers of a pixel hide half of what is behind them, at the mean of their depths.
    pub is_front: Vec<bool>,
}

impl Contribution {
    /// Renders the scene with each camera, a picture size and a pose, world frame, and adds up the weights. `seen` is called after
    /// each picture.
    ///
    /// # Errors
    /// If the renderer refuses the scene, a camera or the options.
    ///
    /// # Panics
    /// If the rows do not fit together ([`GaussianRows::check`]).
    pub fn of(
        rows: &GaussianRows,
        cameras: impl IntoIterator<Item = (Intrinsics, DAffine3)>,
        options: &RenderOptions,
        device: &Device,
        mut seen: impl FnMut(),
    ) -> Result<Self, SplatError> {
        let count = rows.len();
        let splats = Gaussians::from_rows(rows, device).expect("rows that fit together").splats();
        let mut found = Self { total_px: vec![0.0; count], most_px: vec![0.0; count], is_front: vec![false; count] };
        for (intrinsics, cam_from_world) in cameras {
            let camera = Camera::new(intrinsics, &cam_from_world, device);
            let weights = weights(&splats, &camera, options)?;
            for (row, &[weight, of_surface, of_depth]) in weights.as_chunks().0.iter().enumerate() {
                found.total_px[row] += weight;
                found.most_px[row] = found.most_px[row].max(weight);
                if of_surface >= 0.5 {
                    let depth = cam_from_world.transform_point3(DVec3::from_array(rows.means[row].map(f64::from))).z;
                    let surface = f64::from(of_depth) / f64::from(of_surface);
                    found.is_front[row] |= (surface - depth).abs() <= SAME_DEPTH * depth;
                }
            }
            seen();
        }
        Ok(found)
    }

    /// Whether no picture shows the Gaussian of this row: it changes no pixel by half a level of 255.
    pub fn is_unseen(&self, row: usize) -> bool {
        self.most_px[row] < UNSEEN_PX
    }
}

/// Returns `[N, 3]`: the sums of each Gaussian's weights over all pixels, over those with a surface, and over these times its depth.
fn weights(splats: &Splats, camera: &Camera, options: &RenderOptions) -> Result<Vec<f32>, SplatError> {
    let device = splats.means.device();
    let count = splats.means.dims()[0];
    if count == 0 {
        return Ok(Vec::new());
    }
    let features = Tensor::<2>::ones([count, 3], &device.autodiff()).require_grad();
    let splats = Splats {
        means: Tensor::from_inner(splats.means.clone()),
        rotations: Tensor::from_inner(splats.rotations.clone()),
        scales: Tensor::from_inner(splats.scales.clone()),
        opacities: Tensor::from_inner(splats.opacities.clone()),
        colour: Colour::Features(features.clone()),
    };
    let picture = render_view(&splats, camera, &Extras::default(), &options.with_depth(true))?;
    let alpha = picture.alpha.inner();
    let is_surface = alpha.clone().greater_equal_elem(SURFACE).float();
    let depth = picture.depth.expect("the options ask for depth").inner() / alpha.clone().clamp_min(SURFACE);
    let maps = Tensor::cat(vec![alpha.ones_like(), is_surface.clone(), depth * is_surface], 2);
    let mut gradients = (picture.colour * Tensor::from_inner(maps)).sum().backward();
    let sums = features.grad_remove(&mut gradients).unwrap_or_else(|| features.inner().zeros_like());
    Ok(values_of(sums))
}
