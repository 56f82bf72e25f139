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
//! [`splat_op::bilateral`] applies a grid.

use burn::tensor::{Device, Tensor};
use splat_op::bilateral::{self, MAP};

use super::maps::{ColourMaps, MapKind};
use super::{EffectKind, Falling};

/// Grid positions along a side of the picture.
const SIDE: usize = 16;

const LEVELS: usize = 8;

options! {
    /// Options of bilateral grids.
    #[derive(Copy)]
    pub struct GridConfig {
        /// Learning rate: from 0.005 to 0.0005.
        pub rate: Falling = Falling { from: 0.005, to: 0.0005 },
        /// Weight of the mean squared difference between neighbours: 10.
        pub smoothness: f64 = 10.0,
    }
}

/// The grids of all photographs of a run, `[MAP, LEVELS, SIDE, SIDE]` each, levels from dark to bright, then rows and columns of the picture.
pub type Grids = ColourMaps<4>;

impl Grids {
    /// Identity grids for `views` photographs, on `device`.
    pub fn new(config: GridConfig, views: usize, device: &Device) -> Self {
        let diagonal = |entry: usize| if entry.is_multiple_of(5) { 1.0 } else { 0.0 };
        let entries: Vec<f32> = (0..MAP).map(diagonal).collect();
        let identity = Tensor::<1>::from_floats(entries.as_slice(), device).reshape([MAP, 1, 1, 1]);
        let kind = MapKind {
            effect: EffectKind::BilateralGrid,
            rate: config.rate,
            neutral: identity.repeat(&[1, LEVELS, SIDE, SIDE]),
            apply,
            penalty: |grid, _| bilateral::roughness(&grid).expect("a grid of this effect"),
            weight: config.smoothness,
        };
        Self::of_kind(kind, views)
    }
}

/// Maps every pixel of `image`, `[H, W, 3]`, by `grid`, `[12, 8, 16, 16]`. Differentiable in both.
pub fn apply(image: &Tensor<3>, grid: &Tensor<4>) -> Tensor<3> {
    bilateral::slice(image, grid).expect("a render and a grid of this effect, on one device")
}

#[cfg(test)]
mod tests;
