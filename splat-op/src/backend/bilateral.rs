//! The slice of a bilateral grid on Burn's backends, with its backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::grad;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, OptionalTensor, SliceGrads, SliceTensors};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::bilateral::cpu::{slice_backward_cpu, slice_cpu};
use crate::bilateral::{SliceSize, Sliced};

/// The slice of a bilateral grid; see `bilateral/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait BilateralBackend: Backend {
    /// Returns the mapped picture, `[3, H, W]`. Differentiable in picture and grid.
    #[fusion(meta = slice_meta)]
    fn bilateral_slice(#[extension_type] inputs: SliceTensors<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of the inputs that `needs` names from `grad`, that of the mapped picture. Not differentiable.
    #[fusion(meta = slice_backward_meta)]
    fn bilateral_slice_backward(
        #[extension_type] inputs: SliceTensors<Self>,
        grad: FloatTensor<Self>,
        needs: Sliced<bool>,
    ) -> SliceGrads<Self>;
}

#[cfg(feature = "fusion")]
fn slice_meta(inputs: &Sliced<InputTensorMetadata>) -> burn::backend::fusion::custom::TensorSpec {
    inputs.image.0.clone()
}

#[cfg(feature = "fusion")]
fn slice_backward_meta(
    inputs: &Sliced<InputTensorMetadata>,
    of_output: &burn::backend::fusion::custom::TensorSpec,
    needs: &Sliced<bool>,
) -> Sliced<OptionalTensorMetadata> {
    inputs.each_ref().zip(*needs).map(grad(of_output))
}

fn size<B: Backend>(inputs: &SliceTensors<B>) -> SliceSize {
    SliceSize::new(&inputs.image.0.shape(), &inputs.grid.0.shape())
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl BilateralBackend for $backend {
            fn bilateral_slice(inputs: SliceTensors<Self>) -> FloatTensor<Self> {
                let (like, size) = (&inputs.image.0, size::<Self>(&inputs));
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    Self::from_host(slice_cpu(read.each_ref().map(|host| &host[..]), size), &like.shape(), like)
                })
            }

            fn bilateral_slice_backward(
                inputs: SliceTensors<Self>,
                grad: FloatTensor<Self>,
                needs: Sliced<bool>,
            ) -> SliceGrads<Self> {
                let size = size::<Self>(&inputs);
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = slice_backward_cpu(slices, &Self::host(grad.clone()), size, needs);
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
    use crate::bilateral::launch::{launch_slice, launch_slice_backward};
    use crate::gpu::Gpu;

    impl BilateralBackend for CubeBackend {
        fn bilateral_slice(inputs: SliceTensors<Self>) -> FloatTensor<Self> {
            let like = &inputs.image.0;
            let out = launch_slice(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), size::<Self>(&inputs));
            tensor(out, like.shape(), DType::F32, like)
        }

        fn bilateral_slice_backward(
            inputs: SliceTensors<Self>,
            grad: FloatTensor<Self>,
            needs: Sliced<bool>,
        ) -> SliceGrads<Self> {
            let (gpu, size) = (Gpu::new(&grad.client), size::<Self>(&inputs));
            let found = launch_slice_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), size, needs);
            found.zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: BilateralBackend, C: CheckpointStrategy> BilateralBackend for Autodiff<B, C> {
    fn bilateral_slice(inputs: SliceTensors<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::bilateral_slice(inner.clone());
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            B::bilateral_slice_backward(inner, grad, Sliced::from_array(mask)).into_array()
        })
    }

    fn bilateral_slice_backward(
        inputs: SliceTensors<Self>,
        grad: FloatTensor<Self>,
        needs: Sliced<bool>,
    ) -> SliceGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::bilateral_slice_backward(inner, grad.into_primitive(), needs).map(OptionalTensor::constant)
    }
}
