//! The interface of losses.

use burn::tensor::{Bool, Tensor};
use splat_op::{Colour, Extras, SplatError};

use crate::effects::{RenderInput, masks};
use crate::gaussians::Gaussians;
use crate::loss::Truth;

/// The inputs of a loss in one step.
pub struct LossInputs<'a> {
    /// `[H, W, 3]`: the render as it is compared with the photograph, tracked. It includes the exposure if one is learned,
    /// and is black where a mask excludes pixels, like `truth`.
    pub image: Tensor<3>,
    /// `[H, W, 1]`: the render's alpha, tracked; zero where a mask excludes pixels.
    pub alpha: Tensor<3>,
    /// The photograph, prepared; [`Truth::image`] gives it as `[H, W, 3]`.
    pub truth: &'a Truth,
    /// `[H, W, 1]`: the accumulated depth, tracked; zero where a mask excludes pixels. `None` unless an effect asks for it, in
    /// [`RenderInput::options`].
    pub depth: Option<Tensor<3>>,
    /// `[1, H, W]`: the pixels that a mask excludes, if there is one.
    pub excluded: Option<&'a Tensor<3, Bool>>,
    /// The inputs of the render, after effects: the activated parameters, tracked, the camera and the options.
    pub input: &'a RenderInput,
    /// The scene's parameters, tracked.
    pub gaussians: &'a Gaussians,
    /// Number of the step, counted from 1.
    pub step: usize,
    /// The photograph's name.
    pub view: &'a str,
}

impl LossInputs<'_> {
    /// `[N, width]`: the values of a group that was added to the scene, activated and tracked. [`Self::input`] has the activated
    /// values of the others.
    ///
    /// # Panics
    /// If the scene has no such group.
    pub fn group(&self, name: &str) -> Tensor<2> {
        let group = self.gaussians.group(name).unwrap_or_else(|| panic!("the scene has no group `{name}`"));
        group.values()
    }

    /// Renders features of one's own, `[N, C]`, from the view's camera, over black: `[H, W, C]`, tracked, and zero where a mask excludes
    /// pixels. Motion blur and a rolling shutter, which take several renders, are left out.
    ///
    /// # Errors
    /// Errors of the render operation.
    pub fn features(&self, features: Tensor<2>) -> Result<Tensor<3>, SplatError> {
        let mut input = self.input.clone();
        input.splats.colour = Colour::Features(features);
        input.extras = Extras::default();
        let colour = input.render()?.colour;
        Ok(match self.excluded {
            Some(excluded) => masks::cleared(colour, excluded),
            None => colour,
        })
    }
}

/// A loss: any function of [`LossInputs`] to a `[1]` tensor.
pub trait Loss {
    /// The loss of one step, `[1]`, tracked.
    fn loss(&self, seen: &LossInputs) -> Tensor<1>;
}

impl<F: Fn(&LossInputs) -> Tensor<1>> Loss for F {
    fn loss(&self, seen: &LossInputs) -> Tensor<1> {
        self(seen)
    }
}
