//! Exposure and white balance of each photograph: an affine colour map, learned along with the scene.
//!
//! A photograph shows `A c + b` where the scene has colour `c`. Each photograph has its own `A` `[3, 3]` and `b` `[3]`, which start as the
//! identity. The maps are affine as in Rematas et al. 2022 ("Urban Radiance Fields", section 3.3), and per image and trained with Adam as
//! in the original 3D Gaussian splatting code (`exposure_compensation`). The scene's colours and all maps could change together without a
//! change in any render, and they would, because maps learn faster than colours. The mean of the maps is therefore reset to the identity
//! once in as many steps as there are photographs. Without the reset, a render without a map loses up to 5 dB. A weak penalty pulls each
//! map towards the identity and so bounds maps with little evidence.

use burn::tensor::{Device, Tensor};
use splat_op::colour_map;

use super::maps::{ColourMaps, MapKind};
use super::{EffectKind, Falling};

options! {
    /// Options of exposures.
    #[derive(Copy)]
    pub struct ExposureConfig {
        /// Learning rate: from 0.01, as in the original code, to 0.001.
        pub rate: Falling = Falling { from: 0.01, to: 0.001 },
        /// Weight of `Σ (A − I)² + Σ b²` in the loss: 0.01. For a difference of half a stop between photographs, the penalty is
        /// a hundredth of the loss that the difference itself causes.
        pub weight: f64 = 0.01,
    }
}

/// The colour maps of all photographs of a run, `[3, 4]` each: `A`, and `b` in the last column.
pub type Exposure = ColourMaps<2>;

impl Exposure {
    /// Identity maps for `views` photographs, on `device`.
    pub fn new(config: ExposureConfig, views: usize, device: &Device) -> Self {
        let kind = MapKind {
            effect: EffectKind::Exposure,
            rate: config.rate,
            neutral: Tensor::cat(vec![Tensor::<2>::eye(3, device), Tensor::zeros([3, 1], device)], 1),
            apply,
            penalty: |map, neutral| (map - neutral).square().sum(),
            weight: config.weight,
        };
        Self::of_kind(kind, views)
    }
}

/// `A c + b` for every pixel of `image`, `[H, W, 3]`, with `affine` `[3, 4]`. Differentiable in both.
pub fn apply(image: &Tensor<3>, affine: &Tensor<2>) -> Tensor<3> {
    colour_map::apply(image, affine).expect("a render and a map of this effect, on one device")
}

#[cfg(test)]
mod tests;
