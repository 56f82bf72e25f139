//! Backward kernel of `ray_space`: one unit per Gaussian projects it again and differentiates the result. Gradients that are
//! not needed are not kernel arguments.

use cubecl::prelude::*;

use super::forward::{RaySpaceTerms, lean};
use super::lens_bounds_kernel::jacobian_at;
use super::{LENS_FRAME, RAY_SPACE};
use crate::gpu::math::{Mat3, Vec2, Vec3};
use crate::project::backward::{GeometryGradMask, no_gradient, store_pose, world_backward};
use crate::project::forward::{GeometryInputs, PackedEllipse, ProjectCamera, ProjectionTerms, project_one};
use crate::project::lens_backward::bent_backward;
use crate::project::lens_forward::{Distortion, SeenGrad};

/// Gradient of a row.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct RayGrad {
    depth_slope_u: f32,
    depth_slope_v: f32,
    thickness: f32,
    /// That of the centre's relative depth, and of its offset, px.
    depth: f32,
    centre: Vec2,
    sigma_u: f32,
    shear: f32,
    sigma_v: f32,
    /// Whether any is not zero, by its bits, so that NaN counts.
    any: bool,
}

#[cube]
impl RayGrad {
    fn load(from: &[f32], at: usize) -> RayGrad {
        let mut any = 0u32;
        #[unroll]
        for column in 0..comptime!(RAY_SPACE) {
            any |= u32::reinterpret(from[at + column]);
        }
        RayGrad {
            depth_slope_u: from[at],
            depth_slope_v: from[at + 1],
            thickness: from[at + 2],
            depth: from[at + 3],
            centre: Vec2::new(from[at + 4], from[at + 5]),
            sigma_u: from[at + 6],
            shear: from[at + 7],
            sigma_v: from[at + 8],
            any: (any & 0x7fff_ffff) != 0,
        }
    }
}

/// Gradients of `m0`, `m1` and `mz`, and `B₀₀, B₀₁, B₁₁` of the module's documentation.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct RowsGrad {
    m0: Vec3,
    m1: Vec3,
    mz: Vec3,
    blur_xx: f32,
    blur_xy: f32,
    blur_yy: f32,
}

#[cube]
fn factor_backward(f: &ProjectionTerms, l: &RaySpaceTerms, blur_sigma: f32, grad: &RayGrad) -> RowsGrad {
    let (inverse_u, inverse_v) = (1.0 / f.sigma_u, 1.0 / f.sigma_v);
    // The rows of `N`, each at most of length one. The last one is zero where the thickness is clamped or the row was set to zero.
    let across = l.p.cross(f.n).plus(l.a.times(l.b_u));
    let free = l.free && l.sound && l.thickness > 0.0;
    let inverse = select(free, 1.0 / select(free, l.thickness, 1.0), 0.0);
    let length = l.mz.length();
    let of_length = l.mz.times(select(length > 0.0, 1.0 / select(length > 0.0, length, 1.0), 0.0));
    let rest = l.b * l.b_u * length * inverse;
    let through = l.p.times(l.mz.dot(l.p) * inverse).plus(l.c.times(l.b * inverse).cross(f.n).times(l.b));
    let through = through.plus(l.a.cross(l.mz).times(inverse).cross(l.a)).plus(of_length.times(rest * l.b * l.b_u));
    let of_u = select(l.sound, grad.depth_slope_u, 0.0);
    let of_v = select(l.sound, grad.depth_slope_v, 0.0);
    let of_t = select(free, grad.thickness, 0.0);
    let slope_u = select(l.sound, l.depth_slope_u, 0.0);
    let slope_v = select(l.sound, l.depth_slope_v, 0.0);
    let thickness = select(free, l.thickness, 0.0);
    // The gradients of `m0` and `m1` in terms of the rows of `N`.
    let shear = f.shear;
    let leaning = grad.shear * inverse_u;
    let turned = (of_v * thickness - of_t * slope_v) * inverse_v;
    let first_n = grad.sigma_u - leaning * shear;
    let first_across = (leaning * f.sigma_v + (of_u * slope_v - of_v * slope_u)) * inverse_u - grad.sigma_v * shear;
    let first_through = (of_u * thickness - of_t * slope_u) * inverse_u - turned * shear;
    let through = Vec3::new(select(free, through.x, 0.0), select(free, through.y, 0.0), select(free, through.z, 0.0));
    // The components of the rows of `N` along the blur of x and of y.
    let across_x = -(shear * l.b);
    let through_x = (slope_v * shear * l.b - slope_u * l.b_u) * inverse;
    let through_y = -(slope_v * l.b) * inverse;
    RowsGrad {
        m0: f.n.times(first_n).plus(across.times(first_across)).plus(through.times(first_through)),
        m1: f.n.times(leaning).plus(across.times(grad.sigma_v)).plus(through.times(turned)),
        mz: f.n.times(of_u).plus(across.times(of_v)).plus(through.times(of_t)),
        blur_xx: blur_sigma * (first_n * l.b_u + first_across * across_x + first_through * through_x),
        blur_xy: blur_sigma * (first_across * l.b + first_through * through_y),
        blur_yy: blur_sigma * (grad.sigma_v * l.b + turned * through_y),
    }
}

