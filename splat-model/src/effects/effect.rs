//! The interface of effects: models of what happens between the scene and its photographs, with or without parameters.
//!
//! A custom effect is a type that implements [`Effect`] and is passed to
//! [`Trainer::with_effect`](crate::trainer::Trainer::with_effect). `train/examples/own_program.rs` has a complete one.

use std::any::Any;
use std::rc::Rc;

use burn::tensor::{Device, Gradients, Tensor};
use rand::Rng;
use splat_op::{
    Camera, Ellipses, Extras, Projected, RenderOptions, Rendered, SplatError, Splats, intersect, normals, project,
    rasterize, render_view, visible_colours,
};

use super::background::Background;
use super::{EffectContext, Leaf};
use crate::gaussians::{GaussianRows, Gaussians};
use crate::state::{State, StateError};

/// A change of the projected Gaussians.
type Edit = Rc<dyn Fn(Projected) -> Result<Projected, SplatError>>;

/// The inputs of a render. Effects may change all of them.
#[derive(Clone)]
pub struct RenderInput {
    /// Activated parameters, tracked.
    pub splats: Splats,
    /// The photograph's camera at the current image size.
    pub camera: Camera,
    /// The background colour and the gradient probes of density control.
    pub extras: Extras,
    /// Render options.
    pub options: RenderOptions,
    /// See [`Self::edit`].
    pub(crate) edits: Vec<Edit>,
}

impl RenderInput {
    /// Adds an edit of the projected ellipses, applied after earlier edits. A render with edits runs the stages one by one.
    pub fn edit(&mut self, edit: impl Fn(Ellipses) -> Ellipses + 'static) {
        self.edit_projected(move |projected| edit(projected.ellipses()).pack(projected.intrinsics()));
    }

    /// Adds an edit by an operation on the packed ellipses, such as those of [`splat_op::optics`]: as [`Self::edit`], without taking the
    /// ellipses apart.
    pub fn edit_projected(&mut self, edit: impl Fn(Projected) -> Result<Projected, SplatError> + 'static) {
        self.edits.push(Rc::new(edit));
    }

    /// The projected Gaussians, edited.
    pub(crate) fn project(&self) -> Result<Projected, SplatError> {
        let projected = project(&self.splats, &self.camera, &self.extras, &self.options)?;
        self.edits.iter().try_fold(projected, |projected, edit| edit(projected))
    }

    /// Renders the view.
    ///
    /// # Errors
    /// Errors of the render operation.
    pub fn render(&self) -> Result<Rendered<3>, SplatError> {
        if self.edits.is_empty() {
            return render_view(&self.splats, &self.camera, &self.extras, &self.options);
        }
        let projected = self.project()?;
        let features = visible_colours(&self.splats, &self.camera, &projected, &self.options)?;
        let intersections = intersect(&projected, &self.options)?;
        let mut picture = rasterize(&projected, &features, &intersections, &self.extras, &self.options)?;
        if self.options.normals {
            let features = normals(&self.splats, &self.camera)?;
            picture.normals =
                Some(rasterize(&projected, &features, &intersections, &Extras::default(), &self.options)?.colour);
        }
        Ok(picture)
    }
}

pub(crate) fn mean_of(mut pictures: Vec<Rendered<3>>) -> Rendered<3> {
    if pictures.len() == 1 {
        return pictures.remove(0);
    }
    // Renders are views of planes: another order of the sum would be rearranged by the loss, and its gradient by every render.
    Rendered::combined(&pictures, |parts| {
        let count = parts.len() as f32;
        let sum = parts.into_iter().map(|part| part.permute([2, 0, 1])).reduce(|a, b| a + b);
        (sum.expect("an effect makes at least one render of each") / count).permute([1, 2, 0])
    })
}

/// A model of something that happens between the scene and its photographs. The trainer calls the functions in the order
/// below. Only the name is required.
///
/// All randomness must come from the generator that is passed in, and all changing state must be saved, so that a run can
/// be repeated exactly, interrupted or not. The defaults do nothing.
pub trait Effect: Any {
    /// The name in saved states. A run has at most one effect of a name.
    fn name(&self) -> &'static str;

    /// Draws the colour of this step's background, RGB, which is also put behind the photograph's transparent parts.
    fn draw(&mut self, _rng: &mut dyn Rng) -> Option<[f32; 3]> {
        None
    }

    /// Changes the inputs of the render: Gaussians, camera, background, options, or, by [`RenderInput::edit`], ellipses.
    /// `gaussians` are the parameters from which [`RenderInput::splats`] were made.
    fn before(&mut self, _input: &mut RenderInput, _gaussians: &Gaussians, _at: EffectContext) {}

    /// Splits one input into the inputs of one or more renders, whose mean is used.
    fn samples(&mut self, input: RenderInput, _at: EffectContext) -> Vec<RenderInput> {
        vec![input]
    }

    /// Changes the render, `[H, W, 3]`, before the comparison with the photograph. `input` is the input before
    /// [`Self::samples`], and `picture` is the output of the render.
    fn image(
        &mut self,
        image: Tensor<3>,
        _input: &RenderInput,
        _picture: &Rendered<3>,
        _at: EffectContext,
    ) -> Tensor<3> {
        image
    }

    /// Returns a term to add to the loss, `[1]`, tracked.
    fn penalty(&mut self, _input: &RenderInput, _picture: &Rendered<3>, _at: EffectContext) -> Option<Tensor<1>> {
        None
    }

    /// Lists the parameters whose gradients [`Self::step`] takes at a view, for example by [`Learned::leaf`](super::Learned::leaf). Called
    /// only in runs of several processes, of which one renders the view, before any effect takes a step. Every process lists the same
    /// parameters in the same order. Other state may depend on [`Self::draw`], [`Self::step`] and [`Self::forget_rows`], which are called
    /// in all processes, and on the scene and the step in [`Self::before`], but not on which views a process renders.
    fn leaves(&mut self, _at: EffectContext) -> Vec<Leaf> {
        Vec::new()
    }

    /// Takes an optimiser step on the effect's parameters, for example by [`Learned::step`](super::Learned::step). Called
    /// once for each view of a batch, after all views are rendered and after the step of the scene.
    fn step(&mut self, _gradients: &mut Gradients, _at: EffectContext) {}

    /// Discards state that belongs to single Gaussians, because Gaussians were added, removed or moved.
    fn forget_rows(&mut self) {}

    /// Saves the effect's state.
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

    /// Applies the effect to Gaussians that are written to a file, so that other viewers show its result. A large scene is written in parts, so
    /// that a row must not depend on others.
    fn bake(&self, _rows: &mut GaussianRows) {}

    /// The background that other viewers should show behind the scene, if the effect learned one.
    fn background(&self) -> Option<Background> {
        None
    }
}
