//! Corrections of poses as an operation.

use super::Corrected;
use super::cpu::{corrected_backward_cpu, corrected_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_corrected, launch_corrected_backward};
#[cfg(feature = "cube")]
use crate::backend::cube::gpu_outputs;
use crate::backend::host::{float_outputs, slices};
use crate::backend::*;

/// The corrected pose, `[3, 4]`.
#[derive(Clone, Debug)]
pub(super) struct Correct {
    pub unit: f64,
}

impl Operation for Correct {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[1].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([corrected_cpu(Corrected::from_array(slices(&args.all::<F, 2>())), self.unit)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_corrected(&args.gpu(), &Corrected::from_array(args.all()), self.unit)])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 2>();
        let grad = corrected_backward_cpu(Corrected::from_array(slices(&read)), &args.only_grad(), self.unit);
        vec![HostOutput::floats(grad), HostOutput::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let inputs = Corrected::from_array(args.all());
        vec![Some(launch_corrected_backward(&args.gpu(), &inputs, &args.only_grad(), self.unit).handle), None]
    }
}
