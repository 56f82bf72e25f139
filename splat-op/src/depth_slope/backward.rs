//! Backward kernel of `depth_slope`: one unit per Gaussian projects it again and differentiates the result. Gradients that are
//! not needed are not kernel arguments.
//!
//! `p`, `a` and `b` together have length one and the common denominator `sigma_v`; `n` and `bᵤ` have the denominator `sigma_u`.
//! For numerators divided by their own length, the gradient is the gradient of the quotients without its component along them,
//! divided by the length.

use cubecl::prelude::*;

use super::forward::{DepthSlopeTerms, lean};
use super::lens_bounds_kernel::{LensFrame, jacobian_at};
use super::{DEPTH_SLOPE, LENS_FRAME};
use crate::gpu::math::{Pose, Vec3};
use crate::project::backward::{GeometryGradMask, no_gradient, seen_backward, store_pose};
use crate::project::forward::{Gaussian, PackedEllipse, ProjectCamera, ProjectionTerms, project_one};
use crate::project::lens_backward::bent_backward;

/// Gradients of `m0`, `m1` and `mz`.
#[cube]
fn factor_backward(
    f: &ProjectionTerms,
    l: &DepthSlopeTerms,
    grad_u: f32,
    grad_v: f32,
    grad_thickness: f32,
) -> (Vec3, Vec3, Vec3) {
    let (n, m1, mz, a, p) = (f.n, f.y.m, l.mz, l.a, l.p);
    let e = a.cross(mz);
    let length = mz.length();
    // Four parts of the thickness, each divided by the thickness; each has at most length one.
    let free = l.free && l.thickness > 0.0;
    let grad_thickness = select(free, grad_thickness, 0.0);
    let inverse = select(free, 1.0 / select(free, l.thickness, 1.0), 0.0);
    let along_p = mz.dot(p) * inverse;
    let along_c = l.c.times(l.b * inverse);
    let along_e = e.times(inverse);
    let rest = l.b * l.b_u * length * inverse;
    let of_length = mz.times(select(length > 0.0, 1.0 / select(length > 0.0, length, 1.0), 0.0));

    let through = p.times(along_p).plus(along_c.cross(n).times(l.b)).plus(along_e.cross(a));
    let through = through.plus(of_length.times(rest * l.b * l.b_u));
    let grad_mz =
        n.times(grad_u).plus(p.cross(n).plus(a.times(l.b_u)).times(grad_v)).plus(through.times(grad_thickness));
    let grad_n = mz.times(grad_u).plus(mz.cross(p).times(grad_v)).plus(mz.cross(along_c).times(l.b * grad_thickness));
    let grad_p = l.c.times(grad_v).plus(mz.times(along_p * grad_thickness));
    let grad_a = mz.times(l.b_u * grad_v).plus(mz.cross(along_e).times(grad_thickness));
    let grad_b = grad_thickness * (along_c.dot(l.c) + rest * l.b_u * length);
    let grad_b_u = grad_v * a.dot(mz) + grad_thickness * rest * l.b * length;

    let radial = grad_p.dot(p) + grad_a.dot(a) + grad_b * l.b;
    let grad_across = grad_p.minus(p.times(radial)).times(1.0 / f.sigma_v);
    let grad_along = grad_a.minus(a.times(radial)).times(l.b);
    let grad_n = grad_n.plus(m1.cross(grad_across));
    let radial = grad_n.dot(n) + grad_b_u * l.b_u + grad_along.dot(f.along);
    let inverse_u = 1.0 / f.sigma_u;
    let grad_m0 = grad_n.minus(n.times(radial)).times(inverse_u);
    let grad_m1 = grad_across.cross(n).plus(grad_along.times(inverse_u));
    (grad_m0, grad_m1, grad_mz)
}

