//! Kernel of `project`, backward: one unit per Gaussian, which projects it again and then differentiates. Outputs that are
//! not asked for are not arguments, and the code that only they need is not compiled into the kernel.
//!
//! With `P = |p|`, `S = sigma_v`, `a = m1 / sigma_u` and the blur `ε`, the factor and the compensation have the differentials
//!
//! ```text
//! S dS = P dP + ε a·da        d(P / S) = (ε + ε |a|²) / S² · dP / S − P / S · ε a·da / S²
//! ```
//!
//! The second is written without a difference of almost equal numbers: if the blur is small compared with the Gaussian, the
//! compensation is almost one for every Gaussian, and without blur it is exactly one.

use cubecl::prelude::*;

use super::Geometry;
use super::axis::{CameraAxis, JacobianRow};
use super::forward::{Gaussian, GeometryInputs, PackedEllipse, ProjectCamera, ProjectionTerms, project_one};
use super::lens_kernel::{SeenGrad, bent_backward};
use crate::gpu::{Mat3, POSE, Pose, Quaternion, UNITS, Vec3, cube_vector_sum};

/// Whether any field is not zero, by its bits, so that NaN counts.
#[cube]
pub(crate) fn any(packed: &PackedEllipse) -> bool {
    let mean = u32::reinterpret(packed.x) | u32::reinterpret(packed.y);
    let sigmas = u32::reinterpret(packed.sigma_u) | u32::reinterpret(packed.sigma_v);
    let rest = u32::reinterpret(packed.shear) | u32::reinterpret(packed.depth) | u32::reinterpret(packed.opacity);
    ((mean | sigmas | rest) & 0x7fff_ffff) != 0
}

/// Gradients of `m0` and `m1`.
#[cube]
fn factor_backward(f: &ProjectionTerms, camera: &ProjectCamera, opacity: f32, grad: &PackedEllipse) -> (Vec3, Vec3) {
    let inverse_v = 1.0 / f.sigma_v;
    // Both factors are at most one for all scales.
    let blur = camera.blur_sigma * inverse_v;
    let blur_along = f.along.times(blur);
    // Not by `p` times a quotient, which leaves the range of f32 where the Gaussian is large.
    let mut grad_p = f.p.times(inverse_v).times(grad.sigma_v);
    let mut along_weight = camera.blur_sigma * grad.sigma_v;
    if comptime!(camera.antialias) {
        let grad_compensation = grad.opacity * opacity;
        if f.compensation_free {
            let weight = grad_compensation * inverse_v * (blur * blur + blur_along.dot(blur_along));
            // Two divisions instead of one by `P S`, which may be out of range.
            grad_p = grad_p.plus(f.p.times(1.0 / f.p_length).times(weight));
            along_weight -= blur * grad_compensation * f.compensation;
        }
    }
    let grad_along = blur_along.times(along_weight).plus(f.n.times(grad.shear));
    let grad_n = f.along.times(grad.shear).plus(f.y.m.cross(grad_p));
    let inverse_u = 1.0 / f.sigma_u;
    let grad_sigma_u = grad.sigma_u - (grad_along.dot(f.along) + grad_n.dot(f.n)) * inverse_u;
    let grad_m0 = grad_n.times(inverse_u).plus(f.n.times(grad_sigma_u));
    let grad_m1 = grad_p.cross(f.n).plus(grad_along.times(inverse_u));
    (grad_m0, grad_m1)
}

/// Gradients of the inputs of one axis of the picture.
#[derive(CubeType, Clone, Copy)]
struct JacobianRowGrad {
    /// Gradient of the centre's camera x or y, and this axis's share of the gradient of its z.
    across: f32,
    depth: f32,
    /// Gradient of the row of `W R`. The last row's gradient gets `−slope` times this.
    row: Vec3,
}

