//! Launches of `activate`.

use super::forward::{non_finite_kernel, opacities_kernel, opacity_slopes_kernel, scales_kernel};
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

/// `[N]` opacities.
pub(crate) fn launch_opacities(gpu: &Gpu, inputs: &Raw<Buffer<f32>>) -> Buffer<f32> {
    let count = inputs.logit_opacities.len;
    let opacities = Buffer::new(gpu, count);
    if count > 0 {
        let (grid, dim) = elementwise(count);
        // SAFETY: every access is guarded by the number of Gaussians.
        unsafe {
            opacities_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.means.arg(),
                inputs.rotations.arg(),
                inputs.log_scales.arg(),
                inputs.logit_opacities.arg(),
                inputs.sh.arg(),
                opacities.arg(),
                count as u32,
                (inputs.sh.len / count) as u32,
            );
        }
    }
    opacities
}

/// `[N]` derivatives of the opacities with respect to their logits.
pub(crate) fn launch_opacity_slopes(gpu: &Gpu, logit_opacities: &Buffer<f32>, opacities: &Buffer<f32>) -> Buffer<f32> {
    let (count, slopes) = (opacities.len, Buffer::new(gpu, opacities.len));
    if count > 0 {
        let (grid, dim) = elementwise(count);
        let (logits, opacities, out) = (logit_opacities.arg(), opacities.arg(), slopes.arg());
        // SAFETY: every access is guarded by the length given.
        unsafe {
            opacity_slopes_kernel::launch_unchecked(&gpu.client, grid, dim, logits, opacities, out, count as u32);
        }
    }
    slopes
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
