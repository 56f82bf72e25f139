//! The miss of known depths on Burn's backends, with its backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::{float, grad as gradient_of};
use super::host::{HostBackend, by_type};
use super::tensors::{DepthsGrads, DepthsTensors, InputTensor, OptionalTensor};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::depth_miss::Depths;
use crate::depth_miss::cpu::{depth_miss_backward_cpu, depth_miss_cpu};

/// The miss of known depths; see `depth_miss/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait DepthMissBackend: Backend {
    /// Returns the miss, `[1]`, of samples in `pixels`, `[M]` i32. Differentiable in depth and alpha.
    #[fusion(meta = |inputs, _| float([1], &inputs.depth.0))]
    fn depth_miss(#[extension_type] inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self>;

    /// Returns the gradients of depth and alpha, if `needs` names them, from `grad`, that of the miss. Not differentiable.
    #[fusion(meta = depth_miss_backward_meta)]
    fn depth_miss_backward(
        #[extension_type] inputs: DepthsTensors<Self>,
        pixels: IntTensor<Self>,
        grad: FloatTensor<Self>,
        needs: Depths<bool>,
    ) -> DepthsGrads<Self>;
}

#[cfg(feature = "fusion")]
fn depth_miss_backward_meta(
    inputs: &Depths<InputTensorMetadata>,
    _: &burn::backend::fusion::custom::TensorSpec,
    of_output: &burn::backend::fusion::custom::TensorSpec,
    needs: &Depths<bool>,
) -> Depths<OptionalTensorMetadata> {
    inputs.each_ref().zip(computed(*needs)).map(gradient_of(of_output))
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

#[cfg(feature = "cube")]
mod gpu {
    use burn::tensor::DType;
    use burn_cubecl::CubeBackend;
    use burn_cubecl::kernel::into_contiguous;
    use burn_cubecl::tensor::CubeTensor;

    use super::*;
    use crate::backend::cube::{self, buffer, on_device, tensor};
    use crate::depth_miss::launch::{launch_depth_miss, launch_depth_miss_backward};
    use crate::gpu::{Buffer, Gpu};

    /// The bits of i32 as u32, so that pixels below zero are beyond all others.
    fn pixels_of(tensor: CubeTensor) -> Buffer<u32> {
        let tensor = into_contiguous(tensor);
        let len = tensor.meta.num_elements();
        Buffer::from_handle(tensor.handle, len)
    }

    impl DepthMissBackend for CubeBackend {
        fn depth_miss(inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self> {
            let like = &inputs.depth.0;
            let gpu = Gpu::new(&like.client);
            let out = launch_depth_miss(&gpu, &inputs.each_ref().map(on_device), &pixels_of(pixels));
            tensor(out, [1], DType::F32, like)
        }

        fn depth_miss_backward(
            inputs: DepthsTensors<Self>,
            pixels: IntTensor<Self>,
            grad: FloatTensor<Self>,
            needs: Depths<bool>,
        ) -> DepthsGrads<Self> {
            let (gpu, on_device) = (Gpu::new(&grad.client), inputs.each_ref().map(on_device));
            let [depth, alpha] = launch_depth_miss_backward(&gpu, &on_device, &pixels_of(pixels), &buffer(grad));
            let found = Depths { depth: Some(depth), alpha: Some(alpha), known: None };
            let found = found.zip(needs).map(|(found, needed)| found.filter(|_| needed));
            found.zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: DepthMissBackend, C: CheckpointStrategy> DepthMissBackend for Autodiff<B, C> {
    fn depth_miss(inputs: DepthsTensors<Self>, pixels: IntTensor<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::depth_miss(inner.clone(), pixels.clone());
        tracked::<B, C, _, _>(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
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
