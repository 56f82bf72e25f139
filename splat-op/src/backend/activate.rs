//! `activate` on Burn's backends, with its backward nodes, and the check for values that are not finite.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::ops::IntTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::TensorData;

use super::autodiff::tracked;
use super::cpu::host;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, RawTensors};
use crate::activate::cpu::{all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};

/// Activation of the parameters; see `activate/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait ActivateBackend: Backend {
    /// Returns the standard deviations from `log_scales`, both `[N, 3]`.
    #[fusion(dtype = log_scales, shape = log_scales)]
    fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Returns the opacities, `[N]`. Differentiable in the logits.
    #[fusion(meta = |inputs| inputs.logit_opacities.0.clone())]
    fn opacities(#[extension_type] inputs: RawTensors<Self>) -> FloatTensor<Self>;

    /// Returns the derivatives of the opacities with respect to their logits, `[N]`. Not differentiable.
    #[fusion(dtype = logit_opacities, shape = logit_opacities)]
    fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Returns 1 if any value is not finite, else 0; `[1]`. Not differentiable.
    #[fusion(dtype = burn::tensor::DType::I32, shape = burn::tensor::Shape::from([1]))]
    fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self>;
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl ActivateBackend for $backend {
            fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
                by_type!(log_scales, F => {
                    let scales = scales_cpu::<F>(&Self::host(log_scales.clone()));
                    Self::from_host(scales, &log_scales.shape(), &log_scales)
                })
            }

            fn opacities(inputs: RawTensors<Self>) -> FloatTensor<Self> {
                let like = &inputs.logit_opacities.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let opacities = opacities_cpu(read.each_ref().map(|host| &host[..]));
                    Self::from_host(opacities, &like.shape(), like)
                })
            }

            fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self> {
                by_type!(opacities, F => {
                    let like = logit_opacities.clone();
                    let slopes = opacity_slopes_cpu::<F>(&Self::host(logit_opacities), &Self::host(opacities));
                    Self::from_host(slopes, &like.shape(), &like)
                })
            }

            fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self> {
                let device = values.device();
                let found = by_type!(values, F => !all_finite_cpu::<F>(&Self::host(values)));
                Self::int_from_data(TensorData::new(vec![i32::from(found)], [1]), &device)
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
    use crate::activate::launch::{launch_non_finite, launch_opacities, launch_opacity_slopes, launch_scales};
    use crate::backend::cube::{buffer, on_device, tensor};
    use crate::gpu::Gpu;

    impl ActivateBackend for CubeBackend {
        fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
            let gpu = Gpu::new(&log_scales.client);
            let scales = launch_scales(&gpu, &buffer(log_scales.clone()));
            tensor(scales, log_scales.shape(), DType::F32, &log_scales)
        }

        fn opacities(inputs: RawTensors<Self>) -> FloatTensor<Self> {
            let like = &inputs.logit_opacities.0;
            let opacities = launch_opacities(&Gpu::new(&like.client), &inputs.each_ref().map(on_device));
            tensor(opacities, like.shape(), DType::F32, like)
        }

        fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self> {
            let like = logit_opacities.clone();
            let gpu = Gpu::new(&like.client);
            let slopes = launch_opacity_slopes(&gpu, &buffer(logit_opacities), &buffer(opacities));
            tensor(slopes, like.shape(), DType::F32, &like)
        }

        fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self> {
            let gpu = Gpu::new(&values.client);
            tensor(launch_non_finite(&gpu, &buffer(values.clone())), [1], DType::I32, &values)
        }
    }
}

impl<B: ActivateBackend, C: CheckpointStrategy> ActivateBackend for Autodiff<B, C> {
    fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
        let output = B::scales(log_scales.primitive().clone());
        // The output equals the derivative, and is zero where the input was unusable.
        let slopes = output.clone();
        tracked::<B, C, _, _>([&log_scales], output, move |grad, _| [Some(B::float_mul(slopes, grad)).into()])
    }

    fn opacities(inputs: RawTensors<Self>) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let logit_opacities = inner.logit_opacities.0.clone();
        let output = B::opacities(inner);
        let opacities = output.clone();
        tracked::<B, C, _, _>([&inputs.logit_opacities.0], output, move |grad, _| {
            [Some(B::float_mul(B::opacity_slopes(logit_opacities, opacities), grad)).into()]
        })
    }

    fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::opacity_slopes(logit_opacities.into_primitive(), opacities.into_primitive()))
    }

    fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self> {
        B::non_finite(values.into_primitive())
    }
}
