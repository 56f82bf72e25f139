//! The sort of rows as operations. Not differentiable.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "kernels read the fields"))]

use burn::tensor::DType;

use super::cpu::argsort_cpu;
use crate::backend::*;

/// The order of whole numbers below `2^bits`, or of numbers in f32 that are not negative, `[N]`, i32.
#[derive(Clone, Debug)]
pub(super) struct Argsort {
    pub bits: u32,
    pub are_floats: bool,
}

impl Operation for Argsort {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].clone().map(|keys| Spec { dtype: DType::I32, ..keys })]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::ints(match self.are_floats {
            // The bits of floats that are not negative are in the order of the floats.
            true => argsort_cpu(args.floats::<F>(0).iter().map(|key| (key.f64() as f32).to_bits())),
            false => argsort_cpu(args.ints(0).iter().map(|&key| key as u32)),
        })]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        use crate::gpu::Buffer;
        use crate::intersect::sort::launch_sort;

        let (gpu, len) = (args.gpu(), args.shape(0).num_elements());
        if len == 0 {
            return vec![Some(Buffer::<i32>::new(&gpu, 0).handle)];
        }
        // The sort writes over its keys.
        let order = launch_sort(&gpu, buffer(owned(args.take(0))), None, self.bits).indices;
        let room = order.handle.size_in_used() - 4 * len as u64;
        vec![Some(order.handle.offset_end(room))]
    }
}
