//! The launch of Adam's step with packed moments.

use super::PackedFactors;
use super::forward::{PackedScalarsLaunch, adam_packed_kernel};
use crate::adam::launch::factors_arg;
use crate::adam::rule::Band;
use crate::gpu::{Buffer, Gpu, launch_unchecked};

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
    let scalars = PackedScalarsLaunch::new(factors_arg(&factors.factors), factors.reach() as f32, factors.phase());
    // SAFETY: every access is guarded by the number of words and the width; each row has its words.
    launch_unchecked!(
        gpu.units(words.len),
        adam_packed_kernel(param, grad, words, verdict, scalars, words.len, *width, *band)
    );
}
