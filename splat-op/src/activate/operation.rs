//! The activation and the check for values that are not finite, as operations.

use super::cpu::{all_finite_cpu, opacities_cpu, opacity_slopes_cpu, scales_cpu};
#[cfg(feature = "cube")]
use super::launch::{launch_activate, launch_non_finite, launch_opacities_backward, launch_scales};
use super::rule::Raw;
#[cfg(feature = "cube")]
use crate::backend::cube::{bound, product};
use crate::backend::host::{found, slices};
use crate::backend::*;

/// Standard deviations `[N, 3]` from their logarithms.
#[derive(Clone, Debug)]
pub(super) struct Scales;

impl Operation for Scales {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        inputs.to_vec()
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        found([scales_cpu(&args.floats(0))])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<Bound> {
        bound([launch_scales(&args.gpu(), &args.buffer(0))])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[0]
    }

    fn keeps_outputs(&self) -> bool {
        true
    }

    // The scales equal the derivatives, and are zero where the logarithm was unusable.
    fn run_backward<F: Real>(&self, _: &HostArgs) -> Vec<Found<F>> {
        vec![Found::Product(0)]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<Bound> {
        vec![args.grad(0).map(|grad| product(args.output(0), grad))]
    }
}

/// Standard deviations and opacities of raw parameters and, optionally, a mark, `[1]`. A GPU does not read the coefficients if the mark is
/// zero: all of them are then known to be usable.
#[derive(Clone, Debug)]
pub(super) struct Activated;

impl Operation for Activated {
    fn outputs(&self, inputs: &[Option<Spec>]) -> Vec<Option<Spec>> {
        vec![inputs[2].clone(), inputs[3].clone()]
    }

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let read = args.all::<F, 5>();
        let raw = Raw::from_array(slices(&read));
        found([scales_cpu(raw.log_scales), opacities_cpu(raw)])
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<Bound> {
        let (scales, opacities) = launch_activate(&args.gpu(), &Raw::from_array(args.all()), args.optional(5).as_ref());
        bound([scales, opacities])
    }

    fn differentiable(&self) -> &'static [usize] {
        &[2, 3]
    }

    fn depends(&self, output: usize, input: usize) -> bool {
        input == output + 2
    }

    fn keeps_outputs(&self) -> bool {
        true
    }

    fn run_backward<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        let [_, _, of_logs, of_logits] = args.needs();
        let of_logits = of_logits.then(|| {
            let mut slopes = opacity_slopes_cpu::<F>(&args.floats(3), &args.output(1));
            let grad = args.grad::<F>(1).expect("a gradient reaches the logits");
            slopes.iter_mut().zip(grad.iter()).for_each(|(slope, &grad)| *slope *= grad);
            Found::Floats(slopes)
        });
        let of_logs = if of_logs { Found::Product(0) } else { Found::Nothing };
        let of_logits = of_logits.unwrap_or(Found::Nothing);
        vec![Found::Nothing, Found::Nothing, of_logs, of_logits, Found::Nothing, Found::Nothing]
    }

    #[cfg(feature = "cube")]
    fn launch_backward(&self, args: GpuArgs) -> Vec<Bound> {
        use crate::backend::cube::buffer;

        let of_logs = args.grad(0).map(|grad| product(args.output(0), grad));
        let of_logits = args.grad(1).map(|grad| {
            let opacities = buffer(args.output(1).clone());
            launch_opacities_backward(&args.gpu(), &args.buffer(3), &opacities, &buffer(grad)).handle
        });
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

    fn run<F: Real>(&self, args: &HostArgs) -> Vec<Found<F>> {
        vec![Found::Ints(vec![i32::from(!all_finite_cpu::<F>(&args.floats(0)))])]
    }

    #[cfg(feature = "cube")]
    fn launch(&self, args: GpuArgs) -> Vec<Bound> {
        bound([launch_non_finite(&args.gpu(), &args.buffer(0))])
    }
}
