//! Gradients of effects' parameters on the way between the processes of a run.

use burn::tensor::{Gradients, Tensor, TensorData};

use crate::gaussians::values_of;

/// Finds the gradient of a leaf, row-major.
type TakeGradient = dyn Fn(&Gradients) -> Option<Vec<f32>>;

/// A parameter of an effect in one step: the tracked tensor whose gradient [`Effect::step`](super::Effect::step) takes.
///
/// A run of several processes renders each photograph in one of them (see [`crate::trainer::ranks`]). The others do not have
/// the gradients of its backward pass. They get the numbers, and a [`Gradients`] in which they stand for these tensors.
pub struct Leaf {
    /// `[count]`: the tensor in one dimension, tracked.
    flat: Tensor<1>,
    gradient: Box<TakeGradient>,
}

impl Leaf {
    /// The leaf of a parameter: a tensor with `require_grad`, the one from which renders and losses of this step are computed.
    pub fn new<const D: usize>(leaf: Tensor<D>) -> Self {
        let flat = leaf.clone().reshape([leaf.shape().num_elements()]);
        Self { flat, gradient: Box::new(move |gradients| leaf.grad(gradients).map(values_of)) }
    }

    pub(crate) fn count(&self) -> usize {
        self.flat.dims()[0]
    }

    /// The gradient, row-major. `None` if the loss does not depend on the parameter.
    pub(crate) fn gradient(&self, gradients: &Gradients) -> Option<Vec<f32>> {
        (self.gradient)(gradients)
    }

    /// A term whose derivative by the parameter is `gradient`, to the bit: `Σ gᵢ xᵢ`.
    fn term(&self, gradient: &[f32]) -> Tensor<1> {
        let gradient = TensorData::new(gradient.to_vec(), [gradient.len()]);
        let gradient = Tensor::<1>::from_data(gradient, &self.flat.device().inner());
        (self.flat.clone() * Tensor::from_inner(gradient)).sum()
    }
}

/// Gradients in which these leaves have the given gradients, and nothing else has any.
pub(crate) fn stand_in<'a>(of: impl IntoIterator<Item = (&'a Leaf, &'a [f32])>) -> Option<Gradients> {
    let terms = of.into_iter().map(|(leaf, gradient)| leaf.term(gradient));
    Some(terms.reduce(|a, b| a + b)?.backward())
}

#[cfg(test)]
mod tests;
