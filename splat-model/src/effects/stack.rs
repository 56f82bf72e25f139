//! The effects of one run, in the order in which light passes them.

use std::any::Any;

use burn::tensor::{Device, Gradients, Tensor};
use rand::Rng;
use splat_op::Rendered;

use super::background::Background;
use super::{Effect, EffectContext, Leaf, RenderInput};
use crate::gaussians::{GaussianRows, Gaussians};
use crate::state::{State, StateError};

/// A sequence of effects, which is an effect itself. An empty stack holds nothing and does nothing.
#[derive(Default)]
pub struct EffectStack(Vec<Box<dyn Effect>>);

impl EffectStack {
    /// Appends an effect, or replaces the effect of the same name.
    pub fn put(&mut self, effect: impl Effect) {
        match self.0.iter_mut().find(|other| other.name() == effect.name()) {
            Some(other) => *other = Box::new(effect),
            None => self.0.push(Box::new(effect)),
        }
    }

    /// The effect of type `T`, if there is one.
    pub fn get<T: Effect>(&self) -> Option<&T> {
        self.0.iter().find_map(|effect| (&**effect as &dyn Any).downcast_ref())
    }

    /// Mutable access to the effect of type `T`.
    pub fn get_mut<T: Effect>(&mut self) -> Option<&mut T> {
        self.0.iter_mut().find_map(|effect| (&mut **effect as &mut dyn Any).downcast_mut())
    }
}

impl Effect for EffectStack {
    fn name(&self) -> &'static str {
        "effects"
    }

    /// The background colour of the last effect that draws one.
    fn draw(&mut self, rng: &mut dyn Rng) -> Option<[f32; 3]> {
        self.0.iter_mut().filter_map(|effect| effect.draw(rng)).last()
    }

    fn before(&mut self, input: &mut RenderInput, gaussians: &Gaussians, at: EffectContext) {
        self.0.iter_mut().for_each(|effect| effect.before(input, gaussians, at));
    }

    fn samples(&mut self, input: RenderInput, at: EffectContext) -> Vec<RenderInput> {
        self.0.iter_mut().fold(vec![input], |inputs, effect| {
            inputs.into_iter().flat_map(|input| effect.samples(input, at)).collect()
        })
    }

    fn image(&mut self, image: Tensor<3>, input: &RenderInput, picture: &Rendered<3>, at: EffectContext) -> Tensor<3> {
        self.0.iter_mut().fold(image, |image, effect| effect.image(image, input, picture, at))
    }

    fn penalty(&mut self, input: &RenderInput, picture: &Rendered<3>, at: EffectContext) -> Option<Tensor<1>> {
        self.0.iter_mut().filter_map(|effect| effect.penalty(input, picture, at)).reduce(|a, b| a + b)
    }

    fn leaves(&mut self, at: EffectContext) -> Vec<Leaf> {
        self.0.iter_mut().flat_map(|effect| effect.leaves(at)).collect()
    }

    fn step(&mut self, gradients: &mut Gradients, at: EffectContext) {
        self.0.iter_mut().for_each(|effect| effect.step(gradients, at));
    }

    fn forget_rows(&mut self) {
        self.0.iter_mut().for_each(|effect| effect.forget_rows());
    }

    fn save(&self, to: &mut State) -> Result<(), StateError> {
        self.0.iter().try_for_each(|effect| to.in_part(effect.name(), |part| effect.save(part)))
    }

    fn load(&mut self, from: &mut State, device: &Device) -> Result<(), StateError> {
        self.0.iter_mut().try_for_each(|effect| from.load_part(effect.name(), |part| effect.load(part, device)))
    }

    fn bake(&self, rows: &mut GaussianRows) {
        self.0.iter().for_each(|effect| effect.bake(rows));
    }

    fn background(&self) -> Option<Background> {
        self.0.iter().rev().find_map(|effect| effect.background())
    }
}
