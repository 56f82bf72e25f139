//! CPU twin of both operations.

use super::{Corrected, LEAST, POSE, Sighted};
use crate::linalg::{Mat3, add, cross, dot, matvec, scale, sub, transpose};
use crate::simd::real::Real;

/// Number of points whose sums are added before they are added to the total.
const RUN: usize = 256;

/// Rotation and translation of a pose.
fn split<F: Real>(pose: &[F]) -> (Mat3<F>, [F; 3]) {
    let row = |i: usize| [pose[4 * i], pose[4 * i + 1], pose[4 * i + 2]];
    ([row(0), row(1), row(2)], [pose[3], pose[7], pose[11]])
}

fn joined<F: Real>(rotation: Mat3<F>, translation: [F; 3]) -> Vec<F> {
    rotation.into_iter().zip(translation).flat_map(|([x, y, z], t)| [x, y, z, t]).collect()
}

/// `h`, `|h|²` and `f` of a correction.
fn half<F: Real>(correction: &[F]) -> ([F; 3], F, F) {
    let h = scale([correction[0], correction[1], correction[2]], F::of(0.5));
    let square = dot(h, h);
    (h, square, F::of(2.0) / (F::ONE + square))
}

/// `[3, 4]`: the corrected pose.
pub(crate) fn corrected_cpu<F: Real>(inputs: Corrected<&[F]>, unit: f64) -> Vec<F> {
    let (h, square, f) = half(inputs.correction);
    // f (K + h hᵀ − |h|² I) v
    let turned = |v: [F; 3]| {
        let along = sub(scale(h, dot(h, v)), scale(v, square));
        add(v, scale(add(cross(h, v), along), f))
    };
    let (rotation, translation) = split(inputs.cam_from_world);
    let moved = scale([inputs.correction[3], inputs.correction[4], inputs.correction[5]], F::of(unit));
    joined(transpose(&transpose(&rotation).map(turned)), add(turned(translation), moved))
}

/// Returns the gradient of the correction, `[2, 3]`, from `grad`, that of the corrected pose.
pub(crate) fn corrected_backward_cpu<F: Real>(inputs: Corrected<&[F]>, grad: &[F], unit: f64) -> Vec<F> {
    let (h, _, f) = half(inputs.correction);
    let ((rotation, translation), (of_rotation, of_translation)) = (split(inputs.cam_from_world), split(grad));
    let b: Mat3<F> = std::array::from_fn(|i| {
        std::array::from_fn(|k| dot(of_rotation[i], rotation[k]) + of_translation[i] * translation[k])
    });
    let axial = [b[2][1] - b[1][2], b[0][2] - b[2][0], b[1][0] - b[0][1]];
    let trace = b[0][0] + b[1][1] + b[2][2];
    let both = add(matvec(&b, h), matvec(&transpose(&b), h));
    let along = dot(axial, h) + dot(h, matvec(&b, h)) - dot(h, h) * trace;
    let slope = add(axial, sub(both, scale(h, F::of(2.0) * trace)));
    let of_half = sub(scale(slope, f), scale(h, f * f * along));
    let of_rotation = scale(of_half, F::of(0.5));
    of_rotation.into_iter().chain(scale(of_translation, F::of(unit))).collect()
}

/// Returns the miss of a pose and its derivative, `[3, 4]`.
pub(crate) fn miss_cpu<F: Real>(inputs: Sighted<&[F]>, robust: f64) -> (F, Vec<F>) {
    let (rotation, translation) = split(inputs.pose);
    let (points, directions) = (inputs.points.as_chunks::<3>().0, inputs.directions.as_chunks::<3>().0);
    let share = F::of(1.0 / points.len().max(1) as f64);
    let r = F::of(robust);
    let (mut total, mut gradient) = (F::ZERO, vec![F::ZERO; POSE]);
    for (points, directions) in points.chunks(RUN).zip(directions.chunks(RUN)) {
        let (mut sum, mut sums) = (F::ZERO, [F::ZERO; POSE]);
        for (&point, &observed) in points.iter().zip(directions) {
            let p = add(matvec(&rotation, point), translation);
            let inverse = F::ONE / dot(p, p).max_of(F::of(LEAST)).sqrt();
            let d = scale(p, inverse);
            let away = sub(d, observed);
            let rho = (dot(away, away) + r * r).sqrt();
            sum += rho - r;
            let s = scale(away, F::ONE / rho);
            let of_p = scale(sub(s, scale(d, dot(d, s))), inverse * share);
            for (row, of_p) in sums.chunks_exact_mut(4).zip(of_p) {
                row.iter_mut().zip(point).for_each(|(sum, x)| *sum += of_p * x);
                row[3] += of_p;
            }
        }
        total += sum * share;
        gradient.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    (total, gradient)
}
