//! Launches of the correction.

use super::kernels::{corrected_backward_kernel, corrected_kernel};
use super::{Corrected, POSE};
use crate::gpu::{Buffer, Gpu, elementwise};

/// `[3, 4]`: the corrected pose.
pub(crate) fn launch_corrected(gpu: &Gpu, inputs: &Corrected<Buffer<f32>>, unit: f64) -> Buffer<f32> {
    let (out, (grid, dim)) = (Buffer::new(gpu, POSE), elementwise(1));
    let (correction, pose) = (inputs.correction.arg(), inputs.cam_from_world.arg());
    // SAFETY: one unit works, on inputs of fixed shapes.
    unsafe {
        corrected_kernel::launch_unchecked(&gpu.client, grid, dim, correction, pose, out.arg(), unit as f32);
    }
    out
}

/// Returns the gradient of the correction, `[2, 3]`, from `grad`, that of the corrected pose.
pub(crate) fn launch_corrected_backward(
    gpu: &Gpu,
    inputs: &Corrected<Buffer<f32>>,
    grad: &Buffer<f32>,
    unit: f64,
) -> Buffer<f32> {
    let (out, (grid, dim), client) = (Buffer::new(gpu, 6), elementwise(1), &gpu.client);
    let (correction, pose, grad) = (inputs.correction.arg(), inputs.cam_from_world.arg(), grad.arg());
    // SAFETY: one unit works, on inputs of fixed shapes.
    unsafe {
        corrected_backward_kernel::launch_unchecked(client, grid, dim, correction, pose, grad, out.arg(), unit as f32);
    }
    out
}