#[cube(launch_unchecked)]
pub(super) fn depth_slope_backward_kernel(
    means: &[f32],
    rotations: &[Vector<f32, Const<4>>],
    scales: &[f32],
    opacities: &[f32],
    cam_from_world: &[f32],
    grad: &[f32],
    grad_means: ComptimeOption<&mut [f32]>,
    grad_rotations: ComptimeOption<&mut [Vector<f32, Const<4>>]>,
    grad_scales: ComptimeOption<&mut [f32]>,
    pose_rows: ComptimeOption<&mut [f32]>,
    lens: ProjectCamera,
    count: u32,
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
        let columns = comptime!(DEPTH_SLOPE + if lens.distortion.is_some() { LENS_FRAME } else { 0 });
        let at = gaussian * columns;
        let (grad_u, grad_v, grad_thickness) = (grad[at], grad[at + 1], grad[at + 2]);
        // Most Gaussians of a large scene are out of view, with a gradient of exactly zero. The test is by bits, so that NaN
        // counts.
        let mut any = u32::reinterpret(grad_u) | u32::reinterpret(grad_v) | u32::reinterpret(grad_thickness);
        #[unroll]
        for column in comptime!(DEPTH_SLOPE)..columns {
            any |= u32::reinterpret(grad[at + column]);
        }
        if (any & 0x7fff_ffff) != 0 {
            let pose = Pose::load(cam_from_world);
            let g = Gaussian::load(means, rotations, scales, opacities, gaussian);
            let f = project_one(&g, &pose, &lens);
            let l = lean(&f, &g, &lens);
            if l.sound {
                let (grad_m0, grad_m1, grad_mz) = factor_backward(&f, &l, grad_u, grad_v, grad_thickness);
                of.scale = grad_m0.by_axis(f.x.j).plus(grad_m1.by_axis(f.y.j)).plus(grad_mz.by_axis(l.j));
                let zero = 0.0f32.runtime();
                let none = PackedEllipse {
                    x: zero,
                    y: zero,
                    sigma_u: zero,
                    shear: zero,
                    sigma_v: zero,
                    depth: zero,
                    opacity: zero,
                };
                let mut seen = seen_backward(&f, &lens, (grad_m0.by_axis(g.scale), grad_m1.by_axis(g.scale)), &none);
                // Gradient of the last row, which is divided by z.
                let grad_j = grad_mz.by_axis(g.scale);
                let inverse_z = 1.0 / f.depth;
                seen.turned.z = seen.turned.z.plus(grad_j.times(inverse_z));
                seen.centre.z -= grad_j.dot(l.j) * inverse_z;
                #[comptime]
                if let ComptimeOption::Some(distortion) = lens.distortion {
                    let (mean, frame) = (pose.apply(g.mean), LensFrame::load(grad, gaussian));
                    let (x, y, bent) = jacobian_at(mean, &lens, &distortion);
                    seen.centre.z += frame.x.x * x.x + frame.x.y * x.y + frame.y.x * y.x + frame.y.y * y.y;
                    let (of_x, of_y) = (frame.x.times(mean.z), frame.y.times(mean.z));
                    let grad_jacobian = (Vec3::new(of_x.x, of_x.y, 0.0), Vec3::new(of_y.x, of_y.y, 0.0));
                    seen.centre = seen.centre.plus(bent_backward(&bent, &lens, grad_jacobian, &none).centre);
                }
                if comptime!(wanted.means) {
                    of.mean = pose.matrix.apply_transposed(seen.centre);
                }
                if comptime!(wanted.rotations) {
                    let unturned = pose.matrix.transposed().times(seen.turned);
                    of.rotation = f.quaternion.backward(f.quaternion_length, unturned);
                }
                if comptime!(wanted.pose) {
                    let from = f.world_from_gaussian;
                    of.pose.matrix.x = from.apply(seen.turned.x).plus(g.mean.times(seen.centre.x));
                    of.pose.matrix.y = from.apply(seen.turned.y).plus(g.mean.times(seen.centre.y));
                    of.pose.matrix.z = from.apply(seen.turned.z).plus(g.mean.times(seen.centre.z));
                    of.pose.translation = seen.centre;
                }
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
    }
    #[comptime]
    if let ComptimeOption::Some(rows) = pose_rows {
        store_pose(&of.pose, rows, count);
    }
}
