//! A value whose derivative is already known.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::{Shape, Tensor};

use super::autodiff::tracked;

/// Attaches a known derivative to a value.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait CustomGradBackend: Backend {
    /// Returns `value`, `[1]`. Its derivative with respect to `variable` is `gradient`, which has the shape of `variable`.
    #[fusion(dtype = value, shape = value)]
    fn with_gradient(
        variable: FloatTensor<Self>,
        value: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
    ) -> FloatTensor<Self>;

    /// Returns `values` times `factor`, `[1]`. Not differentiable.
    #[fusion(dtype = values, shape = values)]
    fn scaled(values: FloatTensor<Self>, factor: FloatTensor<Self>) -> FloatTensor<Self>;
}

macro_rules! without_autodiff {
    ($backend:ty, $scaled:expr) => {
        impl CustomGradBackend for $backend {
            fn with_gradient(
                _: FloatTensor<Self>,
                value: FloatTensor<Self>,
                _: FloatTensor<Self>,
            ) -> FloatTensor<Self> {
                value
            }

            fn scaled(values: FloatTensor<Self>, factor: FloatTensor<Self>) -> FloatTensor<Self> {
                $scaled(values, factor)
            }
        }
    };
}

fn scaled_in_tensors<B: Backend>(values: FloatTensor<B>, factor: FloatTensor<B>) -> FloatTensor<B> {
    let factor = B::float_reshape(factor, Shape::from(vec![1; values.rank()]));
    B::float_mul(values, factor)
}

without_autodiff!(burn::backend::Flex, scaled_in_tensors::<Self>);
without_autodiff!(burn::backend::NdArray, scaled_in_tensors::<Self>);
#[cfg(feature = "cube")]
without_autodiff!(burn_cubecl::CubeBackend, super::cube::scaled);

impl<B: CustomGradBackend, C: CheckpointStrategy> CustomGradBackend for Autodiff<B, C> {
    fn with_gradient(
        variable: FloatTensor<Self>,
        value: FloatTensor<Self>,
        gradient: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let (value, gradient) = (value.into_primitive(), gradient.into_primitive());
        tracked([&variable], value, move |grad, _| [Some(B::scaled(gradient, grad)).into()])
    }

    fn scaled(values: FloatTensor<Self>, factor: FloatTensor<Self>) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::scaled(values.into_primitive(), factor.into_primitive()))
    }
}

/// Returns `value`, `[1]`, with `gradient` as its derivative with respect to `variable`. `gradient` has the shape of `variable`.
/// For losses whose derivative is cheaper in closed form than as a graph of small operations. `value` and `gradient` are
/// constants.
///
/// # Panics
/// If the shapes of `variable` and `gradient` differ.
pub fn with_gradient<const D: usize>(variable: Tensor<D>, value: Tensor<1>, gradient: Tensor<D>) -> Tensor<1> {
    assert_eq!(variable.dims(), gradient.dims(), "a derivative has the shape of its variable");
    let (value, gradient) = (value.into_dispatch(), gradient.into_dispatch());
    Tensor::from_dispatch(<Dispatch as CustomGradBackend>::with_gradient(variable.into_dispatch(), value, gradient))
}

/// Returns values as constants beside tensors of a device with autodiff, if `beside_tracked` is set, or of one without.
pub(crate) fn constant<const D: usize>(values: &Tensor<D>, beside_tracked: bool) -> Tensor<D> {
    if beside_tracked && !values.is_autodiff() { Tensor::from_inner(values.clone()) } else { values.clone() }
}
