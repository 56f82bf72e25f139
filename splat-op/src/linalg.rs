//! Small vectors and matrices of numbers or SIMD lanes, for the CPU twins of `project` and `evaluate_sh`.

use std::ops::{Add, Mul, Neg, Sub};

use crate::simd::real::Real;

/// Element of a vector or matrix.
pub(crate) trait Entry:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
}

impl<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Neg<Output = T>> Entry for T {}

/// 3 × 3 matrix, row-major.
pub(crate) type Matrix3<F> = [[F; 3]; 3];

#[inline(always)]
pub(crate) fn add<F: Entry>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<F: Entry>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<F: Entry>(a: [F; 3], factor: F) -> [F; 3] {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

#[inline(always)]
pub(crate) fn hadamard<F: Entry>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub(crate) fn dot<F: Entry>(a: [F; 3], b: [F; 3]) -> F {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross<F: Entry>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Length of a vector, without intermediate overflow or underflow.
#[inline(always)]
pub(crate) fn norm<F: Real>(v: [F; 3]) -> F {
    let squared = dot(v, v);
    // Within these bounds no square has overflowed, and squares that underflowed are negligible.
    if squared > F::of(1e-20) && squared < F::of(1e30) {
        return squared.sqrt();
    }
    let largest = v[0].abs().max_of(v[1].abs()).max_of(v[2].abs());
    if !(largest > F::ZERO) {
        return largest;
    }
    let unit = [v[0] / largest, v[1] / largest, v[2] / largest];
    largest * dot(unit, unit).sqrt()
}

#[inline(always)]
pub(crate) fn matmul<F: Entry>(a: &Matrix3<F>, b: &Matrix3<F>) -> Matrix3<F> {
    [transposed_matvec(b, a[0]), transposed_matvec(b, a[1]), transposed_matvec(b, a[2])]
}

/// `a v`.
#[inline(always)]
pub(crate) fn matvec<F: Entry>(a: &Matrix3<F>, v: [F; 3]) -> [F; 3] {
    [dot(a[0], v), dot(a[1], v), dot(a[2], v)]
}

/// `aᵀ v`.
#[inline(always)]
pub(crate) fn transposed_matvec<F: Entry>(a: &Matrix3<F>, v: [F; 3]) -> [F; 3] {
    add(add(scale(a[0], v[0]), scale(a[1], v[1])), scale(a[2], v[2]))
}

#[inline(always)]
pub(crate) fn transpose<F: Entry>(a: &Matrix3<F>) -> Matrix3<F> {
    [[a[0][0], a[1][0], a[2][0]], [a[0][1], a[1][1], a[2][1]], [a[0][2], a[1][2], a[2][2]]]
}

/// Rotation matrix of a unit quaternion wxyz.
#[inline(always)]
pub(crate) fn rotation_of<L: Entry>(one: L, [w, x, y, z]: [L; 4]) -> Matrix3<L> {
    let twice = |value: L| value + value;
    [
        [one - twice(y * y + z * z), twice(x * y - w * z), twice(x * z + w * y)],
        [twice(x * y + w * z), one - twice(x * x + z * z), twice(y * z - w * x)],
        [twice(x * z - w * y), twice(y * z + w * x), one - twice(x * x + y * y)],
    ]
}
