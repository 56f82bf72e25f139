//! The convolution of Gaussians with filters of their own widths as operations.

use super::Smooth;
use super::cpu::{smoothed_opacities_backward_cpu, smoothed_opacities_cpu, smoothed_scales_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_smoothed_opacities, launch_smoothed_opacities_backward, launch_smoothed_scales};
#[cfg(feature = "cube")]
use crate::backend::cube::gpu_outputs;
use crate::backend::host::{float_outputs, slices};
use crate::backend::*;

/// The new standard deviations, `[N, 3]`, from the old ones and the widths.
#[derive(Clone, Debug)]
pub(super) struct SmoothedScales;

impl Operation for SmoothedScales {
    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([smoothed_scales_cpu(&args.floats::<F>(0), &args.floats(1))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_smoothed_scales(&args.gpu(), &args.buffer(0), &args.buffer(1))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0]
    }

    fn keeps_outputs(&self) -> bool {
        true
    }

    // The derivative is the share of the old in the new one.
    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let (old, new, grad) = (args.floats::<F>(0), args.output::<F>(0), args.only_grad::<F>());
        let grads = old.iter().zip(new.iter()).zip(grad.iter()).map(|((&old, &new), &grad)| grad * (old / new));
        vec![HostOutput::floats(grads.collect()), HostOutput::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        use burn::backend::ops::FloatTensorOps;
        use burn_cubecl::CubeBackend;

        use crate::backend::cube::buffer;

        let share = CubeBackend::float_div(args.tensor(0).clone(), args.output(0).clone());
        vec![args.grad(0).map(|grad| buffer::<f32>(CubeBackend::float_mul(share, grad)).handle), None]
    }
}

/// The new opacities, `[N]`.
#[derive(Clone, Debug)]
pub(super) struct SmoothedOpacities;

impl Operation for SmoothedOpacities {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[1].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        float_outputs([smoothed_opacities_cpu(Smooth::from_array(slices(&args.all::<F, 3>())))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_smoothed_opacities(&args.gpu(), &Smooth::from_array(args.all()))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0, 1]
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 3>();
        let grads = smoothed_opacities_backward_cpu(Smooth::from_array(slices(&read)), &args.only_grad());
        float_outputs(grads.into_array())
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let inputs = Smooth::from_array(args.all());
        let (scales, opacities) = launch_smoothed_opacities_backward(&args.gpu(), &inputs, &args.only_grad());
        vec![Some(scales.handle), Some(opacities.handle), None]
    }
}
