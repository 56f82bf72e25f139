//! `activate` on Burn's backends, with its backward nodes, and the check for values that are not finite.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::ops::{FloatTensorOps, IntTensorOps};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, ExtensionType, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::TensorData;

use super::autodiff::tracked;
use super::cpu::host;
use super::host::{HostBackend, by_type};
use super::tensors::{InputTensor, OptionalIntTensor, RawTensors};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalIntTensorMetadata};
use crate::activate::cpu::{all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};
#[cfg(feature = "fusion")]
use crate::activate::rule::Raw;

/// Activated parameters.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct Activated<B: Backend> {
    /// `[N, 3]`: standard deviations.
    pub scales: FloatTensor<B>,
    /// `[N]`: opacities.
    pub opacities: FloatTensor<B>,
}

/// Activation of the parameters; see `activate/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait ActivateBackend: Backend {
    /// Returns the standard deviations from `log_scales`, both `[N, 3]`.
    #[fusion(dtype = log_scales, shape = log_scales)]
    fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Returns the standard deviations and the opacities. Differentiable in the logarithms and in the logits. A GPU does not read
    /// the coefficients if `mark`, `[1]`, is zero: all of them are then known to be usable.
    #[fusion(meta = activated_meta)]
    fn activated(
        #[extension_type] inputs: RawTensors<Self>,
        #[extension_type] mark: OptionalIntTensor<Self>,
    ) -> Activated<Self>;

    /// Returns the gradients of the logits, `[N]`, from `grad`, those of the opacities. Not differentiable.
    #[fusion(dtype = logit_opacities, shape = logit_opacities)]
    fn opacities_backward(
        logit_opacities: FloatTensor<Self>,
        opacities: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> FloatTensor<Self>;

    /// Returns 1 if any value is not finite, else 0; `[1]`. Not differentiable.
    #[fusion(dtype = burn::tensor::DType::I32, shape = burn::tensor::Shape::from([1]))]
    fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self>;
}

#[cfg(feature = "fusion")]
fn activated_meta(inputs: &Raw<InputTensorMetadata>, _: &OptionalIntTensorMetadata) -> ActivatedMetadata {
    ActivatedMetadata { scales: inputs.log_scales.0.clone(), opacities: inputs.logit_opacities.0.clone() }
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

            fn activated(inputs: RawTensors<Self>, _: OptionalIntTensor<Self>) -> Activated<Self> {
                let scales = Self::scales(inputs.log_scales.0.clone());
                let like = &inputs.logit_opacities.0;
                let opacities = by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let opacities = opacities_cpu(read.each_ref().map(|host| &host[..]));
                    Self::from_host(opacities, &like.shape(), like)
                });
                Activated { scales, opacities }
            }

            fn opacities_backward(
                logit_opacities: FloatTensor<Self>,
                opacities: FloatTensor<Self>,
                grad: FloatTensor<Self>,
            ) -> FloatTensor<Self> {
                let slopes = by_type!(opacities, F => {
                    let like = logit_opacities.clone();
                    let slopes = opacity_slopes_cpu::<F>(&Self::host(logit_opacities), &Self::host(opacities));
                    Self::from_host(slopes, &like.shape(), &like)
                });
                Self::float_mul(slopes, grad)
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
    use crate::activate::launch::{launch_activate, launch_non_finite, launch_opacities_backward, launch_scales};
    use crate::backend::cube::{buffer, on_device, tensor};
    use crate::gpu::{Buffer, Gpu};

    impl ActivateBackend for CubeBackend {
        fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
            let gpu = Gpu::new(&log_scales.client);
            let scales = launch_scales(&gpu, &buffer(log_scales.clone()));
            tensor(scales, log_scales.shape(), DType::F32, &log_scales)
        }

        fn activated(inputs: RawTensors<Self>, mark: OptionalIntTensor<Self>) -> Activated<Self> {
            let (logs, logits) = (&inputs.log_scales.0, &inputs.logit_opacities.0);
            let mark = mark.into_option().map(|mark| Buffer::from_handle(mark.handle, 1));
            let on_device = inputs.each_ref().map(on_device);
            let (scales, opacities) = launch_activate(&Gpu::new(&logits.client), &on_device, mark.as_ref());
            Activated {
                scales: tensor(scales, logs.shape(), DType::F32, logs),
                opacities: tensor(opacities, logits.shape(), DType::F32, logits),
            }
        }

        fn opacities_backward(
            logit_opacities: FloatTensor<Self>,
            opacities: FloatTensor<Self>,
            grad: FloatTensor<Self>,
        ) -> FloatTensor<Self> {
            let like = logit_opacities.clone();
            let gpu = Gpu::new(&like.client);
            let found = launch_opacities_backward(&gpu, &buffer(logit_opacities), &buffer(opacities), &buffer(grad));
            tensor(found, like.shape(), DType::F32, &like)
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
        tracked_scales::<B, C>(&log_scales, output)
    }

    fn activated(inputs: RawTensors<Self>, mark: OptionalIntTensor<Self>) -> Activated<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let logit_opacities = inner.logit_opacities.0.clone();
        let mark = match mark {
            OptionalIntTensor::Absent => OptionalIntTensor::Absent,
            OptionalIntTensor::Present(mark) => OptionalIntTensor::Present(mark),
        };
        let Activated { scales, opacities: output } = B::activated(inner, mark);
        let opacities = output.clone();
        Activated {
            scales: tracked_scales::<B, C>(&inputs.log_scales.0, scales),
            opacities: tracked([&inputs.logit_opacities.0], output, move |grad, _| {
                [Some(B::opacities_backward(logit_opacities, opacities, grad)).into()]
            }),
        }
    }

    fn opacities_backward(
        logit_opacities: FloatTensor<Self>,
        opacities: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> FloatTensor<Self> {
        let [logit_opacities, opacities, grad] =
            [logit_opacities, opacities, grad].map(FloatTensor::<Self>::into_primitive);
        FloatTensor::<Self>::new(B::opacities_backward(logit_opacities, opacities, grad))
    }

    fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self> {
        B::non_finite(values.into_primitive())
    }
}

/// Returns standard deviations as a function of their logarithms.
fn tracked_scales<B: ActivateBackend, C: CheckpointStrategy>(
    log_scales: &FloatTensor<Autodiff<B, C>>,
    scales: FloatTensor<B>,
) -> FloatTensor<Autodiff<B, C>> {
    // The scales equal the derivatives, and are zero where the logarithm was unusable.
    let slopes = scales.clone();
    tracked([log_scales], scales, move |grad, _| [Some(B::float_mul(slopes, grad)).into()])
}