#[cube]
fn row_backward(
    f: &ProjectionTerms,
    row: &JacobianRow,
    axis: &CameraAxis,
    grad_j: Vec3,
    grad_mean_px: f32,
) -> JacobianRowGrad {
    let inverse = 1.0 / f.mean_cam.z;
    // j = (focal / z) (row − slope · last)
    let grad_row = grad_j.times(axis.focal * inverse);
    let through_slope = select(row.slope_free, grad_row.dot(f.cam_from_gaussian.z), 0.0);
    let across = (grad_mean_px * axis.focal - through_slope) * inverse;
    JacobianRowGrad { across, depth: -(grad_j.dot(row.j) * inverse) - across * row.ratio, row: grad_row }
}

/// Gradients of `W R` and of the centre from those of the rows of `J W R` and of the ellipse.
#[cube]
pub(crate) fn seen_backward(
    p: &ProjectionTerms,
    camera: &ProjectCamera,
    grad_j: (Vec3, Vec3),
    grad: &PackedEllipse,
) -> SeenGrad {
    if comptime!(camera.distortion.is_some()) {
        let lens = camera.distortion.unwrap();
        let grad = Vec3::new(grad.x, grad.y, grad.depth);
        bent_backward(p.mean_cam, p.cam_from_gaussian, &camera.x, &camera.y, &lens, grad_j, grad)
    } else {
        let x = row_backward(p, &p.x, &camera.x, grad_j.0, grad.x);
        let y = row_backward(p, &p.y, &camera.y, grad_j.1, grad.y);
        let to_last = x.row.times(p.x.slope).plus(y.row.times(p.y.slope));
        SeenGrad {
            turned: Mat3 { x: x.row, y: y.row, z: Vec3::new(0.0, 0.0, 0.0).minus(to_last) },
            centre: Vec3::new(x.across, y.across, grad.depth + x.depth + y.depth),
        }
    }
}

/// Gradients of one Gaussian's parameters and of its projected centre, per px, and its share of the pose's gradient.
#[derive(CubeType, CubeTypeMut, Clone, Copy)]
pub(crate) struct GaussianGrad {
    pub mean: Vec3,
    pub rotation: Quaternion,
    pub scale: Vec3,
    pub opacity: f32,
    pub mean2d_x: f32,
    pub mean2d_y: f32,
    pub pose: Pose,
}

#[cube]
pub(crate) fn no_gradient() -> GaussianGrad {
    let zero = Vec3::new(0.0, 0.0, 0.0);
    GaussianGrad {
        mean: zero,
        rotation: Quaternion { w: 0.0f32.runtime(), x: 0.0f32.runtime(), y: 0.0f32.runtime(), z: 0.0f32.runtime() },
        scale: zero,
        opacity: 0.0f32.runtime(),
        mean2d_x: 0.0f32.runtime(),
        mean2d_y: 0.0f32.runtime(),
        pose: Pose { matrix: Mat3 { x: zero, y: zero, z: zero }, translation: zero },
    }
}

/// Sets the wanted gradients of the centre, of the rotation and of the pose from those of `W R` and of the centre in the camera's frame.
#[cube]
pub(crate) fn world_backward(
    of: &mut GaussianGrad,
    seen: &SeenGrad,
    g: &Gaussian,
    p: &ProjectionTerms,
    pose: &Pose,
    #[comptime] wanted: Geometry<bool>,
) {
    let (turned, centre) = (seen.turned, seen.centre);
    if comptime!(wanted.means) {
        of.mean = pose.matrix.apply_transposed(centre);
    }
    if comptime!(wanted.rotations) {
        let unturned = pose.matrix.transposed().times(turned);
        of.rotation = p.quaternion.backward(p.quaternion_length, unturned);
    }
    if comptime!(wanted.cam_from_world) {
        let from = p.world_from_gaussian;
        of.pose.matrix.x = from.apply(turned.x).plus(g.mean.times(centre.x));
        of.pose.matrix.y = from.apply(turned.y).plus(g.mean.times(centre.y));
        of.pose.matrix.z = from.apply(turned.z).plus(g.mean.times(centre.z));
        of.pose.translation = centre;
    }
}

