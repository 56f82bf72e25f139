//! Kernels of `evaluate_sh`, backward: one unit per Gaussian, and one unit for the pose. Outputs that are not asked for are not
//! arguments, and the code that only they need is not compiled into the kernel.
//!
//! A channel that is clamped to zero has no gradient. With `r` the vector from camera to centre and `d = r / |r|`,
//! `∂r = (g − d (d·g)) / |r|` for `g = Σₖ (grad·cₖ) ∇Yₖ(d)`; the centre gets `∂r` and the camera's position the negative
//! sum of all. With the position `e = −A⁻¹ t` and its gradient `g`: `∂t = −A⁻ᵀ g`, `∂A = ∂t eᵀ`.

use cubecl::prelude::*;

use super::forward::{CameraPosition, Frame, NORMS, basis, coefficient, linear_colour, load_row, may_show};
use super::{coefficients_of, vector_width};
use crate::gpu::{Mat3, Pose, UNITS, Vec3, cube_vector_sum, positive};

/// `Σₖ wₖ ∇pₖ(d)` for the polynomials `pₖ` of [`basis`], grouped by degree. Only the component normal to `d` is meaningful on the sphere.
#[cube]
fn polynomials_backward(d: Vec3, w: &Sequence<f32>, #[comptime] degree: usize) -> Vec3 {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let mut grad = Vec3::new(w[3], w[1], w[2]);
    if comptime!(degree >= 2) {
        grad = grad.plus(Vec3::new(
            w[4] * y + w[7] * z + 2.0 * x * (w[8] - w[6]),
            w[4] * x + w[5] * z - 2.0 * y * (w[8] + w[6]),
            w[5] * y + w[7] * x + 4.0 * z * w[6],
        ));
    }
    if comptime!(degree >= 3) {
        let (normal, twice_xy) = (3.0 * (xx - yy), 2.0 * x * y);
        grad = grad.plus(Vec3::new(
            3.0 * w[9] * twice_xy + w[10] * y * z - w[11] * twice_xy - 6.0 * w[12] * x * z
                + w[13] * (4.0 * zz - 3.0 * xx - yy)
                + 2.0 * w[14] * x * z
                + w[15] * normal,
            w[9] * normal + w[10] * x * z + w[11] * (4.0 * zz - xx - 3.0 * yy)
                - 6.0 * w[12] * y * z
                - w[13] * twice_xy
                - 2.0 * w[14] * y * z
                - 3.0 * w[15] * twice_xy,
            w[10] * x * y
                + 8.0 * w[11] * y * z
                + w[12] * (6.0 * zz - 3.0 * (xx + yy))
                + 8.0 * w[13] * x * z
                + w[14] * (xx - yy),
        ));
    }
    if comptime!(degree >= 4) {
        let (one, three, last) = (7.0 * zz - 1.0, 7.0 * zz - 3.0, 21.0 * zz - 3.0);
        let (in_x, in_y, xyz) = (x * (xx - 3.0 * yy), y * (3.0 * xx - yy), x * y * z);
        let normal = 3.0 * z * (xx - yy);
        grad = grad.plus(Vec3::new(
            w[16] * in_y
                + 6.0 * w[17] * xyz
                + w[18] * y * one
                + w[21] * z * three
                + 2.0 * w[22] * x * one
                + w[23] * normal
                + 4.0 * w[24] * in_x,
            w[16] * in_x + w[17] * normal + w[18] * x * one + w[19] * z * three
                - 2.0 * w[22] * y * one
                - 6.0 * w[23] * xyz
                - 4.0 * w[24] * in_y,
            w[17] * in_y
                + 14.0 * w[18] * xyz
                + w[19] * y * last
                + w[20] * z * (140.0 * zz - 60.0)
                + w[21] * x * last
                + 14.0 * w[22] * z * (xx - yy)
                + w[23] * in_x,
        ));
    }
    grad
}

/// Whether any channel has a non-zero gradient, by its bits: NaN counts.
#[cube]
fn any_colour(grad: Vec3) -> bool {
    let bits = u32::reinterpret(grad.x) | u32::reinterpret(grad.y) | u32::reinterpret(grad.z);
    (bits & 0x7fff_ffff) != 0
}

/// Stores the gradient of a Gaussian's harmonics, if it is asked for. Returns the gradient of the vector from the camera to the
/// Gaussian's centre if `through_direction` is set, and zero otherwise.
#[cube]
fn colour_backward<W: Size>(
    sh: &[Vector<f32, W>],
    gaussian: usize,
    mean: Vec3,
    pose: Pose,
    grad: Vec3,
    grad_sh: &mut ComptimeOption<Box<[Vector<f32, W>]>>,
    #[comptime] degree: usize,
    #[comptime] through_direction: bool,
) -> Vec3 {
    let coefficients = comptime!(coefficients_of(degree));
    let view_direction = CameraPosition::of(pose).view_direction(mean);
    let y = basis(view_direction.direction, degree);
    let row = load_row(sh, gaussian, degree);
    let colour = linear_colour(&row, &y, degree);
    let g = Vec3::new(
        select(positive(colour.x), grad.x, 0.0),
        select(positive(colour.y), grad.y, 0.0),
        select(positive(colour.z), grad.z, 0.0),
    );
    #[comptime]
    if let ComptimeOption::Some(out) = grad_sh {
        let mut values = Sequence::<f32>::new();
        #[unroll]
        for k in 0..coefficients {
            values.push(g.x * y[k]);
            values.push(g.y * y[k]);
            values.push(g.z * y[k]);
        }
        store_row(out, gaussian, &values, degree);
    }
    let mut of_view_direction = Vec3::new(0.0, 0.0, 0.0);
    if comptime!(through_direction) {
        let d = view_direction.direction;
        if positive(view_direction.distance) {
            let mut weights = Sequence::<f32>::new();
            #[unroll]
            for k in 0..coefficients {
                weights.push(g.dot(coefficient(&row, k)) * comptime!(NORMS[k]));
            }
            let grad = polynomials_backward(d, &weights, degree);
            of_view_direction = grad.minus(d.times(d.dot(grad))).times(1.0 / view_direction.distance);
        }
    }
    of_view_direction
}

