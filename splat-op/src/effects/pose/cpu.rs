//! CPU twin of the correction.

use super::Corrected;
use crate::linalg::{Matrix3, add, cross, dot, matvec, scale, sub, transpose};
use crate::simd::real::Real;

/// Rotation and translation of a pose.
fn split<F: Real>(pose: &[F]) -> (Matrix3<F>, [F; 3]) {
    let row = |i: usize| [pose[4 * i], pose[4 * i + 1], pose[4 * i + 2]];
    ([row(0), row(1), row(2)], [pose[3], pose[7], pose[11]])
}

fn joined<F: Real>(rotation: Matrix3<F>, translation: [F; 3]) -> Vec<F> {
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
    let b: Matrix3<F> = std::array::from_fn(|i| {
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
