//! Launches of Adam's step and of the check for finite values.

use super::forward::{StepFactorsLaunch, adam_kernel, watch_kernel};
use super::rule::{Band, Factors};
use crate::gpu::{Buffer, Gpu, elementwise, search};

/// A parameter and its moments on the device, all of one length.
#[derive(Clone)]
pub(crate) struct DeviceState {
    pub param: Buffer<f32>,
    pub m: Buffer<f32>,
    pub v: Buffer<f32>,
}

/// Performs one step in place. `band` has the first of the two rates. Nothing changes where `verdict`, `[2]`, names a step.
pub(crate) fn launch_adam(
    gpu: &Gpu,
    state: &DeviceState,
    grad: &Buffer<f32>,
    verdict: Option<&Buffer<u32>>,
    factors: &Factors,
    band: Option<Band>,
) {
    let count = state.param.len;
    if count == 0 {
        return;
    }
    let (grid, dim) = elementwise(count);
    // SAFETY: every access is guarded by the length given, which all buffers share.
    unsafe {
        adam_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            state.param.arg(),
            state.m.arg(),
            state.v.arg(),
            grad.arg(),
            verdict.map(Buffer::arg).into(),
            StepFactorsLaunch::new(
                factors.beta1 as f32,
                factors.beta2 as f32,
                factors.rate.others as f32,
                factors.rate.first as f32,
                factors.floor as f32,
                factors.largest as f32,
            ),
            count as u32,
            band,
        );
    }
}

/// Enters `at_step` and `bit` in `verdict`, `[2]`, if a value is not finite and no earlier step is entered.
pub(crate) fn launch_watch(gpu: &Gpu, values: &Buffer<f32>, verdict: &Buffer<u32>, at_step: u32, bit: u32) {
    if values.len == 0 {
        return;
    }
    let (grid, dim, stride) = search(values.len);
    let (count, mask, values, verdict) = (values.len as u32, 1 << bit, values.arg(), verdict.arg());
    // SAFETY: every access is guarded by the length given; a verdict has two numbers.
    unsafe {
        watch_kernel::launch_unchecked(&gpu.client, grid, dim, values, verdict, count, stride, at_step, mask);
    }
}
