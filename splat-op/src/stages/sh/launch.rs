//! Launches of `evaluate_sh`.

use cubecl::prelude::{ComptimeOptionArgs, CubeCount, CubeDim};

use super::backward::{pose_backward_kernel, sh_backward_kernel};
use super::forward::{FrameLaunch, sh_forward_kernel};
use super::{Shading, degree_of, extent_sigmas, vector_width};
use crate::gpu::{Buffer, Gpu, POSE, UNITS, given, launch_column_sums, launch_unchecked};
use crate::project::ProjectSpec;

/// Gaussians whose colours are computed: those whose packed ellipses, `[N, 7]`, can show in a picture.
pub(crate) type DeviceVisible<'a> = Option<(&'a Buffer<f32>, &'a ProjectSpec)>;

/// The picture for the test of visibility; its values are not read without ellipses.
fn frame(visible: DeviceVisible) -> FrameLaunch {
    let size = |spec: &ProjectSpec| [spec.intrinsics.width as f32, spec.intrinsics.height as f32];
    let [width, height] = visible.map_or([0.0; 2], |(_, spec)| size(spec));
    FrameLaunch::new(visible.map_or(0.0, |(_, spec)| extent_sigmas(spec.options.alpha_min) as f32), width, height)
}

/// Launches the forward kernel. Returns colours `[N, 3]` from `coefficients` per channel; zero for Gaussians that are not visible.
pub(crate) fn launch_sh(
    gpu: &Gpu,
    inputs: &Shading<Buffer<f32>>,
    visible: DeviceVisible,
    coefficients: usize,
) -> Buffer<f32> {
    let count = inputs.means.len / 3;
    let colours = Buffer::new(gpu, 3 * count);
    let degree = degree_of(coefficients);
    let width = vector_width(degree);
    let (Shading { sh, means, cam_from_world }, ellipses) = (inputs, visible.map(|(ellipses, _)| ellipses));
    let (sh, frame) = (sh.vectors(width), frame(visible));
    // SAFETY: every access is guarded by the number of Gaussians.
    launch_unchecked!(
        gpu.units(count),
        sh_forward_kernel(width, sh, means, cam_from_world, ellipses, &colours, frame, count, degree)
    );
    colours
}

/// Launches the backward kernels. Returns the gradients of the inputs from `grad`, `[N, 3]`. The pose's gradient is summed in a
/// fixed order.
pub(crate) fn launch_sh_backward(
    gpu: &Gpu,
    inputs: &Shading<Buffer<f32>>,
    visible: DeviceVisible,
    coefficients: usize,
    grad: &Buffer<f32>,
    needs: Shading<bool>,
) -> Shading<Option<Buffer<f32>>> {
    let (count, degree) = (inputs.means.len / 3, degree_of(coefficients));
    let mut grads = Shading {
        sh: Buffer::if_needed(gpu, needs.sh, inputs.sh.len),
        means: Buffer::if_needed(gpu, needs.means, inputs.means.len),
        cam_from_world: None,
    };
    // A colour of degree zero does not depend on the camera's position.
    let through_pose = needs.cam_from_world && degree > 0 && count > 0;
    let view_direction_rows = Buffer::if_needed(gpu, through_pose, count.div_ceil(UNITS) * 3);
    if count > 0 && (needs.sh || needs.means || through_pose) {
        let width = vector_width(degree);
        let grad_sh = ComptimeOptionArgs::from(grads.sh.as_ref().map(|grads| grads.vectors(width)));
        // SAFETY: every access is guarded by the number of Gaussians.
        launch_unchecked!(
            gpu.units(count),
            sh_backward_kernel(
                width,
                inputs.sh.vectors(width),
                &inputs.means,
                &inputs.cam_from_world,
                visible.map(|(ellipses, _)| ellipses),
                grad,
                grad_sh,
                &grads.means,
                &view_direction_rows,
                frame(visible),
                count,
                degree,
                given([&grads.sh, &grads.means, &view_direction_rows])
            )
        );
    }
    grads.cam_from_world = needs.cam_from_world.then(|| match view_direction_rows {
        Some(rows) => launch_pose_backward(gpu, &launch_column_sums(gpu, &rows, 3), &inputs.cam_from_world),
        None => Buffer::from_slice(gpu, &[0.0; POSE]),
    });
    grads
}

/// Gradient of the pose, `[3, 4]`, from `grad_sights`, `[3]`, the sum of the gradients of the view directions.
fn launch_pose_backward(gpu: &Gpu, grad_sights: &Buffer<f32>, cam_from_world: &Buffer<f32>) -> Buffer<f32> {
    let grad_pose = Buffer::new(gpu, POSE);
    // SAFETY: the kernel reads and writes exactly the lengths of these buffers.
    launch_unchecked!(
        (&gpu.client, CubeCount::Static(1, 1, 1), CubeDim::new_1d(1)),
        pose_backward_kernel(grad_sights, cam_from_world, &grad_pose)
    );
    grad_pose
}
