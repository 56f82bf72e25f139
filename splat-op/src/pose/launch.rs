//! Launches of both operations.

use cubecl::prelude::CubeDim;

use super::kernels::{corrected_backward_kernel, corrected_kernel, miss_kernel};
use super::{Corrected, POSE, Sighted};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};

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

/// Returns the miss of a pose, `[1]`, and its derivative, `[3, 4]`.
pub(crate) fn launch_miss(gpu: &Gpu, inputs: &Sighted<Buffer<f32>>, robust: f64) -> (Buffer<f32>, Buffer<f32>) {
    let count = inputs.points.len / 3;
    let runs = count.div_ceil(UNITS);
    let (misses, sums) = (Buffer::new(gpu, runs), Buffer::new(gpu, runs * POSE));
    let share = 1.0 / count.max(1) as f64;
    if runs > 0 {
        // SAFETY: units beyond the last point read nothing, and cubes beyond the last run do nothing.
        unsafe {
            miss_kernel::launch_unchecked(
                &gpu.client,
                cubes(runs),
                CubeDim::new_1d(UNITS as u32),
                inputs.pose.arg(),
                inputs.points.arg(),
                inputs.directions.arg(),
                misses.arg(),
                sums.arg(),
                robust as f32,
                share as f32,
                count as u32,
                runs as u32,
            );
        }
    }
    (launch_column_sums(gpu, &misses, 1), launch_column_sums(gpu, &sums, POSE))
}
