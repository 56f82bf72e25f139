//! The miss of known depths on Burn's CPU backends, with its backward node. On GPUs it is tensor code.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
use super::host::{HostBackend, by_type};
use super::tensors::{DepthsGrads, DepthsTensors, InputTensor, OptionalTensor};
use crate::depth_miss::Depths;
use crate::depth_miss::cpu::{depth_miss_backward_cpu, depth_miss_cpu};

/// The miss of known depths; see `depth_miss/`.
#[backend_extension(Flex, NdArray, Autodiff)]
pub trait DepthMissBackend: Backend {
    /// Returns the miss, `[1]`, of samples in `pixels`, `[M]` i32. Differentiable in depth and alpha.
    fn depth_miss(#[extension_type] inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of depth and alpha, if `needs` names them, from `grad`, that of the miss. Not differentiable.
    fn depth_miss_backward(
        #[extension_type] inputs: DepthsTensors<Self>,
        pixels: IntTensor<Self>,
        grad: FloatTensor<Self>,
        needs: Depths<bool>,
    ) -> DepthsGrads<Self>;
}

/// The gradients that exist.
fn computed(needs: Depths<bool>) -> Depths<bool> {
    Depths { known: false, ..needs }
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl DepthMissBackend for $backend {
            fn depth_miss(inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self> {
                let like = &inputs.depth.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let found = depth_miss_cpu(read.each_ref().map(|host| &host[..]), &Self::host_ints(pixels));
                    Self::from_host(found, &[1], like)
                })
            }

            fn depth_miss_backward(
                inputs: DepthsTensors<Self>,
                pixels: IntTensor<Self>,
                grad: FloatTensor<Self>,
                needs: Depths<bool>,
            ) -> DepthsGrads<Self> {
                let needs = computed(needs);
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let grad = Self::host::<F>(grad.clone())[0];
                    let found = depth_miss_backward_cpu(slices, &Self::host_ints(pixels), grad, needs);
                    found.zip(needs).zip(inputs.each_ref()).map(gradient)
                })
            }
        }
    };
}

cpu_backend!(Flex);
cpu_backend!(NdArray);

impl<B: DepthMissBackend, C: CheckpointStrategy> DepthMissBackend for Autodiff<B, C> {
    fn depth_miss(inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::depth_miss(inner.clone(), pixels.clone());
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            B::depth_miss_backward(inner, pixels, grad, Depths::from_array(mask)).into_array()
        })
    }

    fn depth_miss_backward(
        inputs: DepthsTensors<Self>,
        pixels: IntTensor<Self>,
        grad: FloatTensor<Self>,
        needs: Depths<bool>,
    ) -> DepthsGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::depth_miss_backward(inner, pixels, grad.into_primitive(), needs).map(OptionalTensor::constant)
    }
}
