//! Changes of ellipses by shutter and sensor as an operation.

use super::cpu::{expose_backward_cpu, expose_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_expose, launch_expose_backward};
use super::{Exposed, OpticsSpec};
use crate::backend::*;

/// The changed ellipses, `[N, 7]`.
#[derive(Clone, Debug)]
pub(super) struct Expose(pub OpticsSpec);

impl Operation for Expose {
    const DIFFERENTIABLE: &'static [usize] = &[0, 1];

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([expose_cpu(Exposed::from_array(slices(&args.all::<F, 2>())), &self.0)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_expose(&args.gpu(), &Exposed::from_array(args.all()), &self.0)])
    }

    // Whoever tracks one of the inputs nearly always tracks the other, and both gradients come from one kernel.
    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 2>();
        float_outputs(expose_backward_cpu(Exposed::from_array(slices(&read)), &args.only_grad(), &self.0).into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let inputs = Exposed::from_array(args.all());
        gpu_outputs(launch_expose_backward(&args.gpu(), &inputs, &args.only_grad(), &self.0).into_array())
    }
}
