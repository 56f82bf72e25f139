//! Changes of ellipses by shutter and sensor on Burn's backends, with their backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::{gradient, host};
#[cfg(feature = "fusion")]
use super::fusion::grad as gradient_of;
use super::host::{HostBackend, by_type};
use super::tensors::{ExposedGrads, ExposedTensors, InputTensor, OptionalTensor};
#[cfg(feature = "fusion")]
use super::tensors::{InputTensorMetadata, OptionalTensorMetadata};
use crate::optics::cpu::{expose_backward_cpu, expose_cpu};
use crate::optics::{Exposed, OpticsSpec};

/// Changes of ellipses by shutter and sensor; see `optics/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait OpticsBackend: Backend {
    /// Returns the changed ellipses, `[N, 7]`. Differentiable in both inputs.
    #[fusion(meta = |inputs, _| inputs.projected.0.clone())]
    fn expose(#[extension_type] inputs: ExposedTensors<Self>, spec: OpticsSpec) -> FloatTensor<Self>;

    /// Returns the gradients of the inputs from `grad`, that of the changed ellipses. Not differentiable.
    #[fusion(meta = expose_backward_meta)]
    fn expose_backward(
        #[extension_type] inputs: ExposedTensors<Self>,
        grad: FloatTensor<Self>,
        spec: OpticsSpec,
    ) -> ExposedGrads<Self>;
}

/// Whoever tracks one of the inputs nearly always tracks the other, and both gradients come from one kernel.
const BOTH: Exposed<bool> = Exposed { projected: true, twist: true };

#[cfg(feature = "fusion")]
fn expose_backward_meta(
    inputs: &Exposed<InputTensorMetadata>,
    of_output: &burn::backend::fusion::custom::TensorSpec,
    _: &OpticsSpec,
) -> Exposed<OptionalTensorMetadata> {
    inputs.each_ref().zip(BOTH).map(gradient_of(of_output))
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl OpticsBackend for $backend {
            fn expose(inputs: ExposedTensors<Self>, spec: OpticsSpec) -> FloatTensor<Self> {
                let like = &inputs.projected.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    Self::from_host(expose_cpu(read.each_ref().map(|host| &host[..]), &spec), &like.shape(), like)
                })
            }

            fn expose_backward(
                inputs: ExposedTensors<Self>,
                grad: FloatTensor<Self>,
                spec: OpticsSpec,
            ) -> ExposedGrads<Self> {
                by_type!(grad, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = expose_backward_cpu(slices, &Self::host(grad.clone()), &spec);
                    found.zip(BOTH).zip(inputs.each_ref()).map(gradient)
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
    use crate::optics::launch::{launch_expose, launch_expose_backward};

    impl OpticsBackend for CubeBackend {
        fn expose(inputs: ExposedTensors<Self>, spec: OpticsSpec) -> FloatTensor<Self> {
            let like = &inputs.projected.0;
            let out = launch_expose(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), &spec);
            tensor(out, like.shape(), DType::F32, like)
        }

        fn expose_backward(
            inputs: ExposedTensors<Self>,
            grad: FloatTensor<Self>,
            spec: OpticsSpec,
        ) -> ExposedGrads<Self> {
            let (gpu, on_device) = (Gpu::new(&grad.client), inputs.each_ref().map(on_device));
            let found = launch_expose_backward(&gpu, &on_device, &buffer(grad), &spec);
            found.map(Some).zip(inputs.each_ref()).map(cube::gradient)
        }
    }
}

impl<B: OpticsBackend, C: CheckpointStrategy> OpticsBackend for Autodiff<B, C> {
    fn expose(inputs: ExposedTensors<Self>, spec: OpticsSpec) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::expose(inner.clone(), spec);
        tracked(inputs.each_ref().map(|input| &input.0).into_array(), output, move |grad, mask| {
            let found = B::expose_backward(inner, grad, spec).zip(Exposed::from_array(mask));
            found.map(|(found, needed)| if needed { found } else { OptionalTensor::Absent }).into_array()
        })
    }

    fn expose_backward(inputs: ExposedTensors<Self>, grad: FloatTensor<Self>, spec: OpticsSpec) -> ExposedGrads<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        B::expose_backward(inner, grad.into_primitive(), spec).map(OptionalTensor::constant)
    }
}