/// The linear map at a Gaussian: the slopes `t` and the rows of `G`, px per slope.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct LinearMap {
    slopes: Vec2,
    x: Vec2,
    y: Vec2,
}

#[cube]
impl LinearMap {
    fn of(f: &ProjectionTerms, mean: Vec3, camera: &ProjectCamera) -> LinearMap {
        #[comptime]
        match camera.distortion {
            ComptimeOption::Some(distortion) => {
                let (x, y, _bent) = jacobian_at(mean, camera, &distortion);
                LinearMap {
                    slopes: Vec2::new(mean.x / mean.z, mean.y / mean.z),
                    x: Vec2::new(mean.z * x.x, mean.z * x.y),
                    y: Vec2::new(mean.z * y.x, mean.z * y.y),
                }
            }
            ComptimeOption::None => {
                let zero = 0.0f32.runtime();
                LinearMap {
                    slopes: Vec2::new(f.x.slope, f.y.slope),
                    x: Vec2::new(camera.x.focal, zero),
                    y: Vec2::new(zero, camera.y.focal),
                }
            }
        }
    }
}

/// Returns the gradient of a centre through `G` of a lens. The blur alone depends on `G`, whose gradient is `−B G⁻ᵀ`.
#[cube]
fn map_backward(map: &LinearMap, mean: Vec3, grad: &RowsGrad, camera: &ProjectCamera, distortion: &Distortion) -> Vec3 {
    let (x, y, bent) = jacobian_at(mean, camera, distortion);
    let zero = 0.0f32.runtime();
    let scaled = -mean.z / (map.x.x * map.y.y - map.x.y * map.y.x);
    let of_x = Vec3::new(
        (grad.blur_xx * map.y.y - grad.blur_xy * map.x.y) * scaled,
        (grad.blur_xy * map.x.x - grad.blur_xx * map.y.x) * scaled,
        zero,
    );
    let of_y = Vec3::new(
        (grad.blur_xy * map.y.y - grad.blur_yy * map.x.y) * scaled,
        (grad.blur_yy * map.x.x - grad.blur_xy * map.y.x) * scaled,
        zero,
    );
    let none =
        PackedEllipse { x: zero, y: zero, sigma_u: zero, shear: zero, sigma_v: zero, depth: zero, opacity: zero };
    let through = bent_backward(&bent, camera, (of_x, of_y), &none).centre;
    let along = (of_x.x * x.x + of_x.y * x.y + of_y.x * y.x + of_y.y * y.y) / mean.z;
    Vec3::new(through.x, through.y, through.z + along)
}

