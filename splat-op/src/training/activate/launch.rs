//! Launches of `activate`.

use super::forward::{activate_kernel, non_finite_kernel, opacities_backward_kernel, scales_kernel};
use super::rule::Raw;
use crate::gpu::{Buffer, Gpu, elementwise, search};

/// `[N, 3]` standard deviations.
pub(crate) fn launch_scales(gpu: &Gpu, log_scales: &Buffer<f32>) -> Buffer<f32> {
    let (count, scales) = (log_scales.len, Buffer::new(gpu, log_scales.len));
    if count > 0 {
        let (grid, dim) = elementwise(count);
        let (from, to) = (log_scales.arg(), scales.arg());
        // SAFETY: every access is guarded by the length given.
        unsafe { scales_kernel::launch_unchecked(&gpu.client, grid, dim, from, to, count as u32) };
    }
    scales
}

/// `[N, 3]` standard deviations and `[N]` opacities. `mark`, `[1]`, is zero if all coefficients are known to be usable.
pub(crate) fn launch_activate(
    gpu: &Gpu,
    inputs: &Raw<Buffer<f32>>,
    mark: Option<&Buffer<u32>>,
) -> (Buffer<f32>, Buffer<f32>) {
    let count = inputs.logit_opacities.len;
    let (scales, opacities) = (Buffer::new(gpu, 3 * count), Buffer::new(gpu, count));
    if count > 0 {
        let (grid, dim) = elementwise(count);
        // SAFETY: every access is guarded by the number of Gaussians.
        unsafe {
            activate_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.means.arg(),
                inputs.rotations.vectors(4),
                inputs.log_scales.arg(),
                inputs.logit_opacities.arg(),
                inputs.sh.arg(),
                mark.map(Buffer::arg).into(),
                scales.arg(),
                opacities.arg(),
                count as u32,
                (inputs.sh.len / count) as u32,
            );
        }
    }
    (scales, opacities)
}

/// `[N]` gradients of the logits from `grad`, those of the opacities.
pub(crate) fn launch_opacities_backward(
    gpu: &Gpu,
    logit_opacities: &Buffer<f32>,
    opacities: &Buffer<f32>,
    grad: &Buffer<f32>,
) -> Buffer<f32> {
    let (count, found) = (opacities.len, Buffer::new(gpu, opacities.len));
    if count > 0 {
        let (grid, dim) = elementwise(count);
        let (logits, opacities, grad, out) = (logit_opacities.arg(), opacities.arg(), grad.arg(), found.arg());
        // SAFETY: every access is guarded by the length given.
        unsafe {
            opacities_backward_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                logits,
                opacities,
                grad,
                out,
                count as u32,
            );
        }
    }
    found
}

/// `[1]`: 1 if any value is not finite, else 0.
pub(crate) fn launch_non_finite(gpu: &Gpu, values: &Buffer<f32>) -> Buffer<u32> {
    let flag = Buffer::zeros(gpu, 1);
    if values.len > 0 {
        let (grid, dim, stride) = search(values.len);
        let count = values.len as u32;
        // SAFETY: every access is guarded by the length given.
        unsafe {
            non_finite_kernel::launch_unchecked(&gpu.client, grid, dim, values.arg(), flag.arg(), count, stride);
        }
    }
    flag
}
