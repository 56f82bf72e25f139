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
mod tests {
    use burn::tensor::{Distribution, Int, TensorData};

    use super::*;
    use crate::gaussians::values_of;

    fn picture(device: &Device) -> Tensor<3> {
        Tensor::random([7, 5, 3], Distribution::Uniform(0.0, 1.0), device)
    }

    /// Gains and offsets that a photograph might have.
    const AFFINE: [[f32; 4]; 3] = [[1.2, 0.05, 0.0, 0.02], [0.0, 0.9, -0.03, 0.0], [0.1, 0.0, 0.7, -0.01]];

    #[test]
    fn the_map_is_affine_in_the_colour() {
        let device = Device::flex();
        let image = picture(&device);
        let shown = values_of(apply(&image, &Tensor::from_floats(AFFINE, &device)));
        for (before, after) in values_of(image).chunks_exact(3).zip(shown.chunks_exact(3)) {
            for (row, after) in AFFINE.iter().zip(after) {
                let expected = row[0] * before[0] + row[1] * before[1] + row[2] * before[2] + row[3];
                assert!((expected - after).abs() < 1e-6, "{after} instead of {expected}");
            }
        }
    }

    #[test]
    fn identities_change_nothing_and_cost_nothing() {
        let device = Device::flex();
        let mut exposure = Exposure::new(ExposureConfig::default(), 2, &device);
        let image = picture(&device);
        let shown = apply(&Tensor::from_inner(image.clone()), &exposure.maps.tracked(1)).inner();
        assert_eq!(values_of(shown), values_of(image));
        assert_eq!(exposure.pull(0).into_scalar::<f32>(), 0.0);
    }

    /// Two photographs of opposite exposures: the mean of their maps is the identity.
    #[test]
    fn the_maps_of_photographs_are_found_around_the_identity() {
        let device = Device::flex();
        let mut exposure = Exposure::new(ExposureConfig { weight: 0.0, ..ExposureConfig::default() }, 2, &device);
        let image = picture(&device);
        let identity = exposure.maps.neutral();
        let first = Tensor::<2>::from_floats(AFFINE, &device);
        let maps = [first.clone(), identity.clone() * 2.0 - first];
        let truths = maps.clone().map(|map| apply(&image, &map));
        let tracked = Tensor::from_inner(image);
        let steps = 1200;
        for step in 1..=steps {
            let view = step % 2;
            let shown = apply(&tracked, &exposure.maps.tracked(view));
            let loss = (shown - Tensor::from_inner(truths[view].clone())).square().mean() + exposure.pull(view);
            exposure.step(&mut loss.backward(), EffectContext { view, step, steps, verdict: None });
        }
        let error = |found: Tensor<2>, expected: Tensor<2>| (found - expected).abs().max().into_scalar::<f32>();
        for (view, map) in maps.into_iter().enumerate() {
            assert!(error(exposure.maps.value(view), map) < 0.01, "{}", exposure.maps.value(view));
        }
        let mean = (exposure.maps.value(0) + exposure.maps.value(1)) / 2.0;
        assert!(error(mean, identity) < 1e-6);
    }

    /// A change that all photographs have in common goes to the scene.
    #[test]
    fn maps_that_move_together_are_set_back() {
        let device = Device::flex();
        let mut exposure = Exposure::new(ExposureConfig::default(), 3, &device);
        for step in 1..=3 {
            let mut gradients = exposure.maps.tracked(step - 1).sum().backward();
            exposure.step(&mut gradients, EffectContext { view: step - 1, step, steps: 10, verdict: None });
        }
        for view in 0..3 {
            let strayed = (exposure.maps.value(view) - exposure.maps.neutral()).abs().max().into_scalar::<f32>();
            assert!(strayed < 0.005, "{strayed}: a step is 0.01 to 0.006 long");
        }
    }

    #[test]
    fn a_verdict_holds_a_map_back() {
        let device = Device::flex();
        let mut exposure = Exposure::new(ExposureConfig::default(), 2, &device);
        let verdict = Tensor::<1, Int>::from_data(TensorData::from([4, 1]), &device);
        let mut gradients = exposure.maps.tracked(0).sum().backward();
        exposure.step(&mut gradients, EffectContext { view: 0, step: 5, steps: 10, verdict: Some(&verdict) });
        assert_eq!(values_of(exposure.maps.value(0)), values_of(exposure.maps.neutral()));
    }
}
