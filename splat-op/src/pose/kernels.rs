//! Kernels: one unit for a correction; a unit per point for the miss, whose sums over a cube are added in a fixed order.

use cubecl::prelude::*;

use super::{LEAST, POSE};
use crate::gpu::UNITS;
use crate::gpu::math::{Mat3, Pose, Vec3};
use crate::gpu::reduce::cube_sum;

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

/// Writes the sums of each cube's points: shares of the miss to `misses`, `[cubes]`, and of its derivative to `sums`, `[cubes, 12]`.
#[cube(launch_unchecked)]
pub(super) fn miss_kernel(
    pose: &[f32],
    points: &[f32],
    directions: &[f32],
    misses: &mut [f32],
    sums: &mut [f32],
    robust: f32,
    share: f32,
    count: u32,
    cubes: u32,
) {
    let mut shared = Shared::<[f32]>::new_slice(comptime!(UNITS));
    if CUBE_POS < cubes as usize {
        let i = CUBE_POS * comptime!(UNITS) + UNIT_POS as usize;
        // Units beyond the last point repeat it with a weight of zero.
        let at = 3 * min(i, count as usize - 1);
        let share = select(i < count as usize, share, 0.0f32);
        let point = Vec3::load(points, at);
        let p = Pose::load(pose).apply(point);
        let inverse = 1.0 / max(p.dot(p), comptime!(LEAST as f32)).sqrt();
        let d = p.times(inverse);
        let away = d.minus(Vec3::load(directions, at));
        let rho = (away.dot(away) + robust * robust).sqrt();
        let s = away.times(1.0 / rho);
        let of_p = s.minus(d.times(d.dot(s))).times(inverse * share);
        let miss = cube_sum((rho - robust) * share, &mut shared);
        if UNIT_POS == 0 {
            misses[CUBE_POS] = miss;
        }
        #[unroll]
        for entry in 0..comptime!(POSE) {
            let mut value = of_p.z;
            if comptime!(entry / 4 == 0) {
                value = of_p.x;
            } else if comptime!(entry / 4 == 1) {
                value = of_p.y;
            }
            if comptime!(entry % 4 == 0) {
                value *= point.x;
            } else if comptime!(entry % 4 == 1) {
                value *= point.y;
            } else if comptime!(entry % 4 == 2) {
                value *= point.z;
            }
            let total = cube_sum(value, &mut shared);
            if UNIT_POS == 0 {
                sums[CUBE_POS * comptime!(POSE) + entry] = total;
            }
        }
    }
}