/// Gradients of a Gaussian from the gradient of its row; zero if it is culled. Those of the opacity and the projected centre are always
/// computed.
#[cube]
pub(crate) fn gaussian_backward(
    g: &Gaussian,
    pose: &Pose,
    camera: &ProjectCamera,
    grad: &PackedEllipse,
    #[comptime] wanted: Geometry<bool>,
) -> GaussianGrad {
    let through_rows = comptime!(wanted.means || wanted.rotations || wanted.cam_from_world);
    let mut of = no_gradient();
    let p = project_one(g, pose, camera);
    if p.visible {
        of.mean2d_x = grad.x;
        of.mean2d_y = grad.y;
        of.opacity = grad.opacity * p.compensation;
        if comptime!(through_rows || wanted.scales) {
            let (grad_m0, grad_m1) = factor_backward(&p, camera, g.opacity, grad);
            if comptime!(wanted.scales) {
                of.scale = grad_m0.by_axis(p.x.j).plus(grad_m1.by_axis(p.y.j));
            }
            if comptime!(through_rows) {
                let sizes = g.sizes(comptime!(camera.factors));
                let grad_j = (grad_m0.by_axis(sizes), grad_m1.by_axis(sizes));
                let seen = seen_backward(&p, camera, grad_j, grad);
                world_backward(&mut of, &seen, g, &p, pose, wanted);
                if comptime!(camera.factors) {
                    let c = pose.matrix.transposed().times(seen.turned);
                    of.rotation = Quaternion { w: c.x.x, x: c.y.x, y: c.y.y, z: c.z.x };
                    of.scale = Vec3::new(c.z.y, c.z.z, 0.0);
                }
            }
        }
    }
    of
}

/// Gradients that a backward kernel writes; those not asked for are absent. A kernel also takes the record of what is asked for as a
/// comptime argument, see [`given`](crate::gpu::given).
#[derive(CubeType, CubeLaunch)]
pub(crate) struct GeometryOutputs {
    means: ComptimeOption<Box<[f32]>>,
    rotations: ComptimeOption<Box<[Vector<f32, Const<4>>]>>,
    scales: ComptimeOption<Box<[f32]>>,
    opacities: ComptimeOption<Box<[f32]>>,
    mean2d: ComptimeOption<Box<[f32]>>,
    /// One row per cube.
    pose_rows: ComptimeOption<Box<[f32]>>,
}

#[cube]
impl GeometryOutputs {
    /// Writes the gradients of one Gaussian's parameters and of its projected centre.
    pub fn store(&mut self, of: &GaussianGrad, gaussian: usize) {
        #[comptime]
        if let ComptimeOption::Some(out) = &mut self.means {
            of.mean.store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut self.rotations {
            of.rotation.store(out, gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut self.scales {
            of.scale.store(out, 3 * gaussian);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut self.opacities {
            out[gaussian] = of.opacity;
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut self.mean2d {
            out[2 * gaussian] = of.mean2d_x;
            out[2 * gaussian + 1] = of.mean2d_y;
        }
    }

    /// Writes the sum of the pose's gradients over the units of a cube to the cube's row.
    pub fn store_pose(&mut self, pose: &Pose, count: u32) {
        #[comptime]
        if let ComptimeOption::Some(rows) = &mut self.pose_rows {
            let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
            // A dispatch may hold more cubes than there are rows.
            if CUBE_POS * comptime!(UNITS) < count as usize {
                let x = cube_vector_sum(pose.matrix.x, &mut shared);
                let y = cube_vector_sum(pose.matrix.y, &mut shared);
                let z = cube_vector_sum(pose.matrix.z, &mut shared);
                let translation = cube_vector_sum(pose.translation, &mut shared);
                if UNIT_POS == 0 {
                    Pose { matrix: Mat3 { x, y, z }, translation }.store(rows, CUBE_POS * comptime!(POSE));
                }
            }
        }
    }
}

#[cube(launch_unchecked)]
pub(super) fn project_backward_kernel(
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
        let grad = PackedEllipse::load(grad, gaussian);
        // Most Gaussians of a large scene are out of view and have a gradient of exactly zero.
        if any(&grad) {
            of = gaussian_backward(&inputs.gaussian(gaussian), &inputs.pose(), &camera, &grad, wanted);
        }
        outputs.store(&of, gaussian);
    }
    outputs.store_pose(&of.pose, count);
}
