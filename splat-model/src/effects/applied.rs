//! The effects that act between a render and the loss, as a training loop uses them.

use burn::tensor::{Bool, Device, Int, Tensor};

use super::exposure::{Exposure, ExposureConfig};
use super::masks;

/// Those of one run. Without any it holds nothing and does nothing.
pub struct Applied {
    pub(crate) exposure: Option<Exposure>,
}

impl Applied {
    /// For `views` photographs. Exposures are learnt if there is a configuration for them; masks come with the photographs.
    pub fn new(exposure: Option<ExposureConfig>, views: usize, device: &Device) -> Self {
        Self { exposure: exposure.map(|config| Exposure::new(config, views, device)) }
    }

    /// The render `[H, W, 3]` as the photograph `view` would show it. `excluded`, `[1, H, W]`, says which pixels do not
    /// count: these are cleared, and must be so in the photograph.
    pub fn apply(&self, image: Tensor<3>, view: usize, excluded: Option<&Tensor<3, Bool>>) -> Tensor<3> {
        let image = match &self.exposure {
            Some(exposure) => exposure.apply(image, view),
            None => image,
        };
        match excluded {
            // Last, so that what is left out says nothing about the exposure either.
            Some(excluded) => masks::cleared(image, excluded),
            None => image,
        }
    }

    /// What the effects add to the loss of a step on `view`, `[1]`.
    pub fn penalty(&self, view: usize) -> Option<Tensor<1>> {
        self.exposure.as_ref().map(|exposure| exposure.penalty(view))
    }

    /// Takes the gradient of the effects' parameters for `view` out of those of a loss.
    pub fn take_gradient(&self, view: usize, gradients: &mut burn::tensor::Gradients) -> Option<Tensor<2>> {
        self.exposure.as_ref()?.take_gradient(view, gradients)
    }

    /// The optimiser's step `step` of `steps` on those parameters. Nothing changes where a step is entered in the verdict,
    /// `[2]` (see [`splat_op::adam`]).
    pub fn step(
        &mut self,
        view: usize,
        gradient: Option<Tensor<2>>,
        (step, steps): (usize, usize),
        verdict: Option<&Tensor<1, Int>>,
    ) {
        if let (Some(exposure), Some(gradient)) = (&mut self.exposure, gradient) {
            exposure.step(view, gradient, (step, steps), verdict);
        }
    }
}
