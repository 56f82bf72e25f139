//! Launches of the convolution.

use super::Smooth;
use super::kernels::{smoothed_opacities_backward_kernel, smoothed_opacities_kernel, smoothed_scales_kernel};
use crate::gpu::{Buffer, Gpu, elementwise};

/// `[N, 3]`: the new standard deviations.
pub(crate) fn launch_smoothed_scales(gpu: &Gpu, scales: &Buffer<f32>, widths: &Buffer<f32>) -> Buffer<f32> {
    let out = Buffer::new(gpu, scales.len);
    if out.len > 0 {
        let ((grid, dim), count) = (elementwise(out.len), out.len as u32);
        let (scales, widths) = (scales.arg(), widths.arg());
        // SAFETY: units beyond the last number do nothing.
        unsafe { smoothed_scales_kernel::launch_unchecked(&gpu.client, grid, dim, scales, widths, out.arg(), count) };
    }
    out
}

/// `[N]`: the new opacities.
pub(crate) fn launch_smoothed_opacities(gpu: &Gpu, inputs: &Smooth<Buffer<f32>>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.opacities.len);
    if out.len > 0 {
        let ((grid, dim), count) = (elementwise(out.len), out.len as u32);
        let [scales, opacities, widths] = inputs.each_ref().map(|buffer| buffer.arg()).into_array();
        // SAFETY: units beyond the last Gaussian do nothing.
        unsafe {
            smoothed_opacities_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                scales,
                opacities,
                widths,
                out.arg(),
                count,
            );
        }
    }
    out
}

/// Returns the gradients of the standard deviations and of the opacities from `grad`, `[N]`, that of the new opacities.
pub(crate) fn launch_smoothed_opacities_backward(
    gpu: &Gpu,
    inputs: &Smooth<Buffer<f32>>,
    grad: &Buffer<f32>,
) -> (Buffer<f32>, Buffer<f32>) {
    let (of_scales, of_opacities) = (Buffer::new(gpu, inputs.scales.len), Buffer::new(gpu, inputs.opacities.len));
    if of_opacities.len > 0 {
        let ((grid, dim), count) = (elementwise(of_opacities.len), of_opacities.len as u32);
        let [scales, opacities, widths] = inputs.each_ref().map(|buffer| buffer.arg()).into_array();
        // SAFETY: units beyond the last Gaussian do nothing.
        unsafe {
            smoothed_opacities_backward_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                scales,
                opacities,
                widths,
                grad.arg(),
                of_scales.arg(),
                of_opacities.arg(),
                count,
            );
        }
    }
    (of_scales, of_opacities)
}
