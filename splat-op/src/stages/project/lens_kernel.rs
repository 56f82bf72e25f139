//! Lenses in the kernels of `project`. The backward pass projects through the lens a second time. CubeCL removes the repeated operations.

use cubecl::prelude::*;

use super::axis::{CameraAxis, CameraAxisExpand, JacobianRow, JacobianRowExpand};
use super::lens_formulas::{Distortion, LensProjection, LensProjectionGrad};
use crate::camera::{CameraModel, Intrinsics};
use crate::gpu::{KernelNumber, Mat3, Mat3Expand, Vec2, Vec2Launch, Vec3, Vec3Expand, vec3};

/// A lens as an argument of the kernels, with the fields of [`Distortion`].
#[allow(dead_code, reason = "kernels read the fields of the expanded type")]
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct DistortionArg {
    k1: f32,
    k2: f32,
    k3: f32,
    k4: f32,
    d1: f32,
    d2: f32,
    d3: f32,
    tangential: Vec2,
    outward: Vec2,
    max_radius_squared: f32,
    #[cube(comptime)]
    model: CameraModel,
}

/// Lens as an argument of the kernels; `None` for a pinhole.
pub(super) fn distortion_arg(camera: &Intrinsics) -> Option<DistortionArgLaunch> {
    let Distortion {
        model,
        radial: [k1, k2, k3, k4],
        denominator: [d1, d2, d3],
        tangential,
        outward,
        max_radius_squared,
    } = Distortion::new(camera)?;
    let [tangential, outward] = [tangential, outward].map(|[x, y]| Vec2Launch::new(x, y));
    Some(DistortionArgLaunch::new(k1, k2, k3, k4, d1, d2, d3, tangential, outward, max_radius_squared, model))
}

/// Gradients of `W R` and of the centre in the camera's frame.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub(crate) struct SeenGrad {
    pub turned: Mat3,
    pub centre: Vec3,
}

/// Projects a centre through a lens, in numbers of a kernel.
fn through_lens<'a>(
    scope: &'a Scope,
    mean_cam: Vec3Expand,
    rows: Mat3Expand,
    axes: [&CameraAxisExpand; 2],
    lens: &DistortionArgExpand,
) -> LensProjection<KernelNumber<'a>> {
    let DistortionArgExpand { k1, k2, k3, k4, d1, d2, d3, tangential, outward, max_radius_squared, model } = *lens;
    let (radial, denominator) = ([k1, k2, k3, k4], [d1, d2, d3]);
    let [tangential, outward] = [tangential, outward].map(|pair| [pair.x, pair.y]);
    let distortion = Distortion { model, radial, denominator, tangential, outward, max_radius_squared };
    let n = |value| KernelNumber::of(scope, value);
    let (distortion, focal) = (distortion.map(n), axes.map(|axis| n(axis.focal)));
    let limits = [axes.map(|axis| n(axis.low)), axes.map(|axis| n(axis.high))];
    let rows = [rows.x, rows.y, rows.z].map(|row| KernelNumber::vector(scope, row));
    LensProjection::new(distortion, focal, KernelNumber::vector(scope, mean_cam), rows, limits)
}

/// Projections of a Gaussian along both axes of the picture, from its centre in the camera's frame and `W R`, and whether the centre
/// lies within the lens's domain.
#[cube]
pub(crate) fn bent_rows(
    mean_cam: Vec3,
    rows: Mat3,
    scale: Vec3,
    x: &CameraAxis,
    y: &CameraAxis,
    lens: &DistortionArg,
) -> (JacobianRow, JacobianRow, bool) {
    intrinsic!(|scope| {
        let projection = through_lens(scope, mean_cam, rows, [x, y], lens);
        let scale = KernelNumber::vector(scope, scale);
        let row = |j: [KernelNumber; 3], at: KernelNumber| JacobianRowExpand {
            ratio: at.value,
            slope: at.value,
            slope_free: NativeExpand::from_lit(scope, false),
            j: vec3(j),
            m: vec3(std::array::from_fn(|axis| j[axis] * scale[axis])),
        };
        let ([j_x, j_y], [x, y]) = (projection.rows(), projection.seen_at());
        (row(j_x, x), row(j_y, y), projection.within.value)
    })
}

/// Gradients of `W R` and of the centre from those of the rows of `J W R` and of the projected centre: its place, px, and its depth.
#[cube]
pub(crate) fn bent_backward(
    mean_cam: Vec3,
    rows: Mat3,
    x: &CameraAxis,
    y: &CameraAxis,
    lens: &DistortionArg,
    grad_j: (Vec3, Vec3),
    grad_centre: Vec3,
) -> SeenGrad {
    intrinsic!(|scope| {
        let projection = through_lens(scope, mean_cam, rows, [x, y], lens);
        let grad_j = [grad_j.0, grad_j.1].map(|row| KernelNumber::vector(scope, row));
        let [of_x, of_y, of_depth] = KernelNumber::vector(scope, grad_centre);
        let LensProjectionGrad { mean_cam, rows: [x, y, z] } = projection.backward(grad_j, [of_x, of_y]);
        let centre = [mean_cam[0], mean_cam[1], mean_cam[2] + of_depth];
        SeenGradExpand { turned: Mat3Expand { x: vec3(x), y: vec3(y), z: vec3(z) }, centre: vec3(centre) }
    })
}
