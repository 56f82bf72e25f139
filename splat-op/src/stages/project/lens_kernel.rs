//! Lenses in the kernels of `project`. The backward pass projects through the lens a second time. CubeCL removes the repeated
//! operations.

use cubecl::prelude::*;

use super::axis::{CameraAxis, CameraAxisExpand, JacobianRow};
use super::lens_formulas::{Distortion, LensProjection, LensProjectionGrad};
use crate::camera::{CameraModel, Intrinsics};
use crate::gpu::math::{Mat3, Mat3Expand, Vec2, Vec2Expand, Vec2Launch, Vec3, Vec3Expand};
use crate::gpu::number::{KernelNumber, vec3};

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

/// A lens and the projection of a centre through it, as numbers of a kernel.
struct KernelBent<'a> {
    distortion: Distortion<KernelNumber<'a>>,
    focal: [KernelNumber<'a>; 2],
    projection: LensProjection<KernelNumber<'a>>,
}

impl<'a> KernelBent<'a> {
    fn new(
        scope: &'a Scope,
        mean_cam: Vec3Expand,
        rows: Mat3Expand,
        axes: [&CameraAxisExpand; 2],
        lens: &DistortionArgExpand,
    ) -> Self {
        let DistortionArgExpand { k1, k2, k3, k4, d1, d2, d3, tangential, outward, max_radius_squared, model } = *lens;
        let (radial, denominator) = ([k1, k2, k3, k4], [d1, d2, d3]);
        let [tangential, outward] = [tangential, outward].map(|pair| [pair.x, pair.y]);
        let distortion = Distortion { model, radial, denominator, tangential, outward, max_radius_squared };
        let n = |value| KernelNumber::of(scope, value);
        let distortion = distortion.map(n);
        let limits = [axes.map(|axis| n(axis.low)), axes.map(|axis| n(axis.high))];
        let rows = [rows.x, rows.y, rows.z].map(|row| KernelNumber::vector(scope, row));
        let projection = LensProjection::new(&distortion, KernelNumber::vector(scope, mean_cam), rows, limits);
        Self { distortion, focal: axes.map(|axis| n(axis.focal)), projection }
    }
}

/// Returns the rows of `J W R`, the distorted position of the centre, and whether the centre lies within the lens's domain.
#[cube]
fn lens_rows(
    mean_cam: Vec3,
    rows: Mat3,
    x: &CameraAxis,
    y: &CameraAxis,
    lens: &DistortionArg,
) -> (Vec3, Vec3, Vec2, bool) {
    intrinsic!(|scope| {
        let KernelBent { focal, projection, .. } = KernelBent::new(scope, mean_cam, rows, [x, y], lens);
        let ([j_x, j_y], [x, y]) = (projection.rows(focal), projection.seen_at());
        (vec3(j_x), vec3(j_y), Vec2Expand { x: x.value, y: y.value }, projection.within.value)
    })
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
    let (j_x, j_y, at, within) = lens_rows(mean_cam, rows, x, y, lens);
    let x = JacobianRow { ratio: at.x, slope: at.x, slope_free: false, j: j_x, m: j_x.by_axis(scale) };
    let y = JacobianRow { ratio: at.y, slope: at.y, slope_free: false, j: j_y, m: j_y.by_axis(scale) };
    (x, y, within)
}

/// Gradients of `W R` and of the centre from those of the rows of `J W R` and of the distorted position.
#[cube]
fn lens_backward(
    mean_cam: Vec3,
    rows: Mat3,
    x: &CameraAxis,
    y: &CameraAxis,
    lens: &DistortionArg,
    grad_j: (Vec3, Vec3),
    grad_at: Vec2,
) -> SeenGrad {
    intrinsic!(|scope| {
        let KernelBent { distortion, focal, projection } = KernelBent::new(scope, mean_cam, rows, [x, y], lens);
        let grad_j = [grad_j.0, grad_j.1].map(|row| KernelNumber::vector(scope, row));
        let grad_at = [grad_at.x, grad_at.y].map(|value| KernelNumber::of(scope, value));
        let LensProjectionGrad { mean_cam, rows: [x, y, z] } = projection.backward(&distortion, focal, grad_j, grad_at);
        SeenGradExpand { turned: Mat3Expand { x: vec3(x), y: vec3(y), z: vec3(z) }, centre: vec3(mean_cam) }
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
    let grad_at = Vec2::new(grad_centre.x * x.focal, grad_centre.y * y.focal);
    let out = lens_backward(mean_cam, rows, x, y, lens, grad_j, grad_at);
    SeenGrad { turned: out.turned, centre: Vec3::new(out.centre.x, out.centre.y, out.centre.z + grad_centre.z) }
}
