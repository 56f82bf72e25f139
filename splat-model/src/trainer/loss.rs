//! The interface of losses.

use std::any::Any;

use burn::tensor::{Bool, Device, Gradients, Tensor};
use splat_op::{Colour, Extras, RenderOptions, SplatError};

use crate::effects::{EffectContext, Leaf, RenderInput, masks};
use crate::gaussians::Gaussians;
use crate::loss::Truth;
use crate::state::{State, StateError};

/// The inputs of a loss in one step.
pub struct LossInputs<'a> {
    /// `[H, W, 3]`: the render as it is compared with the photograph, tracked. It includes the exposure if one is learned,
    /// and is black where a mask excludes pixels, like `truth`.
    pub image: Tensor<3>,
    /// `[H, W, 1]`: the render's alpha, tracked; zero where a mask excludes pixels.
    pub alpha: Tensor<3>,
    /// The photograph, prepared; [`Truth::image`] gives it as `[H, W, 3]`.
    pub truth: &'a Truth,
    /// `[H, W, 1]`: the accumulated depth, tracked; zero where a mask excludes pixels. `None` unless [`Loss::outputs`] or an effect asks
    /// for it.
    pub depth: Option<Tensor<3>>,
    /// `[H, W, 3]`: the accumulated [normals](fn@splat_op::normals), world frame, tracked; zero where a mask excludes pixels. `None` unless
    /// [`Loss::outputs`] or an effect asks for them.
    pub normals: Option<Tensor<3>>,
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
        input.options = input.options.with_depth(false).with_expected_depth(false).with_normals(false);
        Ok(masks::cleared(input.render()?.colour, self.excluded))
    }
}

/// A loss: any function of [`LossInputs`] to a `[1]` tensor, or a type with more to say. Only [`Self::loss`] is required.
pub trait Loss: Any {
    /// Adds what the loss needs to the outputs of the render at `step`, for example by `options.with_depth(true).with_normals(true)`.
    /// Outputs that neither a loss nor an effect asks for are not computed.
    fn outputs(&self, options: RenderOptions, _step: usize) -> RenderOptions {
        options
    }

    /// The loss of one view, `[1]`, tracked.
    fn loss(&mut self, seen: &LossInputs) -> Tensor<1>;

    /// Whether the loss compares the views of a step. [`Self::of_batch`] then takes the place of [`Self::loss`]: all views are rendered
    /// before the first is differentiated, in one process, which takes the memory of all.
    fn joins_views(&self) -> bool {
        false
    }

    /// The loss of all views of a step, `[1]`, tracked: the mean of their losses.
    fn of_batch(&mut self, seen: &[LossInputs]) -> Tensor<1> {
        let sum = seen.iter().map(|view| self.loss(view)).reduce(|a, b| a + b).expect("a batch has a view");
        sum / seen.len() as f64
    }

    /// Lists the loss's own parameters, in runs of several processes. As [`Effect::leaves`](crate::effects::Effect::leaves).
    fn leaves(&mut self) -> Vec<Leaf> {
        Vec::new()
    }

    /// Takes an optimiser step on the loss's own parameters, such as [`Learned`](crate::effects::Learned) and
    /// [`Network`](crate::effects::Network). Called once for each view of a batch, or once for all that it joins.
    fn step(&mut self, _gradients: &mut Gradients, _at: EffectContext) {}

    /// Saves the loss's state.
    ///
    /// # Errors
    /// If a value cannot be stored in a state.
    fn save(&self, _to: &mut State) -> Result<(), StateError> {
        Ok(())
    }

    /// Restores what [`Self::save`] saved. `device` is the scene's device without autodiff.
    ///
    /// # Errors
    /// If a value is missing or invalid.
    fn load(&mut self, _from: &mut State, _device: &Device) -> Result<(), StateError> {
        Ok(())
    }
}

impl<F: FnMut(&LossInputs) -> Tensor<1> + 'static> Loss for F {
    fn loss(&mut self, seen: &LossInputs) -> Tensor<1> {
        self(seen)
    }
}
