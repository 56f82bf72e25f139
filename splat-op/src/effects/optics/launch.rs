//! Launches of the changes of ellipses.

use super::kernels::{ChangeArgLaunch, expose_backward_kernel, expose_kernel};
use super::{Exposed, OpticsSpec, PARAMETERS};
use crate::gpu::{Buffer, Gpu, UNITS, launch_column_sums, launch_unchecked};
use crate::project::COLUMNS;
use crate::project::axis::CameraAxisLaunch;

/// Camera and change as an argument of the kernels.
fn change(spec: &OpticsSpec) -> ChangeArgLaunch {
    let [x, y] = spec.axes().map(|axis| {
        let [focal, principal, low, high] = axis.map(|value| value as f32);
        CameraAxisLaunch::new(focal, principal, low, high)
    });
    ChangeArgLaunch::new(x, y, spec.intrinsics.height as f32, spec.exposure)
}

/// Returns the changed ellipses, `[N, 7]`.
pub(crate) fn launch_expose(gpu: &Gpu, inputs: &Exposed<Buffer<f32>>, spec: &OpticsSpec) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.projected.len);
    let count = out.len / COLUMNS;
    // SAFETY: units beyond the last Gaussian do nothing, and the public functions check the length of the twist.
    launch_unchecked!(gpu.units(count), expose_kernel(&inputs.projected, &inputs.twist, &out, change(spec), count));
    out
}

/// Returns the gradients of the ellipses and of the twist from `grad`, `[N, 7]`.
pub(crate) fn launch_expose_backward(
    gpu: &Gpu,
    inputs: &Exposed<Buffer<f32>>,
    grad: &Buffer<f32>,
    spec: &OpticsSpec,
) -> Exposed<Buffer<f32>> {
    let count = inputs.projected.len / COLUMNS;
    let projected = Buffer::new(gpu, inputs.projected.len);
    let rows = Buffer::new(gpu, count.div_ceil(UNITS) * PARAMETERS);
    // SAFETY: as in `launch_expose`, and there is a row for every cube of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        expose_backward_kernel(&inputs.projected, &inputs.twist, grad, &projected, &rows, change(spec), count)
    );
    Exposed { projected, twist: launch_column_sums(gpu, &rows, PARAMETERS) }
}
