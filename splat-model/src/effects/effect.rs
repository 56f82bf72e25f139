//! What an effect is: something that happens between the scene and its photographs, with parameters of its own or without.
//!
//! An effect of your own is one type that implements [`Effect`], handed to
//! [`Trainer::with_effect`](crate::trainer::Trainer::with_effect); `examples/custom_effect.rs` is a whole one.

use std::any::Any;
use std::rc::Rc;

use burn::tensor::{Device, Gradients, Tensor};
use rand::Rng;
use splat_op::{
    Camera, Ellipses, Extras, Projected, RenderOptions, Rendered, SplatError, Splats, blend, colours, project,
    render_view, tile,
};

use super::background::Background;
use super::learned::Moment;
use crate::gaussians::{GaussianRows, Gaussians};
use crate::state::{State, StateError};

/// What a render is given, all of which effects may change.
#[derive(Clone)]
pub struct RenderInput {
    /// Activated parameters, tracked.
    pub splats: Splats,
    /// The photograph's camera, at the size that the run has come to.
    pub camera: Camera,
    /// The background that the operation blends over, and the probes of density control.
    pub extras: Extras,
    /// How is rendered.
    pub options: RenderOptions,
    /// See [`Self::edit`].
    pub(crate) edits: Vec<Rc<dyn Fn(Ellipses) -> Ellipses>>,
}

impl RenderInput {
    /// Has ellipses changed on the screen, after those edits that are there already. A render with edits takes
    /// the stages one by one.
    pub fn edit(&mut self, edit: impl Fn(Ellipses) -> Ellipses + 'static) {
        self.edits.push(Rc::new(edit));
    }

    /// The projected Gaussians, edited.
    pub(crate) fn project(&self) -> Result<Projected, SplatError> {
        let projected = project(&self.splats, &self.camera, &self.extras, &self.options)?;
        if self.edits.is_empty() {
            return Ok(projected);
        }
        let ellipses = self.edits.iter().fold(projected.ellipses(), |ellipses, edit| edit(ellipses));
        ellipses.pack(&self.camera.intrinsics)
    }

    /// What the camera sees.
    ///
    /// # Errors
    /// Those of the operation.
    pub fn render(&self) -> Result<Rendered<3>, SplatError> {
        if self.edits.is_empty() {
            return render_view(&self.splats, &self.camera, &self.extras, &self.options);
        }
        let projected = self.project()?;
        let features = colours(&self.splats, &self.camera)?;
        let tiles = tile(&projected, &self.options)?;
        blend(&projected, &features, &tiles, &self.extras, &self.options)
    }
}

/// The mean of one or more renders.
pub(crate) fn mean_of(pictures: Vec<Rendered<3>>) -> Rendered<3> {
    let count = pictures.len() as f32;
    let sum = pictures.into_iter().reduce(|a, b| Rendered {
        colour: a.colour + b.colour,
        alpha: a.alpha + b.alpha,
        depth: a.depth.zip(b.depth).map(|(a, b)| a + b),
    });
    let sum = sum.expect("an effect makes at least one render of each");
    if count == 1.0 {
        return sum;
    }
    Rendered { colour: sum.colour / count, alpha: sum.alpha / count, depth: sum.depth.map(|depth| depth / count) }
}

/// Something that happens between the scene and its photographs. The trainer calls it in the order of the functions below, none
/// of which has to be there but the name.
///
/// All that is random must come from the generator that is handed over, and all that changes must be saved: a run is to be the same
/// in every repetition, interrupted or not. An effect without a function adds nothing to a step in its place.
pub trait Effect: Any {
    /// What it is called in states. A run has one effect of a name.
    fn name(&self) -> &'static str;

    /// Draws the colour of this step's background, RGB, which is also put behind the photograph's transparent parts.
    fn draw(&mut self, _rng: &mut dyn Rng) -> Option<[f32; 3]> {
        None
    }

    /// Changes what is rendered: Gaussians, camera, background, options, or, by [`RenderInput::edit`], ellipses. `gaussians` are the
    /// parameters that [`RenderInput::splats`] were made from.
    fn before(&mut self, _input: &mut RenderInput, _gaussians: &Gaussians, _at: Moment) {}

    /// Renders one input as the mean of several, at least one.
    fn samples(&mut self, input: RenderInput, _at: Moment) -> Vec<RenderInput> {
        vec![input]
    }

    /// Changes the render, `[H, W, 3]`, before it is compared with the photograph. `input` is what was rendered, before it became
    /// several, and `picture` what the operation made of it.
    fn image(&mut self, image: Tensor<3>, _input: &RenderInput, _picture: &Rendered<3>, _at: Moment) -> Tensor<3> {
        image
    }

    /// What is added to the loss, `[1]`, tracked.
    fn penalty(&mut self, _input: &RenderInput, _picture: &Rendered<3>, _at: Moment) -> Option<Tensor<1>> {
        None
    }

    /// Takes its optimiser's step by the gradients that belong to its parameters, such as [`Learned::step`](super::Learned::step).
    /// Called once for each view of a batch, after all of them were rendered, and after the scene's step.
    fn step(&mut self, _gradients: &mut Gradients, _at: Moment) {}

    /// Forgets what is known row by row: Gaussians were added, removed or moved.
    fn forget_rows(&mut self) {}

    /// Saves what is remembered between steps.
    ///
    /// # Errors
    /// If something has no form in a state.
    fn save(&self, _to: &mut State) -> Result<(), StateError> {
        Ok(())
    }

    /// Takes up what [`Self::save`] has saved. `device` is the scene's, without autodiff.
    ///
    /// # Errors
    /// If something is missing, or is not what it should be.
    fn load(&mut self, _from: &mut State, _device: &Device) -> Result<(), StateError> {
        Ok(())
    }

    /// Applies it to rows for a file, as other viewers should show them.
    fn bake(&self, _rows: &mut GaussianRows) {}

    /// The background that others should put behind the scene, if it was learnt.
    fn background(&self) -> Option<Background> {
        None
    }

    /// Bytes kept from step to step: those of the arrays that are saved, and of whatever else there is.
    fn bytes(&self) -> usize {
        saved_bytes(self)
    }
}

/// Bytes of the arrays that an effect saves.
pub(super) fn saved_bytes(effect: &(impl Effect + ?Sized)) -> usize {
    let mut state = State::default();
    effect.save(&mut state).map_or(0, |()| state.bytes())
}
