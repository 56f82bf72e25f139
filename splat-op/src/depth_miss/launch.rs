//! Launches of the miss.

use cubecl::prelude::CubeDim;

use super::Depths;
use super::kernels::{backward_kernel, mean_kernel, sums_kernel};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};

/// Returns the number of samples that count, and the sum of their errors.
fn totals(gpu: &Gpu, inputs: &Depths<Buffer<f32>>, pixels: &Buffer<u32>) -> Buffer<f32> {
    let runs = pixels.len.div_ceil(UNITS);
    let sums = Buffer::new(gpu, 2 * runs);
    if runs > 0 {
        let [depth, alpha, known] = inputs.each_ref().map(|buffer| buffer.arg()).into_array();
        // SAFETY: units beyond the last sample read nothing, and pixels beyond the picture are not read.
        unsafe {
            sums_kernel::launch_unchecked(
                &gpu.client,
                cubes(runs),
                CubeDim::new_1d(UNITS as u32),
                depth,
                alpha,
                known,
                pixels.arg(),
                sums.arg(),
                inputs.alpha.len as u32,
                pixels.len as u32,
                runs as u32,
            );
        }
    }
    launch_column_sums(gpu, &sums, 2)
}

/// `[1]`: the miss.
pub(crate) fn launch_depth_miss(gpu: &Gpu, inputs: &Depths<Buffer<f32>>, pixels: &Buffer<u32>) -> Buffer<f32> {
    let (totals, out) = (totals(gpu, inputs, pixels), Buffer::new(gpu, 1));
    let (grid, dim) = elementwise(1);
    // SAFETY: one unit works, on two numbers.
    unsafe { mean_kernel::launch_unchecked(&gpu.client, grid, dim, totals.arg(), out.arg()) };
    out
}

/// Returns the gradients of depth and alpha from `grad`, `[1]`, that of the miss.
pub(crate) fn launch_depth_miss_backward(
    gpu: &Gpu,
    inputs: &Depths<Buffer<f32>>,
    pixels: &Buffer<u32>,
    grad: &Buffer<f32>,
) -> [Buffer<f32>; 2] {
    let (of_depth, of_alpha) = (Buffer::zeros(gpu, inputs.alpha.len), Buffer::zeros(gpu, inputs.alpha.len));
    if pixels.len > 0 {
        let totals = totals(gpu, inputs, pixels);
        let (grid, dim) = elementwise(pixels.len);
        let [depth, alpha, known] = inputs.each_ref().map(|buffer| buffer.arg()).into_array();
        // SAFETY: units beyond the last sample do nothing, and pixels beyond the picture are neither read nor written.
        unsafe {
            backward_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                depth,
                alpha,
                known,
                pixels.arg(),
                totals.arg(),
                grad.arg(),
                of_depth.arg(),
                of_alpha.arg(),
                inputs.alpha.len as u32,
                pixels.len as u32,
            );
        }
    }
    [of_depth, of_alpha]
}
