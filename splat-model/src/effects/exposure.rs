//! Exposure and white balance of each photograph: an affine colour map, learned along with the scene.
//!
//! A photograph shows `A c + b` where the scene has colour `c`. Each photograph has its own `A` `[3, 3]` and `b` `[3]`,
//! which start as the identity. The maps are affine as in Rematas et al. 2022 ("Urban Radiance Fields", section 3.3), and
//! per image and trained with Adam as in the original 3D Gaussian splatting code (`exposure_compensation`). The scene's
//! colours and all maps could change together without a change in any render, and they would, because maps learn faster
//! than colours. The mean of the maps is therefore reset to the identity once in as many steps as there are photographs.
//! Without the reset, a render without a map loses up to 5 dB. A weak penalty pulls each map towards the identity and so
//! bounds maps with little evidence.

use burn::tensor::{Device, Gradients, Tensor};
use serde::{Deserialize, Serialize};
use splat_op::{Rendered, colour_map};

use super::centred::Centred;
use super::learned::{EffectContext, Falling};
use super::{Effect, EffectKind, Leaf, RenderInput};
use crate::state::{State, StateError};

/// Options of exposures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExposureConfig {
    /// Learning rate: from 0.01, as in the original code, to 0.001.
    pub rate: Falling,
    /// Weight of `Σ (A − I)² + Σ b²` in the loss: 0.01. For a difference of half a stop between photographs, the penalty is
    /// a hundredth of the loss that the difference itself causes.
    pub weight: f64,
}

impl Default for ExposureConfig {
    fn default() -> Self {
        Self { rate: Falling { from: 0.01, to: 0.001 }, weight: 0.01 }
    }
}

/// The colour maps of all photographs of a run.
pub struct Exposure {
    config: ExposureConfig,
    /// `[3, 4]` each: `A`, and `b` in the last column.
    maps: Centred<2>,
}

impl Exposure {
    /// Identity maps for `views` photographs, on `device`.
    pub fn new(config: ExposureConfig, views: usize, device: &Device) -> Self {
        let identity = Tensor::cat(vec![Tensor::<2>::eye(3, device), Tensor::zeros([3, 1], device)], 1);
        Self { config, maps: Centred::new(identity, views) }
    }

    /// The penalty for a step on `view`, `[1]`.
    fn pull(&mut self, view: usize) -> Tensor<1> {
        let difference = self.maps.tracked(view) - Tensor::from_inner(self.maps.neutral());
        difference.square().sum() * self.config.weight
    }
}

impl Effect for Exposure {
    fn name(&self) -> &'static str {
        EffectKind::Exposure.name()
    }

    /// The result is not clamped: beyond 0 and 1 the gradient leads back.
    fn image(&mut self, image: Tensor<3>, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        apply(&image, &self.maps.tracked(at.view))
    }

    fn penalty(&mut self, _: &RenderInput, _: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        Some(self.pull(at.view))
    }

    fn leaves(&mut self, at: EffectContext) -> Vec<Leaf> {
        vec![self.maps.leaf(at.view)]
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        self.maps.step(gradients, self.config.rate.at(at.step, at.steps), at);
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.maps.save(to)
    }

    fn load(&mut self, from: &mut State, _: &Device) -> Result<(), StateError> {
        self.maps.load(from)
    }
}

/// `A c + b` for every pixel of `image`, `[H, W, 3]`, with `affine` `[3, 4]`. Differentiable in both.
pub fn apply(image: &Tensor<3>, affine: &Tensor<2>) -> Tensor<3> {
    colour_map::apply(image, affine).expect("a render and a map of this effect, on one device")
}

#[cfg(test)]
mod tests;
