//! Launches of the composition.

use super::Sky;
use super::kernels::{RUN, alpha_backward_kernel, coefficients_backward_kernel, environment_kernel};
use crate::gpu::{Buffer, Gpu, launch_column_sums, launch_unchecked};
use crate::sh::degree_of;

/// Number of pixels, and the degree.
fn sizes(inputs: &Sky<Buffer<f32>>) -> (usize, usize) {
    (inputs.alpha.len, degree_of(inputs.coefficients.len / 3))
}

/// Returns the render over the environment, `[3, H, W]`.
pub(crate) fn launch_environment(gpu: &Gpu, inputs: &Sky<Buffer<f32>>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.image.len);
    let (pixels, degree) = sizes(inputs);
    let Sky { image, alpha, directions, coefficients } = inputs;
    // SAFETY: units beyond the last pixel do nothing.
    launch_unchecked!(
        gpu.units(pixels),
        environment_kernel(image, alpha, directions, coefficients, &out, pixels, degree)
    );
    out
}

/// Returns the gradient of alpha from `grad`, that of the composed picture.
pub(crate) fn launch_alpha_backward(gpu: &Gpu, inputs: &Sky<Buffer<f32>>, grad: &Buffer<f32>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.alpha.len);
    let (pixels, degree) = sizes(inputs);
    let Sky { directions, coefficients, .. } = inputs;
    // SAFETY: units beyond the last pixel do nothing.
    launch_unchecked!(gpu.units(pixels), alpha_backward_kernel(grad, directions, coefficients, &out, pixels, degree));
    out
}

/// Returns the gradient of the coefficients from `grad`, that of the composed picture.
pub(crate) fn launch_coefficients_backward(gpu: &Gpu, inputs: &Sky<Buffer<f32>>, grad: &Buffer<f32>) -> Buffer<f32> {
    let (pixels, degree) = sizes(inputs);
    let runs = pixels.div_ceil(RUN);
    let sums = Buffer::new(gpu, runs * inputs.coefficients.len);
    // SAFETY: cubes beyond the last run and harmonic do nothing, and runs end with the picture.
    launch_unchecked!(
        gpu.cubes(sums.len / 3),
        coefficients_backward_kernel(grad, &inputs.alpha, &inputs.directions, &sums, pixels, runs, degree)
    );
    launch_column_sums(gpu, &sums, inputs.coefficients.len)
}
