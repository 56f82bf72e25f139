//! Kernels of the correction: one unit works.

use cubecl::prelude::*;

use crate::gpu::math::{Mat3, Pose, Vec3};

/// `v`, rotated by the Cayley map of `h`.
#[cube]
fn turned(h: Vec3, v: Vec3) -> Vec3 {
    let square = h.dot(h);
    let change = h.cross(v).plus(h.times(h.dot(v)).minus(v.times(square)));
    v.plus(change.times(2.0 / (1.0 + square)))
}

#[cube]
fn store_row(row: Vec3, last: f32, to: &mut [f32], at: usize) {
    row.store(to, at);
    to[at + 3] = last;
}

#[cube(launch_unchecked)]
pub(super) fn corrected_kernel(correction: &[f32], cam_from_world: &[f32], out: &mut [f32], unit: f32) {
    if ABSOLUTE_POS == 0 {
        let h = Vec3::load(correction, 0).times(0.5);
        let pose = Pose::load(cam_from_world);
        let columns = pose.matrix.transposed();
        let columns = Mat3 { x: turned(h, columns.x), y: turned(h, columns.y), z: turned(h, columns.z) };
        let rows = columns.transposed();
        let translation = turned(h, pose.translation).plus(Vec3::load(correction, 3).times(unit));
        store_row(rows.x, translation.x, out, 0);
        store_row(rows.y, translation.y, out, 4);
        store_row(rows.z, translation.z, out, 8);
    }
}

/// A row of `B`, from that of the gradient.
#[cube]
fn of_turn(of_row: Vec3, of_translation: f32, pose: Pose) -> Vec3 {
    pose.matrix.apply(of_row).plus(pose.translation.times(of_translation))
}

#[cube(launch_unchecked)]
pub(super) fn corrected_backward_kernel(
    correction: &[f32],
    cam_from_world: &[f32],
    grad: &[f32],
    out: &mut [f32],
    unit: f32,
) {
    if ABSOLUTE_POS == 0 {
        let h = Vec3::load(correction, 0).times(0.5);
        let (pose, grad) = (Pose::load(cam_from_world), Pose::load(grad));
        let square = h.dot(h);
        let f = 2.0 / (1.0 + square);
        let b = Mat3 {
            x: of_turn(grad.matrix.x, grad.translation.x, pose),
            y: of_turn(grad.matrix.y, grad.translation.y, pose),
            z: of_turn(grad.matrix.z, grad.translation.z, pose),
        };
        let axial = Vec3::new(b.z.y - b.y.z, b.x.z - b.z.x, b.y.x - b.x.y);
        let trace = b.x.x + b.y.y + b.z.z;
        let turned = b.apply(h);
        let along = axial.dot(h) + h.dot(turned) - square * trace;
        let slope = axial.plus(turned.plus(b.apply_transposed(h)).minus(h.times(2.0 * trace)));
        slope.times(f).minus(h.times(f * f * along)).times(0.5).store(out, 0);
        grad.translation.times(unit).store(out, 3);
    }
}
