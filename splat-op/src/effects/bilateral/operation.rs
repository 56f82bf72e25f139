//! The slice of a bilateral grid as an operation.

use super::cpu::{slice_backward_cpu, slice_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_slice, launch_slice_backward};
use super::{SliceSize, Sliced};
use crate::backend::*;

/// The mapped picture, `[3, H, W]`.
#[derive(Clone, Debug)]
pub(super) struct Slice(pub SliceSize);

impl Operation for Slice {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1];

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([slice_cpu(Sliced::from_array(slices(&args.all::<F, 2>())), self.0)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_slice(&args.gpu(), &Sliced::from_array(args.all()), self.0)])
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (read, needs) = (args.all::<F, 2>(), Sliced::from_array(args.needs()));
        let grads = slice_backward_cpu(Sliced::from_array(slices(&read)), &args.only_grad(), self.0, needs);
        float_outputs(grads.into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (inputs, needs) = (Sliced::from_array(args.all()), Sliced::from_array(args.needs()));
        gpu_outputs(launch_slice_backward(&args.gpu(), &inputs, &args.only_grad(), self.0, needs).into_array())
    }
}
