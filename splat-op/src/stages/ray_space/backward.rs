//! Backward kernel of `ray_space`: one unit per Gaussian projects it again and differentiates the result. Gradients that are
//! not needed are not kernel arguments.

use cubecl::prelude::*;

use super::formulas::RaySpaceGrad;
use super::forward::{KernelFrame, lens_map, not_rotated, terms_of};
use super::{LENS_COLUMNS, RAY_SPACE};
use crate::gpu::{KernelNumber, Mat3Expand, Vec2, Vec3, load_row, vec3};
use crate::project::Geometry;
use crate::project::backward::{GeometryOutputs, no_gradient, world_backward};
use crate::project::forward::{Gaussian, GeometryInputs, ProjectCamera, ProjectionTerms, project_one};
use crate::project::lens_kernel::{DistortionArg, SeenGrad, SeenGradExpand, bent_backward};

/// Whether any number is not zero, by its bits, so that NaN counts.
#[cube]
fn any(row: &Sequence<f32>) -> bool {
    let mut bits = 0u32;
    #[unroll]
    for column in 0..comptime!(RAY_SPACE) {
        bits |= u32::reinterpret(row[column]);
    }
    (bits & 0x7fff_ffff) != 0
}

/// Returns the gradients of the scales, of `W R` and the centre in the camera's frame, and `B₀₀, B₀₁, B₁₁`, from that of a row.
#[cube]
fn row_backward(
    f: &ProjectionTerms,
    g: &Gaussian,
    blur_sigma: f32,
    map: &KernelFrame,
    grad: &Sequence<f32>,
) -> (Vec3, SeenGrad, Vec3) {
    intrinsic!(|scope| {
        let j = [f.x.j, f.y.j].map(|row| KernelNumber::vector(scope, row));
        let terms = terms_of(scope, f, g, blur_sigma);
        let RaySpaceGrad { scales, rows: [x, y, z], centre, blur } =
            terms.backward(j, &map.numbers(scope), &KernelNumber::row(scope, grad));
        let turned = Mat3Expand { x: vec3(x), y: vec3(y), z: vec3(z) };
        (vec3(scales), SeenGradExpand { turned, centre: vec3(centre) }, vec3(blur))
    })
}

/// Returns the gradients of the rows of a lens's Jacobian, and their share of that of the depth, from `B₀₀, B₀₁, B₁₁`.
#[cube]
fn jacobian_backward(map: &KernelFrame, z: f32, jacobian: (Vec3, Vec3), blur: Vec3) -> (Vec3, Vec3, f32) {
    intrinsic!(|scope| {
        let jacobian = [jacobian.0, jacobian.1].map(|row| KernelNumber::vector(scope, row));
        let blur = KernelNumber::vector(scope, blur);
        let ([x, y], of_z) = map.numbers(scope).backward(KernelNumber::of(scope, z), &jacobian, blur);
        (vec3(x), vec3(y), of_z.value)
    })
}

/// Returns the gradient of a centre in the camera's frame through `G` of a lens.
#[cube]
fn map_backward(mean: Vec3, blur: Vec3, camera: &ProjectCamera, distortion: &DistortionArg) -> Vec3 {
    let (map, jacobian) = lens_map(mean, camera, distortion);
    let (of_x, of_y, of_z) = jacobian_backward(&map, mean.z, jacobian, blur);
    let zero = 0.0f32.runtime();
    let grad = Vec3::new(zero, zero, of_z);
    bent_backward(mean, not_rotated(), &camera.x, &camera.y, distortion, (of_x, of_y), grad).centre
}

/// Returns the linear map at a Gaussian.
#[cube]
fn map_of(f: &ProjectionTerms, mean: Vec3, camera: &ProjectCamera) -> KernelFrame {
    #[comptime]
    match camera.distortion {
        ComptimeOption::Some(distortion) => {
            let (map, _jacobian) = lens_map(mean, camera, &distortion);
            map
        }
        ComptimeOption::None => {
            let zero = 0.0f32.runtime();
            KernelFrame {
                centre: Vec2::new(f.x.slope, f.y.slope),
                x: Vec2::new(camera.x.focal, zero),
                y: Vec2::new(zero, camera.y.focal),
            }
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn ray_space_backward_kernel(
    inputs: GeometryInputs,
    grad: &[f32],
    mut outputs: GeometryOutputs,
    camera: ProjectCamera,
    count: u32,
    #[comptime] wanted: Geometry<bool>,
) {
    let gaussian = ABSOLUTE_POS;
    let mut of = no_gradient();
    if gaussian < count as usize {
        let columns = comptime!(if camera.distortion.is_some() { LENS_COLUMNS } else { RAY_SPACE });
        let of_row = load_row(grad, gaussian * columns, RAY_SPACE);
        // Most Gaussians of a large scene are out of view, with a gradient of exactly zero.
        if any(&of_row) {
            let (pose, g) = (inputs.pose(), inputs.gaussian(gaussian));
            let f = project_one(&g, &pose, &camera);
            if f.visible {
                let mean = pose.apply(g.mean);
                let map = map_of(&f, mean, &camera);
                let (scale, seen, blur) = row_backward(&f, &g, camera.blur_sigma, &map, &of_row);
                of.scale = scale;
                of.mean2d_x = of_row[4];
                of.mean2d_y = of_row[5];
                let mut centre = seen.centre;
                #[comptime]
                if let ComptimeOption::Some(distortion) = camera.distortion {
                    centre = centre.plus(map_backward(mean, blur, &camera, &distortion));
                }
                world_backward(&mut of, &SeenGrad { turned: seen.turned, centre }, &g, &f, &pose, wanted);
            }
        }
        outputs.store(&of, gaussian);
    }
    outputs.store_pose(&of.pose, count);
}
