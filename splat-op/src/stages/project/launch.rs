//! Launches of `project`.

use super::axis::CameraAxisLaunch;
use super::backward::{GeometryOutputsLaunch, project_backward_kernel};
use super::forward::{GeometryInputsLaunch, ProjectCameraLaunch, project_forward_kernel};
use super::lens_kernel::distortion_arg;
use super::{COLUMNS, Geometry, ProjectSpec, RADIUS_SIGMAS, WIDTHS};
use crate::gpu::{Buffer, Gpu, POSE, UNITS, launch_column_sums, launch_unchecked};

/// Camera and options as an argument of the kernels, computed in f64 and rounded once.
pub(crate) fn project_camera(spec: &ProjectSpec) -> ProjectCameraLaunch {
    let (camera, options) = (&spec.intrinsics, &spec.options);
    let axis = |focal: f64, principal: f64, [low, high]: [f64; 2]| {
        CameraAxisLaunch::new(focal as f32, principal as f32, low as f32, high as f32)
    };
    let [x, y] = camera.slope_limits(options.jacobian_margin);
    ProjectCameraLaunch::new(
        axis(camera.fx, camera.cx, x),
        axis(camera.fy, camera.cy, y),
        options.near as f32,
        // Shader compilers may assume that infinity does not occur.
        (options.far as f32).min(f32::MAX),
        (options.radius_clip / RADIUS_SIGMAS) as f32,
        options.blur.sqrt() as f32,
        distortion_arg(camera).into(),
        options.antialias,
        options.radius_clip > 0.0,
        spec.factors,
    )
}

/// Gaussians and pose as an argument of the kernels.
pub(crate) fn geometry_arg(inputs: &Geometry<Buffer<f32>>) -> GeometryInputsLaunch {
    let [means, scales, opacities] = [&inputs.means, &inputs.scales, &inputs.opacities].map(Buffer::arg);
    GeometryInputsLaunch::new(means, inputs.rotations.vectors(4), scales, opacities, inputs.cam_from_world.arg())
}

/// Launches the forward kernel. Returns packed ellipses, `[N, 7]`.
pub(crate) fn launch_project(gpu: &Gpu, inputs: &Geometry<Buffer<f32>>, spec: &ProjectSpec) -> Buffer<f32> {
    let count = inputs.opacities.len;
    let projected = Buffer::new(gpu, count * COLUMNS);
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        project_forward_kernel(geometry_arg(inputs), &projected, project_camera(spec), count)
    );
    projected
}

/// Returns the gradients that `needs` selects. `launch` runs a backward kernel over `count` Gaussians that writes them. It
/// finds one row per cube as the gradient of the pose; these rows are then summed in a fixed order.
pub(crate) fn geometry_grads(
    gpu: &Gpu,
    count: usize,
    needs: Geometry<bool>,
    launch: impl FnOnce(GeometryOutputsLaunch),
) -> Geometry<Option<Buffer<f32>>> {
    let of_rows = Geometry { cam_from_world: false, ..needs };
    let mut grads = of_rows.zip(WIDTHS).map(|(needed, width)| Buffer::if_needed(gpu, needed, count * width));
    if needs.into_array().contains(&true) {
        grads.cam_from_world = Buffer::if_needed(gpu, needs.cam_from_world, count.div_ceil(UNITS) * POSE);
        let output = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(Buffer::arg).into();
        launch(GeometryOutputsLaunch::new(
            output(&grads.means),
            grads.rotations.as_ref().map(|grads| grads.vectors(4)).into(),
            output(&grads.scales),
            output(&grads.opacities),
            output(&grads.mean2d),
            output(&grads.cam_from_world),
        ));
        grads.cam_from_world = grads.cam_from_world.map(|rows| launch_column_sums(gpu, &rows, POSE));
    }
    grads
}

/// Returns the gradients of the inputs from `grad`, `[N, 7]`.
pub(crate) fn launch_project_backward(
    gpu: &Gpu,
    inputs: &Geometry<Buffer<f32>>,
    grad: &Buffer<f32>,
    spec: &ProjectSpec,
    needs: Geometry<bool>,
) -> Geometry<Option<Buffer<f32>>> {
    let count = inputs.opacities.len;
    geometry_grads(gpu, count, needs, |outputs| {
        // SAFETY: every access is guarded by the number of Gaussians.
        launch_unchecked!(
            gpu.units(count),
            project_backward_kernel(geometry_arg(inputs), grad, outputs, project_camera(spec), count, needs)
        );
    })
}
