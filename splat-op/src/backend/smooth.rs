//! The convolution of Gaussians with filters of their own widths on Burn's backends, with its backward nodes.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::grad as gradient_of;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, OptionalTensor, SmoothGrads, SmoothTensors};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::smooth::Smooth;
use crate::smooth::cpu::{smoothed_opacities_backward_cpu, smoothed_opacities_cpu, smoothed_scales_cpu};

/// The convolution of Gaussians; see `smooth/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait SmoothBackend: Backend {
    /// Returns the new standard deviations, `[N, 3]`. Differentiable in the old ones.
    #[fusion(dtype = scales, shape = scales)]
    fn smoothed_scales(scales: FloatTensor<Self>, widths: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Returns the new opacities, `[N]`. Differentiable in all inputs but the widths.
    #[fusion(meta = |inputs| inputs.opacities.0.clone())]
    fn smoothed_opacities(#[extension_type] inputs: SmoothTensors<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of the standard deviations and of the opacities from `grad`, that of the new opacities. Not
    /// differentiable.
    #[fusion(meta = smoothed_opacities_backward_meta)]
    fn smoothed_opacities_backward(
        #[extension_type] inputs: SmoothTensors<Self>,
        grad: FloatTensor<Self>,
    ) -> SmoothGrads<Self>;
}

/// Inputs with a gradient.
const VARIABLE: Smooth<bool> = Smooth { scales: true, opacities: true, widths: false };

#[cfg(feature = "fusion")]
fn smoothed_opacities_backward_meta(
    inputs: &Smooth<InputTensorMetadata>,
    of_output: &burn::backend::fusion::custom::TensorSpec,
) -> Smooth<OptionalTensorMetadata> {
    inputs.each_ref().zip(VARIABLE).map(gradient_of(of_output))
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl SmoothBackend for $backend {
            fn smoothed_scales(scales: FloatTensor<Self>, widths: FloatTensor<Self>) -> FloatTensor<Self> {
                by_type!(scales, F => {
                    let found = smoothed_scales_cpu::<F>(&Self::host(scales.clone()), &Self::host(widths));
                    Self::from_host(found, &scales.shape(), &scales)
                })
            }

            fn smoothed_opacities(inputs: SmoothTensors<Self>) -> FloatTensor<Self> {
                let like = &inputs.opacities.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let found = smoothed_opacities_cpu(read.each_ref().map(|host| &host[..]));
                    Self::from_host(found, &like.shape(), like)
                })
            }

            fn smoothed_opacities_backward(
                inputs: SmoothTensors<Self>,
                grad: FloatTensor<Self>,
            ) -> SmoothGrads<Self> {
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = smoothed_opacities_backward_cpu(slices, &Self::host(grad.clone()));
                    found.zip(VARIABLE).zip(inputs.each_ref()).map(gradient)
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
    use crate::gpu::Gpu;
    use crate::smooth::launch::{
        launch_smoothed_opacities, launch_smoothed_opacities_backward, launch_smoothed_scales,
    };

    impl SmoothBackend for CubeBackend {
        fn smoothed_scales(scales: FloatTensor<Self>, widths: FloatTensor<Self>) -> FloatTensor<Self> {
            let gpu = Gpu::new(&scales.client);
            let found = launch_smoothed_scales(&gpu, &buffer(scales.clone()), &buffer(widths));
            tensor(found, scales.shape(), DType::F32, &scales)
        }

        fn smoothed_opacities(inputs: SmoothTensors<Self>) -> FloatTensor<Self> {
            let like = &inputs.opacities.0;
            let found = launch_smoothed_opacities(&Gpu::new(&like.client), &inputs.each_ref().map(on_device));
            tensor(found, like.shape(), DType::F32, like)
        }

        fn smoothed_opacities_backward(inputs: SmoothTensors<Self>, grad: FloatTensor<Self>) -> SmoothGrads<Self> {
            let (gpu, on_device) = (Gpu::new(&grad.client), inputs.each_ref().map(on_device));
            let (scales, opacities) = launch_smoothed_opacities_backward(&gpu, &on_device, &buffer(grad));
            let found = Smooth { scales: Some(scales), opacities: Some(opacities), widths: None };
            found.zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: SmoothBackend, C: CheckpointStrategy> SmoothBackend for Autodiff<B, C> {
    fn smoothed_scales(scales: FloatTensor<Self>, widths: FloatTensor<Self>) -> FloatTensor<Self> {
        let old = scales.primitive().clone();
        let output = B::smoothed_scales(old.clone(), widths.into_primitive());
        let new = output.clone();
        tracked([&scales], output, move |grad, _| {
            // The derivative is the share of the old in the new one.
            [Some(B::float_mul(grad, B::float_div(old, new))).into()]
        })
    }

    fn smoothed_opacities(inputs: SmoothTensors<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::smoothed_opacities(inner.clone());
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            let found = B::smoothed_opacities_backward(inner, grad).zip(Smooth::from_array(mask));
            found.map(|(found, needed)| if needed { found } else { OptionalTensor::Absent }).into_array()
        })
    }

    fn smoothed_opacities_backward(inputs: SmoothTensors<Self>, grad: FloatTensor<Self>) -> SmoothGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::smoothed_opacities_backward(inner, grad.into_primitive()).map(OptionalTensor::constant)
    }
}
