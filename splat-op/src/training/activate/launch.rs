//! Launches of `activate`.

use super::forward::{activate_backward_kernel, activate_kernel, non_finite_kernel};
use super::rule::Raw;
use crate::gpu::{Buffer, Gpu, given, launch_unchecked, search};

/// `[N, 3]` standard deviations and `[N]` opacities. `mark`, `[1]`, is zero if all coefficients are known to be usable.
pub(crate) fn launch_activate(
    gpu: &Gpu,
    inputs: &Raw<Buffer<f32>>,
    mark: Option<&Buffer<u32>>,
) -> (Buffer<f32>, Buffer<f32>) {
    let count = inputs.logit_opacities.len;
    let (scales, opacities) = (Buffer::new(gpu, 3 * count), Buffer::new(gpu, count));
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        activate_kernel(
            &inputs.means,
            inputs.rotations.vectors(4),
            &inputs.log_scales,
            &inputs.logit_opacities,
            &inputs.sh,
            mark,
            &scales,
            &opacities,
            count,
            inputs.sh.len / count.max(1)
        )
    );
    (scales, opacities)
}

/// Inputs of a backward pass: the logits, `[N]`, what they and the logarithms became, and the gradients of that, if there are any.
pub(crate) struct ActivatedGrads {
    pub logit_opacities: Buffer<f32>,
    pub scales: Buffer<f32>,
    pub opacities: Buffer<f32>,
    pub grad_scales: Option<Buffer<f32>>,
    pub grad_opacities: Option<Buffer<f32>>,
}

/// The gradients of the logarithms, `[N, 3]`, and of the logits, `[N]`, each if there is one of what it became.
pub(crate) fn launch_activate_backward(gpu: &Gpu, inputs: &ActivatedGrads) -> [Option<Buffer<f32>>; 2] {
    let ActivatedGrads { logit_opacities, scales, opacities, grad_scales, grad_opacities } = inputs;
    let count = opacities.len;
    let found = [(grad_scales, 3 * count), (grad_opacities, count)];
    let found = found.map(|(grad, len)| Buffer::if_needed(gpu, grad.is_some(), len));
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        activate_backward_kernel(
            logit_opacities,
            scales,
            opacities,
            grad_scales,
            grad_opacities,
            &found[0],
            &found[1],
            count,
            given(found.each_ref())
        )
    );
    found
}

/// `[1]`: 1 if any value is not finite, else 0.
pub(crate) fn launch_non_finite(gpu: &Gpu, values: &Buffer<f32>) -> Buffer<u32> {
    let flag = Buffer::zeros(gpu, 1);
    if values.len > 0 {
        let (grid, dim, stride) = search(values.len);
        // SAFETY: every access is guarded by the length given.
        launch_unchecked!((&gpu.client, grid, dim), non_finite_kernel(values, &flag, values.len, stride));
    }
    flag
}
