//! The tally as an operation on GPUs. On CPUs it is tensor code.

#![cfg_attr(not(feature = "cube"), allow(dead_code, reason = "kernels read the fields"))]

#[cfg(feature = "cube")]
use super::launch::launch_tally;
#[cfg(feature = "cube")]
use crate::backend::cube::{buffer, owned};
use crate::backend::*;
#[cfg(feature = "cube")]
use crate::gpu::Buffer;

/// Adds the gradients of one step, `[N, 2]`. Takes them and, from the second step on, sums of norms and numbers of steps, `[N]` each;
/// returns the latter.
#[derive(Clone, Debug)]
pub(super) struct AddToTally {
    pub per_axis: [f32; 2],
}

impl Operation for AddToTally {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].as_ref().map(|grad| grad.with_shape([grad.shape[0]])); 2]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, mut args: GpuArgs) -> Vec<GpuOutput> {
        let (gpu, grad, count) = (args.gpu(), args.buffer(0), args.shape(0)[0]);
        let begins = !args.has(1);
        let [sums, counts] = [1, 2].map(|i| match begins {
            true => Buffer::<f32>::new(&gpu, count),
            false => buffer(owned(args.take(i))),
        });
        launch_tally(&gpu, &grad, &sums, &counts, self.per_axis, begins);
        vec![Some(sums.handle), Some(counts.handle)]
    }
}
