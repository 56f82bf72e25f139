//! The launch of Adam's step with packed moments.

use super::forward::{PackedScalarsLaunch, RowForm, adam_packed_kernel};
use super::{PackedFactors, Packing};
use crate::adam::launch::factors_arg;
use crate::adam::rule::Band;
use crate::gpu::{Buffer, Gpu, elementwise};

/// The step of one parameter with rows of `width` numbers. Parameter and words change in place.
#[derive(Clone)]
pub(crate) struct DevicePackedStep {
    pub param: Buffer<f32>,
    pub grad: Buffer<f32>,
    pub words: Buffer<u32>,
    pub factors: PackedFactors,
    pub band: Option<Band>,
    pub width: usize,
}

/// Performs a step in place. Nothing changes where `verdict`, `[2]`, names a step.
pub(crate) fn launch_adam_packed(gpu: &Gpu, step: &DevicePackedStep, verdict: Option<&Buffer<u32>>) {
    let DevicePackedStep { param, grad, words, factors, band, width } = step;
    if words.len == 0 {
        return;
    }
    let form = Packing::form(factors.packing);
    let (grid, dim) = elementwise(words.len);
    // SAFETY: every access is guarded by the number of words and the width; each row has its words.
    unsafe {
        adam_packed_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            param.arg(),
            grad.arg(),
            words.arg(),
            verdict.map(Buffer::arg).into(),
            PackedScalarsLaunch::new(factors_arg(&factors.factors), factors.reach() as f32, factors.phase()),
            words.len as u32,
            RowForm { form, width: *width, band: *band },
        );
    }
}