/// Stores the gradient of a Gaussian's harmonics, `values`.
#[cube]
fn store_row<W: Size>(out: &mut [Vector<f32, W>], gaussian: usize, values: &Sequence<f32>, #[comptime] degree: usize) {
    let width = comptime!(vector_width(degree));
    let vectors = comptime!(3 * coefficients_of(degree) / width);
    #[unroll]
    for at in 0..vectors {
        let mut vector = Vector::<f32, W>::empty();
        #[unroll]
        for i in 0..width {
            vector.insert(i, values[comptime!(at * width + i)]);
        }
        out[gaussian * vectors + at] = vector;
    }
}

/// Stores a gradient of zero for a Gaussian's harmonics, if one is asked for.
#[cube]
fn no_harmonics<W: Size>(
    gaussian: usize,
    grad_sh: &mut ComptimeOption<Box<[Vector<f32, W>]>>,
    #[comptime] degree: usize,
) {
    let vectors = comptime!(3 * coefficients_of(degree) / vector_width(degree));
    #[comptime]
    if let ComptimeOption::Some(out) = grad_sh {
        #[unroll]
        for at in 0..vectors {
            out[gaussian * vectors + at] = Vector::new(0.0f32);
        }
    }
}

/// `view_direction_rows` receives, per cube, the sum of the gradients of the vectors from the camera to the centres.
#[cube(launch_unchecked)]
pub(super) fn sh_backward_kernel<W: Size>(
    sh: &[Vector<f32, W>],
    means: &[f32],
    cam_from_world: &[f32],
    ellipses: ComptimeOption<Box<[f32]>>,
    grad: &[f32],
    mut grad_sh: ComptimeOption<Box<[Vector<f32, W>]>>,
    mut grad_means: ComptimeOption<Box<[f32]>>,
    mut view_direction_rows: ComptimeOption<Box<[f32]>>,
    frame: Frame,
    count: u32,
    #[comptime] degree: usize,
    #[comptime] _given: u32,
) {
    let through_direction = comptime!(degree > 0 && (grad_means.is_some() || view_direction_rows.is_some()));
    let gaussian = ABSOLUTE_POS;
    let mut of_view_direction = Vec3::new(0.0, 0.0, 0.0);
    if gaussian < count as usize {
        let g = Vec3::load(grad, 3 * gaussian);
        // Also keeps the values of a Gaussian that is not visible, NaN included, out of every sum.
        let mut visible = any_colour(g);
        #[comptime]
        if let ComptimeOption::Some(ellipses) = ellipses {
            visible = visible && may_show(&ellipses, gaussian, &frame);
        }
        if visible {
            let (mean, pose) = (Vec3::load(means, 3 * gaussian), Pose::load(cam_from_world));
            of_view_direction = colour_backward(sh, gaussian, mean, pose, g, &mut grad_sh, degree, through_direction);
        } else {
            no_harmonics(gaussian, &mut grad_sh, degree);
        }
        #[comptime]
        if let ComptimeOption::Some(out) = &mut grad_means {
            of_view_direction.store(out, 3 * gaussian);
        }
    }
    #[comptime]
    if let ComptimeOption::Some(rows) = &mut view_direction_rows {
        let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
        // A dispatch may hold more cubes than there are rows.
        if CUBE_POS * comptime!(UNITS) < count as usize {
            let sum = cube_vector_sum(of_view_direction, &mut shared);
            if UNIT_POS == 0 {
                sum.store(rows, 3 * CUBE_POS);
            }
        }
    }
}

/// Gradient of the pose from the sum of the gradients of the vectors from the camera to the centres, by one unit.
#[cube(launch_unchecked)]
pub(super) fn pose_backward_kernel(grad_sights: &[f32], cam_from_world: &[f32], grad_pose: &mut [f32]) {
    if ABSOLUTE_POS == 0 {
        let eye = CameraPosition::of(Pose::load(cam_from_world));
        // The gradient of the position is the negative sum of those of the view directions.
        let grad_t = eye.world_from_cam.apply_transposed(Vec3::load(grad_sights, 0));
        let matrix =
            Mat3 { x: eye.position.times(grad_t.x), y: eye.position.times(grad_t.y), z: eye.position.times(grad_t.z) };
        Pose { matrix, translation: grad_t }.store(grad_pose, 0);
    }
}
