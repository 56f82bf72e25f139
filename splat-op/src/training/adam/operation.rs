//! Adam's step and the verdict that makes it skip, as operations on GPUs. On CPUs they are tensor code.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "kernels read the fields"))]

#[cfg(feature = "cube")]
use burn::backend::TensorMetadata;
#[cfg(feature = "cube")]
use burn::tensor::DType;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

#[cfg(feature = "cube")]
use super::launch::{DeviceStep, launch_adam, launch_watch};
use super::rule::{Factors, VERDICT};
#[cfg(feature = "cube")]
use crate::backend::cube::{buffer, owned};
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::Buffer;

/// Returns a tensor of integers in the type that the kernels use: none of theirs is negative, or they are bits.
#[cfg(feature = "cube")]
pub(super) fn unsigned(tensor: &CubeTensor, len: usize) -> Buffer<u32> {
    // Kernels read it unchecked.
    assert!(tensor.dtype == DType::I32 && tensor.shape().num_elements() == len, "expected {len} integers of 32 bits");
    Buffer::from_handle(tensor.handle.clone(), len)
}

#[cfg(feature = "cube")]
pub(super) fn verdict(args: &GpuArgs, i: usize) -> Option<Buffer<u32>> {
    args.has(i).then(|| unsigned(args.tensor(i), VERDICT))
}

/// Prepares the step of a parameter whose tensors begin at input `first`: parameter, gradient and both moments.
#[cfg(feature = "cube")]
fn prepared(args: &mut GpuArgs, first: usize, factors: Factors) -> DeviceStep {
    let grad = args.buffer(first + 1);
    let [param, m, v] = [first, first + 2, first + 3].map(|i| owned(args.take(i)));
    let band = factors.rate.band(param.shape().as_slice());
    let [param, m, v] = [param, m, v].map(buffer);
    DeviceStep { param, m, v, grad, factors, band }
}

/// One step of some parameters, unless the verdict names a step. Takes, optionally, the verdict, `[2]`, and the mark, `[1]`, and of each
/// parameter itself, its gradient and its two moments; returns the mark, and each parameter and its moments, in place where nothing else
/// holds their memory. The mark is set if a number of the parameter at `marked` is not usable afterwards, or if nobody looked.
#[derive(Clone, Debug)]
pub(super) struct AdamGroups {
    pub factors: Vec<Factors>,
    pub marked: Option<usize>,
}

impl Operation for AdamGroups {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        for tensors in inputs[2..].chunks(4) {
            let same = tensors.iter().all(|tensor| *tensor == tensors[0]);
            assert!(same, "a parameter, its gradient and its moments have one shape, found {tensors:?}");
        }
        let of_steps = (0..self.factors.len()).flat_map(|i| [2, 4, 5].map(|j| 4 * i + j));
        [1].into_iter().chain(of_steps).map(|i| inputs[i].clone()).collect()
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, verdict) = (args.gpu(), verdict(&args, 0));
        let mark = args.has(1).then(|| owned(args.take(1)));
        let steps: Vec<DeviceStep> =
            self.factors.iter().enumerate().map(|(i, factors)| prepared(&mut args, 4 * i + 2, *factors)).collect();
        let mut plain: Vec<&DeviceStep> = steps.iter().collect();
        // A kernel may have 16 buffers, and a parameter takes four. The one with a mark is the second in its launch.
        let marked = self.marked.zip(mark.as_ref()).map(|(at, mark)| (plain.remove(at), mark));
        let before = marked.and_then(|marked| Some((plain.pop()?, marked)));
        plain.chunks(3).for_each(|three| launch_adam(&gpu, three, verdict.as_ref(), None));
        if let Some((before, (step, mark))) = before {
            launch_adam(&gpu, &[before, step], verdict.as_ref(), Some(&unsigned(mark, 1)));
        }
        let states = steps.into_iter().flat_map(|DeviceStep { param, m, v, .. }| [param, m, v]);
        [mark.map(|mark| mark.handle)].into_iter().chain(states.map(|buffer| Some(buffer.handle))).collect()
    }
}

/// The verdict, `[2]`, after a check of the loss and of up to five gradients. Takes the loss, the verdict, and the gradients, each
/// optional, whose bits begin after bit `first`.
#[derive(Clone, Debug)]
pub(super) struct Watch {
    pub at_step: u32,
    pub first: u32,
}

impl Operation for Watch {
    fn outputs(&self, _: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![Some(Spec::ints([VERDICT]))]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, loss, verdict) = (args.gpu(), args.buffer(0), owned(args.take(1)));
        let gradients = std::array::from_fn(|i| args.optional(2 + i));
        launch_watch(&gpu, &loss, &gradients, &unsigned(&verdict, VERDICT), self.at_step, self.first);
        vec![Some(verdict.handle)]
    }
}
