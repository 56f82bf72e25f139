//! Corrections of poses on Burn's backends, with their backward node.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, NdArray, TensorMetadata, backend_extension};

use super::autodiff::tracked;
use super::cpu::host;
use super::host::{HostBackend, by_type};
use super::tensors::{CorrectedTensors, InputTensor};
use crate::pose::cpu::{corrected_backward_cpu, corrected_cpu};

/// Corrections of a camera's pose; see `pose/`.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait PoseBackend: Backend {
    /// Returns the corrected pose, `[3, 4]`. Differentiable in the correction.
    #[fusion(meta = |inputs, _| inputs.cam_from_world.0.clone())]
    fn corrected_pose(#[extension_type] inputs: CorrectedTensors<Self>, unit: f64) -> FloatTensor<Self>;

    /// Returns the gradient of the correction from `grad`, that of the corrected pose. Not differentiable.
    #[fusion(meta = |inputs, _, _| inputs.correction.0.clone())]
    fn corrected_pose_backward(
        #[extension_type] inputs: CorrectedTensors<Self>,
        grad: FloatTensor<Self>,
        unit: f64,
    ) -> FloatTensor<Self>;
}

macro_rules! cpu_backend {
    ($backend:ty) => {
        impl PoseBackend for $backend {
            fn corrected_pose(inputs: CorrectedTensors<Self>, unit: f64) -> FloatTensor<Self> {
                let like = &inputs.cam_from_world.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    Self::from_host(corrected_cpu(read.each_ref().map(|host| &host[..]), unit), &like.shape(), like)
                })
            }

            fn corrected_pose_backward(
                inputs: CorrectedTensors<Self>,
                grad: FloatTensor<Self>,
                unit: f64,
            ) -> FloatTensor<Self> {
                let like = &inputs.correction.0;
                by_type!(like, F => {
                    let read = inputs.each_ref().map(host::<Self, F>);
                    let slices = read.each_ref().map(|host| &host[..]);
                    let found = corrected_backward_cpu(slices, &Self::host(grad), unit);
                    Self::from_host(found, &like.shape(), like)
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
    use crate::backend::cube::{buffer, on_device, tensor};
    use crate::gpu::Gpu;
    use crate::pose::launch::{launch_corrected, launch_corrected_backward};

    impl PoseBackend for CubeBackend {
        fn corrected_pose(inputs: CorrectedTensors<Self>, unit: f64) -> FloatTensor<Self> {
            let like = &inputs.cam_from_world.0;
            let out = launch_corrected(&Gpu::new(&like.client), &inputs.each_ref().map(on_device), unit);
            tensor(out, like.shape(), DType::F32, like)
        }

        fn corrected_pose_backward(
            inputs: CorrectedTensors<Self>,
            grad: FloatTensor<Self>,
            unit: f64,
        ) -> FloatTensor<Self> {
            let (gpu, like) = (Gpu::new(&grad.client), &inputs.correction.0);
            let out = launch_corrected_backward(&gpu, &inputs.each_ref().map(on_device), &buffer(grad), unit);
            tensor(out, like.shape(), DType::F32, like)
        }
    }
}

impl<B: PoseBackend, C: CheckpointStrategy> PoseBackend for Autodiff<B, C> {
    fn corrected_pose(inputs: CorrectedTensors<Self>, unit: f64) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        let output = B::corrected_pose(inner.clone(), unit);
        tracked([&inputs.correction.0], output, move |grad, _| {
            [Some(B::corrected_pose_backward(inner, grad, unit)).into()]
        })
    }

    fn corrected_pose_backward(
        inputs: CorrectedTensors<Self>,
        grad: FloatTensor<Self>,
        unit: f64,
    ) -> FloatTensor<Self> {
        let inner = inputs.each_ref().map(InputTensor::inner);
        FloatTensor::<Self>::new(B::corrected_pose_backward(inner, grad.into_primitive(), unit))
    }
}
