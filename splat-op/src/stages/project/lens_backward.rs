//! Lenses in the kernels of `project`, backward: the arithmetic of the contract in `lens.rs`.

use cubecl::prelude::*;

use super::forward::{PackedEllipse, ProjectCamera};
use super::lens_forward::{Distortion, Fisheye, LensProjection, Mat2, Perspective, PlanarMap, SeenGrad};
use crate::gpu::math::{Mat3, Vec2, Vec3};

/// The second derivative of the planar map, contracted with a matrix.
#[cube]
fn second(distortion: &Distortion, at: &PlanarMap, m: &Mat2) -> Vec2 {
    let (s, p) = (at.s, distortion.tangential);
    let trace = m.x.x + m.y.y;
    let by_s = m.apply(s);
    let radial = s.times(trace).plus(by_s).plus(m.apply_transposed(s)).times(2.0 * at.slope);
    let decentred = p.times(trace).plus(m.apply(p)).plus(m.apply_transposed(p.plus(distortion.prism)));
    radial.plus(s.times(4.0 * at.bend * s.dot(by_s))).plus(decentred.times(2.0))
}

/// Gradients of `W R` and of the centre from those of the rows of `J W R` and of the ellipse.
#[cube]
pub(crate) fn bent_backward(
    bent: &LensProjection,
    camera: &ProjectCamera,
    grad_j: (Vec3, Vec3),
    grad: &PackedEllipse,
) -> SeenGrad {
    let distortion = camera.distortion.unwrap();
    let (x, y, by) = (grad_j.0.times(camera.x.focal), grad_j.1.times(camera.y.focal), bent.held.by);
    let base_x = x.times(by.x.x).plus(y.times(by.y.x));
    let base_y = x.times(by.x.y).plus(y.times(by.y.y));
    let of_by = Mat2 {
        x: Vec2::new(x.dot(bent.base_x), x.dot(bent.base_y)),
        y: Vec2::new(y.dot(bent.base_x), y.dot(bent.base_y)),
    };
    let of_held = second(&distortion, &bent.held, &of_by);
    let of_centre = bent.centre.by.apply_transposed(Vec2::new(grad.x * camera.x.focal, grad.y * camera.y.focal));
    let out = first_backward(bent, (base_x, base_y), of_held, of_centre);
    SeenGrad { turned: out.turned, centre: Vec3::new(out.centre.x, out.centre.y, out.centre.z + grad.depth) }
}

/// Gradient of the first step, from those of `b₀, b₁`, of the position at which the Jacobian is evaluated, and of the centre.
#[cube]
fn first_backward(bent: &LensProjection, grad_base: (Vec3, Vec3), grad_held: Vec2, grad_centre: Vec2) -> SeenGrad {
    #[comptime]
    match bent.perspective {
        ComptimeOption::Some(step) => perspective_backward(bent, &step, grad_base, grad_held, grad_centre),
        ComptimeOption::None =>
        {
            #[comptime]
            match bent.fisheye {
                ComptimeOption::Some(step) => fisheye_backward(bent, &step, grad_base, grad_held.plus(grad_centre)),
                ComptimeOption::None => SeenGrad {
                    turned: Mat3 { x: grad_base.0, y: grad_base.1, z: Vec3::new(0.0, 0.0, 0.0) },
                    centre: Vec3::new(grad_centre.x, grad_centre.y, 0.0),
                },
            }
        }
    }
}

#[cube]
fn perspective_backward(
    bent: &LensProjection,
    step: &Perspective,
    grad_base: (Vec3, Vec3),
    grad_held: Vec2,
    grad_ratio: Vec2,
) -> SeenGrad {
    let (inverse, s, last) = (step.inverse_depth, bent.held.s, bent.rows.z);
    let (row_x, row_y) = (grad_base.0.times(inverse), grad_base.1.times(inverse));
    let x = (grad_ratio.x + select(step.free_x, grad_held.x - row_x.dot(last), 0.0)) * inverse;
    let y = (grad_ratio.y + select(step.free_y, grad_held.y - row_y.dot(last), 0.0)) * inverse;
    let shrinking = (grad_base.0.dot(bent.base_x) + grad_base.1.dot(bent.base_y)) * inverse;
    SeenGrad {
        turned: Mat3 { x: row_x, y: row_y, z: row_x.times(-s.x).minus(row_y.times(s.y)) },
        centre: Vec3::new(x, y, -shrinking - x * step.ratio.x - y * step.ratio.y),
    }
}

#[cube]
fn fisheye_backward(bent: &LensProjection, step: &Fisheye, grad_base: (Vec3, Vec3), grad_s: Vec2) -> SeenGrad {
    let (p, rows, inverse) = (step.p, bent.rows, step.inverse_length);
    let (x, y) = (grad_base.0.times(inverse), grad_base.1.times(inverse));
    let sum = x.times(p.x).plus(y.times(p.y));
    let (u, m, last) = (x.dot(rows.x) + y.dot(rows.y), sum.dot(step.across), sum.dot(rows.z));
    let along = p.dot(grad_s);
    let common = step.beta * (u + along) + step.delta * m + 2.0 * last;
    let of_rows = Vec2::new(sum.dot(rows.x), sum.dot(rows.y)).times(step.beta);
    let lean = Vec2::new(x.dot(step.lean), y.dot(step.lean));
    let of_p = lean.plus(of_rows).plus(p.times(common)).plus(grad_s.times(step.alpha));
    let of_c = 2.0 * (m + step.c * last) - u - along;
    let shared = sum.times(step.beta);
    SeenGrad {
        turned: Mat3 {
            x: x.times(step.alpha).plus(shared.times(p.x)),
            y: y.times(step.alpha).plus(shared.times(p.y)),
            z: sum.times(-1.0),
        },
        centre: Vec3::new(of_p.x, of_p.y, of_c).times(inverse),
    }
}