#[cube(launch_unchecked)]
pub(super) fn ray_space_backward_kernel(
    inputs: GeometryInputs,
    grad: &[f32],
    grad_means: ComptimeOption<&mut [f32]>,
    grad_rotations: ComptimeOption<&mut [Vector<f32, Const<4>>]>,
    grad_scales: ComptimeOption<&mut [f32]>,
    grad_mean2d: ComptimeOption<&mut [f32]>,
    pose_rows: ComptimeOption<&mut [f32]>,
    camera: ProjectCamera,
    count: u32,
    #[comptime] _given: u32,
) {
    let wanted = comptime!(GeometryGradMask {
        means: grad_means.is_some(),
        rotations: grad_rotations.is_some(),
        scales: grad_scales.is_some(),
        pose: pose_rows.is_some(),
    });
    let gaussian = ABSOLUTE_POS;
    let mut of = no_gradient();
    if gaussian < count as usize {
        let columns = comptime!(RAY_SPACE + if camera.distortion.is_some() { LENS_FRAME } else { 0 });
        let of_row = RayGrad::load(grad, gaussian * columns);
        // Most Gaussians of a large scene are out of view, with a gradient of exactly zero.
        if of_row.any {
            let (pose, g) = (inputs.pose(), inputs.gaussian(gaussian));
            let f = project_one(&g, &pose, &camera);
            let l = lean(&f, &g, &camera);
            if f.visible {
                let of_m = factor_backward(&f, &l, camera.blur_sigma, &of_row);
                of.scale = of_m.m0.by_axis(f.x.j).plus(of_m.m1.by_axis(f.y.j)).plus(of_m.mz.by_axis(l.j));
                of.mean2d_x = of_row.centre.x;
                of.mean2d_y = of_row.centre.y;
                let (of_x, of_y) = (of_m.m0.by_axis(g.scale), of_m.m1.by_axis(g.scale));
                let inverse_z = 1.0 / f.depth;
                let mean = pose.apply(g.mean);
                let map = LinearMap::of(&f, mean, &camera);
                // `J` has the rows `G (1, −t) / z` and `(0, 0, 1) / z`, and a centre moves in the picture by the former.
                let turned_x = of_x.times(map.x.x).plus(of_y.times(map.y.x)).times(inverse_z);
                let turned_y = of_x.times(map.x.y).plus(of_y.times(map.y.y)).times(inverse_z);
                let to_last = turned_x.times(map.slopes.x).plus(turned_y.times(map.slopes.y));
                let turned =
                    Mat3 { x: turned_x, y: turned_y, z: of_m.mz.by_axis(g.scale).times(inverse_z).minus(to_last) };
                let centre_x = (of_row.centre.x * map.x.x + of_row.centre.y * map.y.x) * inverse_z;
                let centre_y = (of_row.centre.x * map.x.y + of_row.centre.y * map.y.y) * inverse_z;
                let along = (of_row.depth + of_m.blur_xx + of_m.blur_yy) * inverse_z;
                let centre_z = along - (centre_x * map.slopes.x + centre_y * map.slopes.y);
                let mut centre = Vec3::new(centre_x, centre_y, centre_z);
                #[comptime]
                if let ComptimeOption::Some(distortion) = camera.distortion {
                    centre = centre.plus(map_backward(&map, mean, &of_m, &camera, &distortion));
                }
                world_backward(&mut of, &SeenGrad { turned, centre }, &g, &f, &pose, wanted);
            }
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_means {
            of.mean.store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_rotations {
            of.rotation.store(out, gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_scales {
            of.scale.store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = grad_mean2d {
            out[2 * gaussian] = of.mean2d_x;
            out[2 * gaussian + 1] = of.mean2d_y;
        }
    }
    #[comptime]
    if let ComptimeOption::Some(rows) = pose_rows {
        store_pose(&of.pose, rows, count);
    }
}
