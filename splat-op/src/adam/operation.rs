//! Adam's step and the verdict that makes it skip, as operations on GPUs. On CPUs they are tensor code.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "kernels read the fields"))]

#[cfg(feature = "cube")]
use burn::backend::TensorMetadata;
#[cfg(feature = "cube")]
use burn::tensor::DType;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

#[cfg(feature = "cube")]
use super::launch::{DeviceState, DeviceStep, launch_adam, launch_watch};
use super::packed::PackedFactors;
#[cfg(feature = "cube")]
use super::packed::launch::{DevicePackedStep, launch_adam_packed};
use super::rule::{Factors, VERDICT};
use crate::activate::rule::Raw;
#[cfg(feature = "cube")]
use crate::backend::cube::{buffer, owned};
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::Buffer;

/// Returns a tensor of integers in the type that the kernels use: none of theirs is negative, or they are bits.
#[cfg(feature = "cube")]
fn unsigned(tensor: &CubeTensor, len: usize) -> Buffer<u32> {
    debug_assert!(tensor.dtype == DType::I32 && tensor.shape().num_elements() == len);
    Buffer::from_handle(tensor.handle.clone(), len)
}

#[cfg(feature = "cube")]
fn verdict(args: &GpuArgs, i: usize) -> Option<Buffer<u32>> {
    args.has(i).then(|| unsigned(args.tensor(i), VERDICT))
}

/// Prepares the step of a parameter whose tensors begin at input `first`: parameter, gradient and both moments.
#[cfg(feature = "cube")]
fn prepared(args: &mut GpuArgs, first: usize, factors: Factors) -> DeviceStep {
    let grad = args.buffer(first + 1);
    let [param, m, v] = [first, first + 2, first + 3].map(|i| owned(args.take(i)));
    let band = factors.rate.band(param.shape().as_slice());
    let [param, m, v] = [param, m, v].map(buffer);
    DeviceStep { state: DeviceState { param, m, v }, grad, factors, band }
}

#[cfg(feature = "cube")]
fn stepped(step: DeviceStep) -> [GpuOutput; 3] {
    let DeviceState { param, m, v } = step.state;
    [param, m, v].map(|buffer| Some(buffer.handle))
}

/// One step of a parameter, unless the verdict names a step. Takes the parameter, its gradient, its two moments and, optionally, the
/// verdict, `[2]`; returns the parameter and its moments, in place where nothing else holds their memory.
#[derive(Clone, Debug)]
pub(super) struct Adam(pub Factors);

impl Operation for Adam {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        [0, 2, 3].map(|i| inputs[i].clone()).into()
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, verdict) = (args.gpu(), verdict(&args, 4));
        let step = prepared(&mut args, 0, self.0);
        launch_adam(&gpu, &[&step], verdict.as_ref(), None);
        stepped(step).into()
    }
}

/// One step of all parameters of a scene, unless the verdict names a step. Takes four tensors for each parameter as [`Adam`], the mark,
/// `[1]`, and the verdict; returns three for each parameter, and the mark: set if a coefficient is not usable afterwards, or if nobody
/// looked.
#[derive(Clone, Debug)]
pub(super) struct AdamScene(pub Raw<Factors>);

impl Operation for AdamScene {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        (0..5).flat_map(|i| [0, 2, 3].map(|j| 4 * i + j)).chain([20]).map(|i| inputs[i].clone()).collect()
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, verdict) = (args.gpu(), verdict(&args, 21));
        let mark = owned(args.take(20));
        let mut first = 0;
        let all = self.0.map(|factors| {
            first += 4;
            prepared(&mut args, first - 4, factors)
        });
        let Raw { means, rotations, log_scales, logit_opacities, sh } = all.each_ref();
        // Two launches: a kernel may have 16 buffers, and a parameter takes four.
        launch_adam(&gpu, &[means, rotations, log_scales], verdict.as_ref(), None);
        launch_adam(&gpu, &[logit_opacities, sh], verdict.as_ref(), Some(&unsigned(&mark, 1)));
        all.into_array().into_iter().flat_map(stepped).chain([Some(mark.handle)]).collect()
    }
}

/// One step of a parameter with packed moments, unless the verdict names a step. Takes the parameter, its gradient, the moments,
/// `[N, words]`, and, optionally, the verdict; returns the parameter and the moments.
#[derive(Clone, Debug)]
pub(super) struct AdamPacked(pub PackedFactors);

impl Operation for AdamPacked {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].clone(), inputs[2].clone()]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, verdict, grad) = (args.gpu(), verdict(&args, 3), args.buffer(1));
        let (param, words) = (owned(args.take(0)), owned(args.take(2)));
        let shape = param.shape();
        let dims = shape.as_slice();
        let step = DevicePackedStep {
            grad,
            words: unsigned(&words, words.shape().num_elements()),
            factors: self.0,
            band: self.0.factors.rate.band(dims),
            width: dims[1..].iter().product(),
            param: buffer(param),
        };
        launch_adam_packed(&gpu, &step, verdict.as_ref());
        vec![Some(step.param.handle), Some(words.handle)]
    }
}

/// The verdict, `[2]`, after a check of the loss and of the gradients. Takes the loss, the verdict, and the gradients that there are.
#[derive(Clone, Debug)]
pub(super) struct Watch {
    pub at_step: u32,
}

impl Operation for Watch {
    fn outputs(&self, _: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![Some(Spec::ints([VERDICT]))]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, loss, verdict) = (args.gpu(), args.buffer(0), owned(args.take(1)));
        let gradients = Raw::from_array(std::array::from_fn(|i| args.optional(2 + i)));
        launch_watch(&gpu, &loss, &gradients, &unsigned(&verdict, VERDICT), self.at_step);
        vec![Some(verdict.handle)]
    }
}
