//! Launches of `ray_space`.

use cubecl::prelude::ComptimeOptionArgs;

use super::backward::ray_space_backward_kernel;
use super::bounds_kernel::{bounds_kernel, lens_limits};
use super::columns;
use super::forward::ray_space_forward_kernel;
use crate::gpu::{Buffer, Gpu, Vec2Launch, launch_unchecked};
use crate::project::launch::{geometry_arg, geometry_grads, project_camera};
use crate::project::{COLUMNS, Geometry, ProjectSpec};
use crate::rasterize::RasterizeSpec;

/// Launches the forward pass and returns the rows, `[N, 9 (+ 6)]`.
pub(crate) fn launch_ray_space(gpu: &Gpu, inputs: &Geometry<Buffer<f32>>, spec: &ProjectSpec) -> Buffer<f32> {
    let count = inputs.opacities.len;
    let ray_rows = Buffer::new(gpu, count * columns(&spec.intrinsics));
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        ray_space_forward_kernel(geometry_arg(inputs), &ray_rows, project_camera(spec), count)
    );
    ray_rows
}

/// Launches the bounds and returns rows for `intersect`, `[N, 7]`, from packed ellipses and their rows.
pub(crate) fn launch_bounds(
    gpu: &Gpu,
    projected: &Buffer<f32>,
    ray_rows: &Buffer<f32>,
    spec: &RasterizeSpec,
) -> Buffer<f32> {
    let count = projected.len / COLUMNS;
    let bounds = Buffer::new(gpu, count * COLUMNS);
    let size = Vec2Launch::new(spec.intrinsics.width as f32, spec.intrinsics.height as f32);
    let (alpha_min, lens) = (spec.options.alpha_min as f32, lens_limits(&spec.intrinsics));
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        bounds_kernel(projected, ray_rows, &bounds, size, alpha_min, ComptimeOptionArgs::from(lens), count)
    );
    bounds
}

/// Returns the gradients of the inputs from `grad`, `[N, 9 (+ 6)]`. Opacities have no gradient.
pub(crate) fn launch_ray_space_backward(
    gpu: &Gpu,
    inputs: &Geometry<Buffer<f32>>,
    grad: &Buffer<f32>,
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Option<Buffer<f32>>> {
    let count = inputs.opacities.len;
    let needs = Geometry { opacities: false, ..needs };
    geometry_grads(gpu, count, needs, |outputs| {
        // SAFETY: every access is guarded by the number of Gaussians.
        launch_unchecked!(
            gpu.units(count),
            ray_space_backward_kernel(geometry_arg(inputs), grad, outputs, project_camera(spec), count, needs)
        );
    })
}
