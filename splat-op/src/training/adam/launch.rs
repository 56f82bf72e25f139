//! Launches of Adam's step and of the check for finite values.

use cubecl::prelude::ComptimeOptionArgs;

use super::forward::{AdamParamLaunch, StepFactorsLaunch, WatchedCountsLaunch, adam_kernel, watch_kernel};
use super::rule::{Band, Factors, WATCHED};
use crate::gpu::{Buffer, Gpu, given, launch_unchecked, search};

/// The step of one parameter: itself and its moments, which change in place, its gradient, all of one length, and its factors. `band` has the
/// first of the two rates.
#[derive(Clone)]
pub(crate) struct DeviceStep {
    pub param: Buffer<f32>,
    pub m: Buffer<f32>,
    pub v: Buffer<f32>,
    pub grad: Buffer<f32>,
    pub factors: Factors,
    pub band: Option<Band>,
}

impl DeviceStep {
    fn arg(&self) -> AdamParamLaunch {
        let Self { param, m, v, grad, factors, band } = self;
        let factors = factors_arg(factors);
        AdamParamLaunch::new(param.arg(), m.arg(), v.arg(), grad.arg(), factors, grad.len as u32, *band)
    }
}

pub(super) fn factors_arg(factors: &Factors) -> StepFactorsLaunch {
    StepFactorsLaunch::new(
        factors.beta1 as f32,
        factors.beta2 as f32,
        factors.rate.others as f32,
        factors.rate.first as f32,
        factors.floor as f32,
        factors.largest as f32,
    )
}

/// Performs the steps of one to three parameters in place. Nothing changes where `verdict`, `[2]`, names a step. Sets `mark`, `[1]`, if
/// a number of the second parameter is not usable afterwards, or if the verdict holds the steps back.
pub(crate) fn launch_adam(gpu: &Gpu, steps: &[&DeviceStep], verdict: Option<&Buffer<u32>>, mark: Option<&Buffer<u32>>) {
    let (first, others) = steps.split_first().expect("at least one parameter");
    let count: usize = steps.iter().map(|step| step.grad.len).sum();
    let other = |i: usize| ComptimeOptionArgs::from(others.get(i).map(|step| step.arg()));
    let (unused, marks) = (Buffer::new(gpu, 0), mark.is_some());
    // SAFETY: every access is guarded by the lengths given, which the buffers of a parameter share.
    launch_unchecked!(
        gpu.units(count),
        adam_kernel(first.arg(), other(0), other(1), verdict, mark.unwrap_or(&unused), marks)
    );
}

/// Enters `at_step` in `verdict`, `[2]`, if no earlier step is entered and the loss or a gradient has a value that is not finite, with
/// bit 0 for the loss and bits from `first + 1` on for the gradients.
pub(crate) fn launch_watch(
    gpu: &Gpu,
    loss: &Buffer<f32>,
    gradients: &[Option<Buffer<f32>>; WATCHED],
    verdict: &Buffer<u32>,
    at_step: u32,
    first: u32,
) {
    let [a, b, c, d, e] = gradients.each_ref().map(Option::as_ref);
    let all = [Some(loss), a, b, c, d, e].map(|found| found.filter(|found| found.len > 0));
    let (grid, dim, stride) = search(all.iter().flatten().map(|values| values.len).max().unwrap_or(0));
    let [n0, n1, n2, n3, n4, n5] = all.map(|values| values.map_or(0, |values| values.len as u32));
    let counts = WatchedCountsLaunch::new(n0, n1, n2, n3, n4, n5);
    let given = given(all.each_ref());
    let [loss, a, b, c, d, e] = all;
    // SAFETY: every access is guarded by the lengths given; a verdict has two numbers.
    launch_unchecked!(
        (&gpu.client, grid, dim),
        watch_kernel(loss, a, b, c, d, e, verdict, counts, stride, at_step, first, given)
    );
}
