//! Launches of the composition.

use cubecl::prelude::CubeDim;

use super::Sky;
use super::kernels::{RUN, alpha_backward_kernel, coefficients_backward_kernel, environment_kernel};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};
use crate::sh::degree_of;

/// Number of pixels, and the degree.
fn sizes(inputs: &Sky<Buffer<f32>>) -> (u32, usize) {
    (inputs.alpha.len as u32, degree_of(inputs.coefficients.len / 3))
}

/// Returns the render over the environment, `[3, H, W]`.
pub(crate) fn launch_environment(gpu: &Gpu, inputs: &Sky<Buffer<f32>>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.image.len);
    let ((pixels, degree), (grid, dim)) = (sizes(inputs), elementwise(inputs.alpha.len));
    let [image, alpha, directions, coefficients] = inputs.each_ref().map(|buffer| buffer.arg()).into_array();
    // SAFETY: units beyond the last pixel do nothing.
    unsafe {
        environment_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            image,
            alpha,
            directions,
            coefficients,
            out.arg(),
            pixels,
            degree,
        );
    }
    out
}

/// Returns the gradient of alpha from `grad`, that of the composed picture.
pub(crate) fn launch_alpha_backward(gpu: &Gpu, inputs: &Sky<Buffer<f32>>, grad: &Buffer<f32>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.alpha.len);
    let ((pixels, degree), (grid, dim)) = (sizes(inputs), elementwise(out.len));
    let (directions, coefficients) = (inputs.directions.arg(), inputs.coefficients.arg());
    let (client, grad) = (&gpu.client, grad.arg());
    // SAFETY: units beyond the last pixel do nothing.
    unsafe {
        alpha_backward_kernel::launch_unchecked(
            client,
            grid,
            dim,
            grad,
            directions,
            coefficients,
            out.arg(),
            pixels,
            degree,
        );
    }
    out
}

/// Returns the gradient of the coefficients from `grad`, that of the composed picture.
pub(crate) fn launch_coefficients_backward(gpu: &Gpu, inputs: &Sky<Buffer<f32>>, grad: &Buffer<f32>) -> Buffer<f32> {
    let (pixels, degree) = sizes(inputs);
    let runs = inputs.alpha.len.div_ceil(RUN);
    let sums = Buffer::new(gpu, runs * inputs.coefficients.len);
    let (grid, dim) = (cubes(sums.len / 3), CubeDim::new_1d(UNITS as u32));
    let (alpha, directions) = (inputs.alpha.arg(), inputs.directions.arg());
    // SAFETY: cubes beyond the last run and harmonic do nothing, and runs end with the picture.
    unsafe {
        coefficients_backward_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            grad.arg(),
            alpha,
            directions,
            sums.arg(),
            pixels,
            runs as u32,
            degree,
        );
    }
    launch_column_sums(gpu, &sums, inputs.coefficients.len)
}
