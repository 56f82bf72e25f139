//! Launches of both stages in one.

use super::backward::project_shade_backward_kernel;
use super::forward::project_shade_forward_kernel;
use super::{ProjectShadeNeeds, reach_sigmas};
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::project::launch::{DeviceGrads as ProjectGrads, DeviceInputs as ProjectInputs, lens};
use crate::project::{COLUMNS, ProjectSpec};
use crate::shade::launch::Coefficients;

/// Inputs on the device, row-major.
#[derive(Clone, Debug)]
pub(crate) struct DeviceInputs {
    pub geometry: ProjectInputs,
    /// `[M, (degree+1)², 3]`.
    pub sh: Coefficients,
    /// `[N − M, 1, 3]`, if there are matte Gaussians, stored as the others are.
    pub matte: Option<Coefficients>,
}

impl DeviceInputs {
    /// Where matte Gaussians begin, if there are any.
    fn first_matte(&self) -> Option<u32> {
        self.matte.as_ref().map(|matte| (self.geometry.opacities.len - matte.len / 3) as u32)
    }
}

/// Gradients on the device, of the inputs' shapes, each where it was asked for.
#[derive(Clone, Debug)]
pub(crate) struct DeviceGrads {
    pub geometry: ProjectGrads,
    pub sh: Option<Buffer<f32>>,
    pub matte: Option<Buffer<f32>>,
}

/// Packed ellipses, `[N, 7]`, and colours, `[N, 3]`, from `coefficients` per channel.
pub(crate) fn launch_project_shade(
    gpu: &Gpu,
    inputs: &DeviceInputs,
    coefficients: usize,
    spec: &ProjectSpec,
) -> (Buffer<f32>, Buffer<f32>) {
    let geometry = &inputs.geometry;
    let count = geometry.opacities.len;
    let (projected, colours) = (Buffer::new(gpu, count * COLUMNS), Buffer::new(gpu, count * 3));
    if count == 0 {
        return (projected, colours);
    }
    let (grid, dim) = elementwise(count);
    // SAFETY: every access is guarded by the number of Gaussians.
    unsafe {
        project_shade_forward_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            geometry.means.arg(),
            geometry.rotations.arg(),
            geometry.scales.arg(),
            geometry.opacities.arg(),
            inputs.sh.values.arg(),
            inputs.matte.as_ref().map(|matte| matte.values.arg()).into(),
            inputs.first_matte().into(),
            geometry.cam_from_world.arg(),
            projected.arg(),
            colours.arg(),
            lens(spec),
            reach_sigmas(spec.options.alpha_min) as f32,
            spec.intrinsics.width as f32,
            spec.intrinsics.height as f32,
            count as u32,
            inputs.sh.harmonics(coefficients),
        );
    }
    (projected, colours)
}

/// Gradients of the inputs from those of the packed ellipses, `[N, 7]`, and of the colours, `[N, 3]`.
pub(crate) fn launch_project_shade_backward(
    gpu: &Gpu,
    inputs: &DeviceInputs,
    coefficients: usize,
    (grad_packed, grad_colours): (&Buffer<f32>, &Buffer<f32>),
    spec: &ProjectSpec,
    needs: ProjectShadeNeeds,
) -> DeviceGrads {
    let geometry = &inputs.geometry;
    let count = geometry.opacities.len;
    let rows = |needed, columns| Buffer::if_needed(gpu, needed, count * columns);
    let needed = needs.geometry;
    assert!(!needed.cam_from_world, "where the pose is trained, the stages run one by one");
    let grads = DeviceGrads {
        geometry: ProjectGrads {
            means: rows(needed.means, 3),
            rotations: rows(needed.rotations, 4),
            scales: rows(needed.scales, 3),
            opacities: rows(needed.opacities, 1),
            cam_from_world: None,
            mean2d: rows(needed.mean2d, 2),
        },
        sh: Buffer::if_needed(gpu, needs.sh, inputs.sh.len),
        matte: inputs.matte.as_ref().and_then(|matte| Buffer::if_needed(gpu, needs.matte, matte.len)),
    };
    if count == 0 {
        return grads;
    }
    let output = |buffer: &Option<Buffer<f32>>| buffer.as_ref().map(Buffer::arg).into();
    let (grid, dim) = elementwise(count);
    // SAFETY: every access is guarded by the number of Gaussians.
    unsafe {
        project_shade_backward_kernel::launch_unchecked(
            &gpu.client,
            grid,
            dim,
            geometry.means.arg(),
            geometry.rotations.arg(),
            geometry.scales.arg(),
            geometry.opacities.arg(),
            inputs.sh.values.arg(),
            inputs.matte.as_ref().map(|matte| matte.values.arg()).into(),
            inputs.first_matte().into(),
            geometry.cam_from_world.arg(),
            grad_packed.arg(),
            grad_colours.arg(),
            output(&grads.geometry.means),
            output(&grads.geometry.rotations),
            output(&grads.geometry.scales),
            output(&grads.geometry.opacities),
            output(&grads.geometry.mean2d),
            grads.sh.as_ref().map(Buffer::arg).into(),
            grads.matte.as_ref().map(Buffer::arg).into(),
            lens(spec),
            count as u32,
            inputs.sh.harmonics(coefficients),
        );
    }
    grads
}
