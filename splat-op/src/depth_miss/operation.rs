//! The miss of known depths as an operation on CPUs. On GPUs it is tensor code.

use super::Depths;
use super::cpu::{depth_miss_backward_cpu, depth_miss_cpu};
use crate::backend::host::{found, slices};
use crate::backend::*;

/// The miss, `[1]`, of samples in pixels, `[M]`, which are the fourth input.
#[derive(Clone, Debug)]
pub(super) struct DepthMiss;

impl Operation for DepthMiss {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[0].as_ref().map(|depth| depth.with_shape([1]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        found([depth_miss_cpu(Depths::from_array(slices(&args.all::<F, 3>())), &args.ints(3))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let (read, needs) = (args.all::<F, 3>(), Depths::from_array(args.needs()));
        let grad = args.only_grad::<F>()[0];
        let grads = depth_miss_backward_cpu(Depths::from_array(slices(&read)), &args.ints(3), grad, needs);
        found(grads.into_array()).into_iter().chain([Found::Nothing]).collect()
    }
}
