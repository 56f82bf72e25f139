//! `activate` on Burn's backends, with its backward nodes, and the search for numbers that are not finite.

#![allow(deprecated, reason = "burn-ndarray is deprecated in favour of burn-flex; this project supports both")]

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::ops::IntTensorOps;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, ExtensionType, Flex, NdArray, TensorMetadata, backend_extension};
use burn::tensor::{DType, TensorData};

#[cfg(feature = "fusion")]
use super::fusion;
use super::host::{HostBackend, by_type};
use crate::activate::cpu::{self, all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};

/// Unconstrained parameters; see [`crate::RawSplats`].
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ActivateInputs<B: Backend> {
    /// `[N, 3]`.
    pub means: FloatTensor<B>,
    /// `[N, 4]`.
    pub rotations: FloatTensor<B>,
    /// `[N, 3]`.
    pub log_scales: FloatTensor<B>,
    /// `[N]`.
    pub logit_opacities: FloatTensor<B>,
    /// `[N, K, 3]`.
    pub sh: FloatTensor<B>,
}

/// Activation of parameters, see `activate/`. No method has a default body: a backend that lacks one does not compile.
#[backend_extension(Cube: cfg(feature = "cube"), Flex, NdArray, Autodiff, Fusion: cfg(feature = "fusion"))]
pub trait ActivateBackend: Backend {
    /// Standard deviations, of the shape of `log_scales`, `[N, 3]`.
    #[fusion(dtype = log_scales, shape = log_scales)]
    fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self>;

    /// Opacities, `[N]`. Differentiable in the logits.
    #[fusion(meta = fusion::opacities)]
    fn opacities(#[extension_type] inputs: ActivateInputs<Self>) -> FloatTensor<Self>;

    /// Derivatives of the opacities with respect to their logits, `[N]`. Not differentiable.
    #[fusion(dtype = logit_opacities, shape = logit_opacities)]
    fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self>;

    /// `[1]`: 1 if any value is not finite, else 0. Not differentiable.
    #[fusion(dtype = DType::I32, shape = burn::tensor::Shape::from([1]))]
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

            fn opacities(inputs: ActivateInputs<Self>) -> FloatTensor<Self> {
                let like = inputs.logit_opacities.clone();
                by_type!(like, F => {
                    let ActivateInputs { means, rotations, log_scales, logit_opacities, sh } = inputs;
                    let host = [means, rotations, log_scales, logit_opacities, sh].map(Self::host::<F>);
                    let [means, rotations, log_scales, logit_opacities, sh] = &host;
                    let opacities = opacities_cpu(cpu::Inputs { means, rotations, log_scales, logit_opacities, sh });
                    Self::from_host(opacities, &like.shape(), &like)
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
    use burn_cubecl::CubeBackend;

    use super::*;
    use crate::activate::launch::{
        DeviceInputs, launch_non_finite, launch_opacities, launch_opacity_slopes, launch_scales,
    };
    use crate::bind::cube::{buffer, tensor};
    use crate::gpu::Gpu;

    impl ActivateBackend for CubeBackend {
        fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
            let gpu = Gpu::new(&log_scales.client);
            let scales = launch_scales(&gpu, &buffer(log_scales.clone()));
            tensor(scales, log_scales.shape(), DType::F32, &log_scales)
        }

        fn opacities(inputs: ActivateInputs<Self>) -> FloatTensor<Self> {
            let like = inputs.logit_opacities.clone();
            let gpu = Gpu::new(&like.client);
            let on_device = DeviceInputs {
                means: buffer(inputs.means),
                rotations: buffer(inputs.rotations),
                log_scales: buffer(inputs.log_scales),
                logit_opacities: buffer(inputs.logit_opacities),
                sh: buffer(inputs.sh),
            };
            tensor(launch_opacities(&gpu, &on_device), like.shape(), DType::F32, &like)
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

#[derive(Debug)]
struct ScalesBackward;

impl<B: ActivateBackend> Backward<B, 1> for ScalesBackward {
    /// The output, which is the derivative too, and zero where the input was unusable.
    type State = FloatTensor<B>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        if let [Some(parent)] = ops.parents {
            grads.register::<B>(parent.id, B::float_mul(ops.state, grad));
        }
    }
}

#[derive(Debug)]
struct OpacitiesBackward;

impl<B: ActivateBackend> Backward<B, 1> for OpacitiesBackward {
    /// The logits and the output.
    type State = (FloatTensor<B>, FloatTensor<B>);

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        if let [Some(parent)] = ops.parents {
            let (logit_opacities, opacities) = ops.state;
            let slopes = B::opacity_slopes(logit_opacities, opacities);
            grads.register::<B>(parent.id, B::float_mul(slopes, grad));
        }
    }
}

impl<B: ActivateBackend, C: CheckpointStrategy> ActivateBackend for Autodiff<B, C> {
    fn scales(log_scales: FloatTensor<Self>) -> FloatTensor<Self> {
        let node = log_scales.node();
        let output = B::scales(log_scales.into_primitive());
        match ScalesBackward.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(output.clone(), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn opacities(inputs: ActivateInputs<Self>) -> FloatTensor<Self> {
        let node = inputs.logit_opacities.node();
        let logit_opacities = inputs.logit_opacities.into_primitive();
        let output = B::opacities(ActivateInputs {
            means: inputs.means.into_primitive(),
            rotations: inputs.rotations.into_primitive(),
            log_scales: inputs.log_scales.into_primitive(),
            logit_opacities: logit_opacities.clone(),
            sh: inputs.sh.into_primitive(),
        });
        match OpacitiesBackward.prepare::<C>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((logit_opacities, output.clone()), output),
            OpsKind::UnTracked(prep) => prep.finish(output),
        }
    }

    fn opacity_slopes(logit_opacities: FloatTensor<Self>, opacities: FloatTensor<Self>) -> FloatTensor<Self> {
        FloatTensor::<Self>::new(B::opacity_slopes(logit_opacities.into_primitive(), opacities.into_primitive()))
    }

    fn non_finite(values: FloatTensor<Self>) -> IntTensor<Self> {
        B::non_finite(values.into_primitive())
    }
}
