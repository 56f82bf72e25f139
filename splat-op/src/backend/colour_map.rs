//! The affine colour map on Burn's backends, with its backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::grad;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, MappedGrads, MappedTensors, OptionalTensor};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::colour_map::Mapped;
use crate::colour_map::cpu::{colour_map_backward_cpu, colour_map_cpu};

/// The affine colour map of a picture; see `colour_map/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait ColourMapBackend: Backend {
    /// Returns the mapped picture, `[3, H, W]`. Differentiable in picture and map.
    #[fusion(meta = colour_map_meta)]
    fn colour_map(#[extension_type] inputs: MappedTensors<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of the inputs that `needs` names from `grad`, that of the mapped picture. Not differentiable.
    #[fusion(meta = colour_map_backward_meta)]
    fn colour_map_backward(
        #[extension_type] inputs: MappedTensors<Self>,
        grad: FloatTensor<Self>,
        needs: Mapped<bool>,
    ) -> MappedGrads<Self>;
}

#[cfg(feature = "fusion")]
fn colour_map_meta(inputs: &Mapped<InputTensorMetadata>) -> burn::backend::fusion::custom::TensorSpec {
    inputs.image.0.clone()
}

#[cfg(feature = "fusion")]
fn colour_map_backward_meta(
    inputs: &Mapped<InputTensorMetadata>,
    of_output: &burn::backend::fusion::custom::TensorSpec,
    needs: &Mapped<bool>,
) -> Mapped<OptionalTensorMetadata> {
    inputs.each_ref().zip(*needs).map(grad(of_output))
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl ColourMapBackend for $backend {
            fn colour_map(inputs: MappedTensors<Self>) -> FloatTensor<Self> {
                let like = &inputs.image.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    Self::from_host(colour_map_cpu(read.each_ref().map(|host| &host[..])), &like.shape(), like)
                })
            }

            fn colour_map_backward(
                inputs: MappedTensors<Self>,
                grad: FloatTensor<Self>,
                needs: Mapped<bool>,
            ) -> MappedGrads<Self> {
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = colour_map_backward_cpu(slices, &Self::host(grad.clone()), needs);
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
    use crate::colour_map::launch::{launch_colour_map, launch_colour_map_backward};
    use crate::gpu::Gpu;

    impl ColourMapBackend for CubeBackend {
        fn colour_map(inputs: MappedTensors<Self>) -> FloatTensor<Self> {
            let like = &inputs.image.0;
            let out = launch_colour_map(&Gpu::new(&like.client), &inputs.each_ref().map(on_device));
            tensor(out, like.shape(), DType::F32, like)
        }

        fn colour_map_backward(
            inputs: MappedTensors<Self>,
            grad: FloatTensor<Self>,
            needs: Mapped<bool>,
        ) -> MappedGrads<Self> {
            let gpu = Gpu::new(&grad.client);
            let found = launch_colour_map_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), needs);
            found.zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: ColourMapBackend, C: CheckpointStrategy> ColourMapBackend for Autodiff<B, C> {
    fn colour_map(inputs: MappedTensors<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::colour_map(inner.clone());
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            B::colour_map_backward(inner, grad, Mapped::from_array(mask)).into_array()
        })
    }

    fn colour_map_backward(
        inputs: MappedTensors<Self>,
        grad: FloatTensor<Self>,
        needs: Mapped<bool>,
    ) -> MappedGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::colour_map_backward(inner, grad.into_primitive(), needs).map(OptionalTensor::constant)
    }
}
