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

    /// Number of elements.
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
mod tests {
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn a_stand_in_has_the_gradients_of_the_loss_to_the_bit() {
        let device = Device::flex();
        let leaf = |shape| Tensor::<2>::from_inner(Tensor::ones(shape, &device)).require_grad();
        let (a, b, unused) = (leaf([2, 3]), leaf([1, 1]), leaf([4, 1]));
        let odd = [0.1, -0.0, f32::MIN_POSITIVE / 8.0, f32::MAX, f32::INFINITY, -7.25];
        let weights = Tensor::<2>::from_data(TensorData::new(odd.to_vec(), [2, 3]), &device);
        let loss = (a.clone() * Tensor::from_inner(weights)).sum() + b.clone().sum() * 3.0;
        let gradients = loss.backward();
        let leaves = [&a, &b, &unused].map(|leaf| Leaf::new(leaf.clone()));
        assert_eq!(leaves.each_ref().map(Leaf::count), [6, 1, 4]);
        let [of_a, of_b, none] = leaves.each_ref().map(|leaf| leaf.gradient(&gradients));
        assert!(none.is_none());
        let (of_a, of_b) = (of_a.unwrap(), of_b.unwrap());
        let stand_in = stand_in([(&leaves[0], &of_a[..]), (&leaves[1], &of_b[..])]).unwrap();
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        assert_eq!(bits(values_of(a.grad(&stand_in).unwrap())), odd.map(f32::to_bits));
        assert_eq!(values_of(b.grad(&stand_in).unwrap()), [3.0]);
        assert!(unused.grad(&stand_in).is_none());
    }
}
