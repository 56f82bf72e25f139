//! The activation and the check for values that are not finite, as operations.

use super::cpu::{all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_activate, launch_non_finite};
use super::rule::Raw;
use crate::backend::*;

/// Standard deviations and opacities of raw parameters and, optionally, a mark, `[1]`. A GPU does not read the coefficients if the mark is
/// zero: all of them are then known to be usable.
#[derive(Clone, Debug)]
pub(super) struct Activated;

impl Operation for Activated {
    const DIFFERENTIABLE: &'static [usize] = &[2, 3];
    const KEEPS_OUTPUTS: bool = true;

    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[2].clone(), inputs[3].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let read = args.all::<F, 5>();
        let raw = Raw::from_array(slices(&read));
        float_outputs([scales_cpu(raw.log_scales), opacities_cpu(raw)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        let (scales, opacities) = launch_activate(&args.gpu(), &Raw::from_array(args.all()), args.optional(5).as_ref());
        gpu_outputs([scales, opacities])
    }

    fn depends(&self, output: usize, input: usize) -> bool {
        input == output + 2
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        let [_, _, of_logs, of_logits] = args.needs();
        let of_logits = of_logits.then(|| {
            let mut slopes = opacity_slopes_cpu::<F>(&args.floats(3), &args.output(1));
            let grad = args.grad::<F>(1).expect("a gradient reaches the logits");
            slopes.iter_mut().zip(grad.iter()).for_each(|(slope, &grad)| *slope *= grad);
            HostOutput::floats(slopes)
        });
        let of_logs = if of_logs { HostOutput::Product(0) } else { HostOutput::Nothing };
        let of_logits = of_logits.unwrap_or(HostOutput::Nothing);
        vec![HostOutput::Nothing, HostOutput::Nothing, of_logs, of_logits, HostOutput::Nothing, HostOutput::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<GpuOutput> {
        use super::launch::{ActivatedGrads, launch_activate_backward};

        let inputs = ActivatedGrads {
            logit_opacities: args.buffer(3),
            scales: buffer(args.output(0).clone()),
            opacities: buffer(args.output(1).clone()),
            grad_scales: args.grad(0).map(buffer),
            grad_opacities: args.grad(1).map(buffer),
        };
        let [of_logs, of_logits] =
            launch_activate_backward(&args.gpu(), &inputs).map(|grad| grad.map(|grad| grad.handle));
        vec![None, None, of_logs, of_logits, None, None]
    }
}

/// 1 if any value is not finite, else 0; `[1]`.
#[derive(Clone, Debug)]
pub(super) struct NonFinite;

impl Operation for NonFinite {
    fn outputs(&self, _: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![Some(Spec::ints([1]))]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<HostOutput> {
        vec![HostOutput::ints(vec![i32::from(!all_finite_cpu::<F>(&args.floats(0)))])]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<GpuOutput> {
        gpu_outputs([launch_non_finite(&args.gpu(), &args.buffer(0))])
    }
}
