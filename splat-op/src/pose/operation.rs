//! Corrections of poses, and the miss of a pose, as operations.

use super::cpu::{corrected_backward_cpu, corrected_cpu, miss_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_corrected, launch_corrected_backward};
use super::{Corrected, Sighted};
#[cfg(feature = "cube")]
use crate::backend::cube::bound;
use crate::backend::host::{found, slices};
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

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        found([corrected_cpu(Corrected::from_array(slices(&args.all::<F, 2>())), self.unit)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<Bound> {
        bound([launch_corrected(&args.gpu(), &Corrected::from_array(args.all()), self.unit)])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let read = args.all::<F, 2>();
        let grad = corrected_backward_cpu(Corrected::from_array(slices(&read)), &args.only_grad(), self.unit);
        vec![Found::Floats(grad), Found::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<Bound> {
        let inputs = Corrected::from_array(args.all());
        vec![Some(launch_corrected_backward(&args.gpu(), &inputs, &args.only_grad(), self.unit).handle), None]
    }
}

/// The miss of a pose, `[1]`, and its derivative, on CPUs. On GPUs it is tensor code.
#[derive(Clone, Debug)]
pub(super) struct PoseMiss {
    /// The `r` of the module's formula.
    pub scale: f64,
}

impl Operation for PoseMiss {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        let pose = inputs[0].clone();
        vec![pose.as_ref().map(|pose| pose.with_shape([1])), pose]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let (value, gradient) = miss_cpu(Sighted::from_array(slices(&args.all::<F, 3>())), self.scale);
        found([vec![value], gradient])
    }
}
