//! Launches of the changes of ellipses.

use super::backward::expose_backward_kernel;
use super::forward::{AxisLaunch, ChangeLaunch, Kind, expose_kernel};
use super::{Exposed, Exposure, OpticsSpec};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, elementwise};
use crate::project::COLUMNS;

/// Camera and change as an argument of the kernels.
fn change(spec: &OpticsSpec) -> ChangeLaunch {
    let (kind, part) = match spec.exposure {
        Exposure::MotionBlur => (Kind::MotionBlur, None),
        Exposure::RollingShutter => (Kind::RollingShutter, None),
        Exposure::Defocus(part) => (Kind::Defocus, Some(part)),
    };
    let place = part.map_or([0.0; 2], |part| part.place);
    let axis = |i: usize| {
        let [focal, principal, low, high] = spec.axes()[i].map(|value| value as f32);
        AxisLaunch::new(focal, principal, low, high, place[i] as f32)
    };
    let deviation = part.map_or(0.0, |part| part.deviation);
    ChangeLaunch::new(axis(0), axis(1), spec.intrinsics.height as f32, deviation as f32, kind)
}

/// Returns the changed ellipses, `[N, 7]`.
pub(crate) fn launch_expose(gpu: &Gpu, inputs: &Exposed<Buffer<f32>>, spec: &OpticsSpec) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.projected.len);
    let count = out.len / COLUMNS;
    if count == 0 {
        return out;
    }
    let ((grid, dim), client) = (elementwise(count), &gpu.client);
    let (projected, parameters) = (inputs.projected.arg(), inputs.parameters.arg());
    // SAFETY: units beyond the last Gaussian do nothing, and the public functions check the number of parameters.
    unsafe {
        expose_kernel::launch_unchecked(
            client,
            grid,
            dim,
            projected,
            parameters,
            out.arg(),
            change(spec),
            count as u32,
        );
    }
    out
}

/// Returns the gradients of the ellipses and of the parameters from `grad`, `[N, 7]`.
pub(crate) fn launch_expose_backward(
    gpu: &Gpu,
    inputs: &Exposed<Buffer<f32>>,
    grad: &Buffer<f32>,
    spec: &OpticsSpec,
) -> Exposed<Buffer<f32>> {
    let (count, wide) = (inputs.projected.len / COLUMNS, inputs.parameters.len);
    let projected = Buffer::new(gpu, inputs.projected.len);
    if count == 0 {
        return Exposed { projected, parameters: Buffer::from_slice(gpu, &vec![0.0; wide]) };
    }
    let rows = Buffer::new(gpu, count.div_ceil(UNITS) * wide);
    let (grid, dim) = elementwise(count);
    // SAFETY: as in `launch_expose`, and there is a row for every cube of Gaussians.
    unsafe {
        expose_backward_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            inputs.projected.arg(),
            inputs.parameters.arg(),
            grad.arg(),
            projected.arg(),
            rows.arg(),
            change(spec),
            count as u32,
        );
    }
    Exposed { projected, parameters: launch_column_sums(gpu, &rows, wide) }
}
