//! Launches of `activate`.

use super::forward::{non_finite_kernel, opacities_kernel, opacity_slopes_kernel, scales_kernel};
use super::rule::Raw;
use crate::gpu::{Buffer, Gpu, elementwise};

/// Number of units that search for values that are not finite: enough to occupy a large GPU, few enough that each has several
/// values.
const SEEKERS: usize = 65_536;

/// `[N, 3]` standard deviations.
pub(crate) fn launch_scales(gpu: &Gpu, log_scales: &Buffer<f32>) -> Buffer<f32> {
    let scales = Buffer::new(gpu, log_scales.len);
    if log_scales.len > 0 {
        let (grid, dim) = elementwise(log_scales.len);
        // SAFETY: every access is guarded by the length given.
        unsafe {
            scales_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                log_scales.arg(),
                scales.arg(),
                log_scales.len as u32,
            );
        }
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
    let slopes = Buffer::new(gpu, opacities.len);
    if opacities.len > 0 {
        let (grid, dim) = elementwise(opacities.len);
        // SAFETY: every access is guarded by the length given.
        unsafe {
            opacity_slopes_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                logit_opacities.arg(),
                opacities.arg(),
                slopes.arg(),
                opacities.len as u32,
            );
        }
    }
    slopes
}

/// `[1]`: 1 if any value is not finite, else 0.
pub(crate) fn launch_non_finite(gpu: &Gpu, values: &Buffer<f32>) -> Buffer<u32> {
    let flag = Buffer::zeros(gpu, 1);
    if values.len > 0 {
        let seekers = values.len.min(SEEKERS);
        let (grid, dim) = elementwise(seekers);
        // The surplus units of the last cube count too; otherwise they would repeat the work of others.
        let stride = seekers.next_multiple_of(dim.num_elems() as usize);
        // SAFETY: every access is guarded by the length given.
        unsafe {
            non_finite_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                values.arg(),
                flag.arg(),
                values.len as u32,
                stride as u32,
            );
        }
    }
    flag
}
