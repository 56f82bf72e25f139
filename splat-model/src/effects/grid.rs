//! Local image processing of a camera: an affine colour map that varies over the picture and with brightness. Each
//! photograph has a bilateral grid (Chen, Paris and Durand 2007) of such maps, learned along with the scene (Wang et al.
//! 2024, "Bilateral Guided Radiance Field Processing", section 4).
//!
//! The grid holds a map `[3, 4]` at each of 16 × 16 positions in the picture and 8 levels of brightness. A pixel uses the
//! map that trilinear interpolation gives at its position and at the luma of the render there (Rec. 601). The gradient
//! flows through the luma too. Grids start as the identity and are smoothed by the mean squared difference of neighbours,
//! with weight 10 as in the authors' code. A grid is the stronger form of an [exposure](super::exposure), which is the same
//! map everywhere. As for exposures, the mean of all grids is reset to the identity.
//!
//! Interpolation is separable: two products with matrices of two non-zero entries per column, then a sum over the levels
//! with hat functions as weights. There is no gather, and no scatter in the backward pass. It takes 96 numbers per pixel,
//! 400 MB per megapixel, and the same again for gradients.

use burn::tensor::{Device, Gradients, Tensor, TensorData};
use serde::{Deserialize, Serialize};
use splat_op::Rendered;

use super::centred::Centred;
use super::learned::{EffectContext, Falling};
use super::{Effect, EffectKind, RenderInput};
use crate::state::{State, StateError};

/// Grid positions along a side of the picture.
const SIDE: usize = 16;

/// Levels of brightness.
const LEVELS: usize = 8;

/// Entries of a colour map.
const MAP: usize = 12;

/// Luma weights of RGB, Rec. 601, as in the paper.
const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// Options of bilateral grids.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GridConfig {
    /// Learning rate: from 0.005 to 0.0005.
    pub rate: Falling,
    /// Weight of the mean squared difference between neighbours: 10.
    pub smoothness: f64,
}

impl Default for GridConfig {
    fn default() -> Self {
        Self { rate: Falling { from: 0.005, to: 0.0005 }, smoothness: 10.0 }
    }
}

/// The grids of all photographs of a run.
pub struct Grids {
    config: GridConfig,
    /// `[MAP, LEVELS, SIDE, SIDE]` each, levels from dark to bright, then rows and columns of the picture.
    grids: Centred<4>,
}

impl Grids {
    /// Identity grids for `views` photographs, on `device`.
    pub fn new(config: GridConfig, views: usize, device: &Device) -> Self {
        let diagonal = |entry: usize| if entry.is_multiple_of(5) { 1.0 } else { 0.0 };
        let entries: Vec<f32> = (0..MAP).map(diagonal).collect();
        let identity = Tensor::<1>::from_floats(entries.as_slice(), device).reshape([MAP, 1, 1, 1]);
        let identity = identity.repeat(&[1, LEVELS, SIDE, SIDE]);
        Self { config, grids: Centred::new(identity, views) }
    }

    /// The smoothness penalty for a step on `view`, `[1]`.
    fn pull(&mut self, view: usize) -> Tensor<1> {
        roughness(self.grids.tracked(view)) * self.config.smoothness
    }
}

impl Effect for Grids {
    fn name(&self) -> &'static str {
        EffectKind::BilateralGrid.name()
    }

    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        apply(image, self.grids.tracked(at.view))
    }

    fn penalty(&mut self, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        Some(self.pull(at.view))
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        self.grids.step(gradients, self.config.rate.at(at.step, at.steps), at);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.grids.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.grids.load(from)
    }
}

/// The mean squared difference between neighbours in a grid, over levels, rows and columns, `[1]`.
fn roughness(grid: Tensor<4>) -> Tensor<1> {
    let along = |dim: usize, count: usize| {
        let difference = grid.clone().narrow(dim, 1, count - 1) - grid.clone().narrow(dim, 0, count - 1);
        difference.square().mean()
    };
    along(1, LEVELS) + along(2, SIDE) + along(3, SIDE)
}

/// `[SIDE, pixels]`: the interpolation weight of each grid position for each pixel along a side. The ends of the grid are
/// at the ends of the picture.
fn hats(pixels: usize, device: &Device) -> Tensor<2> {
    let mut values = vec![0.0_f32; SIDE * pixels];
    for pixel in 0..pixels {
        let at = (pixel as f64 + 0.5) / pixels as f64 * (SIDE - 1) as f64;
        let below = (at as usize).min(SIDE - 2);
        let share = (at - below as f64) as f32;
        values[below * pixels + pixel] = 1.0 - share;
        values[(below + 1) * pixels + pixel] = share;
    }
    Tensor::from_data(TensorData::new(values, [SIDE, pixels]), device)
}

/// Maps every pixel of `image`, `[H, W, 3]`, by `grid`, `[12, 8, 16, 16]`. Differentiable in both.
pub fn apply(image: Tensor<3>, grid: Tensor<4>) -> Tensor<3> {
    let [height, width, channels] = image.dims();
    let plain = image.device().inner();
    let constant = |values: Tensor<2>| if grid.is_autodiff() { Tensor::from_inner(values) } else { values };
    let (across, down) = (constant(hats(width, &plain)), constant(hats(height, &plain)));
    // Columns: [12·8·16, 16] × [16, W]. Rows: [H, 16] × [16, 12·8·W].
    let columns = grid.clone().reshape([MAP * LEVELS * SIDE, SIDE]).matmul(across).reshape([MAP * LEVELS, SIDE, width]);
    let columns = columns.permute([1, 0, 2]).reshape([SIDE, MAP * LEVELS * width]);
    let maps = down.transpose().matmul(columns).reshape([height, MAP, LEVELS, width]);
    // [H, 3, W]: rows of planes, in the layout of the maps.
    let colours = image.permute([0, 2, 1]);
    let luma = Tensor::<1>::from_floats(LUMA, &plain).reshape([1, channels, 1]);
    let luma = if colours.is_autodiff() { Tensor::from_inner(luma) } else { luma };
    let luma = (colours.clone() * luma).sum_dim(1).clamp(0.0, 1.0) * (LEVELS - 1) as f32;
    let part = |level: usize| {
        let share = ((luma.clone() - level as f32).abs().neg() + 1.0).clamp_min(0.0);
        maps.clone().narrow(2, level, 1).reshape([height, MAP, width]) * share
    };
    let map = (0..LEVELS).map(part).reduce(|a, b| a + b);
    let map = map.expect("there are levels").reshape([height, channels, channels + 1, width]);
    let linear = map.clone().narrow(2, 0, channels) * colours.unsqueeze_dim::<4>(1);
    let shown = linear.sum_dim(2) + map.narrow(2, channels, 1);
    shown.reshape([height, channels, width]).permute([0, 2, 1])
}

#[cfg(test)]
mod tests;
