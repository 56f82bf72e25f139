//! The composition over an environment on Burn's backends, with its backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::grad as gradient_of;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, OptionalTensor, SkyGrads, SkyTensors};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::environment::Sky;
use crate::environment::cpu::{environment_backward_cpu, environment_cpu};

/// The composition over an environment; see `environment/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait EnvironmentBackend: Backend {
    /// Returns the render over the environment, `[3, H, W]`. Differentiable in all inputs but the directions.
    #[fusion(meta = environment_meta)]
    fn environment(#[extension_type] inputs: SkyTensors<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of alpha and of the coefficients, if `needs` names them, from `grad`, that of the composed picture. Not
    /// differentiable.
    #[fusion(meta = environment_backward_meta)]
    fn environment_backward(
        #[extension_type] inputs: SkyTensors<Self>,
        grad: FloatTensor<Self>,
        needs: Sky<bool>,
    ) -> SkyGrads<Self>;
}

#[cfg(feature = "fusion")]
fn environment_meta(inputs: &Sky<InputTensorMetadata>) -> burn::backend::fusion::custom::TensorSpec {
    inputs.image.0.clone()
}

#[cfg(feature = "fusion")]
fn environment_backward_meta(
    inputs: &Sky<InputTensorMetadata>,
    of_output: &burn::backend::fusion::custom::TensorSpec,
    needs: &Sky<bool>,
) -> Sky<OptionalTensorMetadata> {
    inputs.each_ref().zip(computed(*needs)).map(gradient_of(of_output))
}

/// The gradients that take an operation.
fn computed(needs: Sky<bool>) -> Sky<bool> {
    Sky { image: false, directions: false, ..needs }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl EnvironmentBackend for $backend {
            fn environment(inputs: SkyTensors<Self>) -> FloatTensor<Self> {
                let like = &inputs.image.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    Self::from_host(environment_cpu(read.each_ref().map(|host| &host[..])), &like.shape(), like)
                })
            }

            fn environment_backward(
                inputs: SkyTensors<Self>,
                grad: FloatTensor<Self>,
                needs: Sky<bool>,
            ) -> SkyGrads<Self> {
                let needs = computed(needs);
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = environment_backward_cpu(slices, &Self::host(grad.clone()), needs);
                    found.zip(needs).zip(inputs.each_ref()).map(gradient)
                })
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

#[cfg(feature = "cube")]
mod gpu {
    use burn::tensor::DType;
    use burn_cubecl::CubeBackend;

    use super::*;
    use crate::backend::cube::{self, buffer, on_device, tensor};
    use crate::environment::launch::{launch_alpha_backward, launch_coefficients_backward, launch_environment};
    use crate::gpu::Gpu;

    impl EnvironmentBackend for CubeBackend {
        fn environment(inputs: SkyTensors<Self>) -> FloatTensor<Self> {
            let like = &inputs.image.0;
            let out = launch_environment(&Gpu::new(&like.client), &inputs.each_ref().map(on_device));
            tensor(out, like.shape(), DType::F32, like)
        }

        fn environment_backward(inputs: SkyTensors<Self>, grad: FloatTensor<Self>, needs: Sky<bool>) -> SkyGrads<Self> {
            let (gpu, on_device) = (Gpu::new(&grad.client), inputs.each_ref().map(on_device));
            let grad = buffer(grad);
            let found = Sky {
                alpha: needs.alpha.then(|| launch_alpha_backward(&gpu, &on_device, &grad)),
                coefficients: needs.coefficients.then(|| launch_coefficients_backward(&gpu, &on_device, &grad)),
                ..Sky::default()
            };
            found.zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: EnvironmentBackend, C: CheckpointStrategy> EnvironmentBackend for Autodiff<B, C> {
    fn environment(inputs: SkyTensors<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::environment(inner.clone());
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            let needs = Sky::from_array(mask);
            let of_image = needs.image.then(|| grad.clone());
            Sky { image: of_image.into(), ..B::environment_backward(inner, grad, needs) }.into_array()
        })
    }

    fn environment_backward(inputs: SkyTensors<Self>, grad: FloatTensor<Self>, needs: Sky<bool>) -> SkyGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::environment_backward(inner, grad.into_primitive(), needs).map(OptionalTensor::constant)
    }
}
