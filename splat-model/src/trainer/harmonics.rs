//! Steps that learn no spherical harmonics beyond degree 0: three quarters of a Gaussian's numbers, which change slowly
//! ([`TrainConfig::sh_rest_every`](super::TrainConfig::sh_rest_every); Mallick et al. 2024, "Taming 3DGS", step them every
//! sixteen times). They are rendered with, and the gradient through the direction of view is whole; they have no gradient of their
//! own, no step of Adam, and their moments stay as they are.

use burn::tensor::{Gradients as AllGradients, Int, Tensor};
use splat_op::shade::harmonics;
use splat_op::{Camera, Colour, RenderOptions, SplatError, Splats, colours_up_to};

use crate::density::rows::{Gradients, StepRates, Trained};
use crate::gaussians::parameter;
use crate::optim::Adam;

/// Colours of a step in which the higher coefficients are held.
pub(super) struct Held {
    /// `[N, 3]`: zeros, tracked, that are added to the coefficients of degree 0.
    probe: Tensor<2>,
    /// How many of the Gaussians have higher ones.
    directional: usize,
}

impl Held {
    /// Takes the gradient from the harmonics of `splats`, if there are higher ones.
    pub fn new(splats: &mut Splats) -> Option<Self> {
        let (sh, matte) = match &mut splats.colour {
            Colour::SphericalHarmonics(sh) => (sh, None),
            Colour::Mixed { directional, matte } => (directional, Some(matte)),
            Colour::Features(_) => return None,
        };
        let [directional, coefficients, _] = sh.dims();
        if coefficients == 1 {
            return None;
        }
        let untracked = |sh: &mut Tensor<3>| sh.inplace(Tensor::detach);
        untracked(sh);
        matte.into_iter().for_each(untracked);
        let [count, channels] = [splats.means.dims()[0], 3];
        let probe = Tensor::zeros([count, channels], &splats.means.device()).require_grad();
        Some(Self { probe, directional })
    }

    /// The Gaussians with the colours that the camera sees, as features.
    pub fn coloured(&self, splats: &Splats, camera: &Camera, options: &RenderOptions) -> Result<Splats, SplatError> {
        let colours = colours_up_to(splats, camera, options.sh_degree)?;
        // A channel that the clamp holds at zero has no gradient.
        let open = colours.clone().greater_elem(0.0).float();
        let [constant, ..] = harmonics([0.0, 0.0, 1.0], 0);
        let features = colours + self.probe.clone() * open * constant;
        Ok(Splats { colour: Colour::Features(features), ..splats.clone() })
    }

    /// Puts the gradients of the coefficients of degree 0 in their places: `[M, 1, 3]`, and those of the matte Gaussians.
    pub fn take_gradients(&self, all: &mut AllGradients, into: &mut Gradients) {
        let Some(gradient) = self.probe.grad_remove(all) else { return };
        let gradient: Tensor<3> = gradient.unsqueeze_dim(1);
        let (count, first) = (gradient.dims()[0], self.directional);
        into.sh_matte = (first < count).then(|| gradient.clone().narrow(0, first, count - first));
        into.sh = Some(gradient.narrow(0, 0, first));
    }
}

/// One step of Adam on every parameter that has a gradient, as [`Trained::step`]; where the gradient of the harmonics is that of
/// degree 0 alone, the others stay as they are.
pub(super) fn step(
    scene: &mut Trained,
    mut gradients: Gradients,
    rates: &StepRates,
    step: usize,
    verdict: Option<&Tensor<1, Int>>,
) {
    let adam = Adam::default();
    let coefficients = scene.gaussians.sh.val().dims()[1];
    let constant = gradients.sh.take_if(|gradient| gradient.dims()[1] < coefficients);
    scene.step(gradients, &adam, rates, step, verdict);
    let Some(gradient) = constant else { return };
    let (param, moments) = (&mut scene.gaussians.sh, &mut scene.moments.sh);
    let (device, dtype) = (param.val().device(), param.val().dtype());
    // Taken out, so that nothing else holds them and they are changed in place.
    let empty = parameter(Tensor::zeros([0; 3], (&device, dtype)));
    let values = std::mem::replace(param, empty).into_value().inner();
    let values = adam.step_first(values, gradient, rates.rates.sh_dc, moments, (step, verdict));
    *param = parameter(if device.is_autodiff() { Tensor::from_inner(values) } else { values });
}

#[cfg(test)]
mod tests;
