//! Small vectors and matrices of numbers, SIMD lanes or values of a kernel, and the numbers that kernels and CPU twins share.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Not, Sub};

use crate::simd::Real;

/// Element of a vector or matrix.
pub(crate) trait Entry:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
}

impl<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T> + Neg<Output = T>> Entry for T {}

/// The number of a formula that a kernel shares with its CPU twin: a value of the kernel that is being compiled, or a vector of SIMD
/// lanes. Compilers of shaders may assume that no NaN or infinity occurs, so [`Self::finite`] decides about those, and a
/// comparison decides only where its operands are finite.
pub(crate) trait Number:
    Entry
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
{
    /// What a comparison finds.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask> + Not<Output = Self::Mask>;

    /// Whether the number is an f64.
    const DOUBLE: bool;

    /// Returns a constant of the kind of this number, rounded.
    fn constant(self, value: f64) -> Self;
    /// Returns `self · factor + addend`, rounded once or twice.
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    fn sqrt(self) -> Self;
    fn ln(self) -> Self;
    fn abs(self) -> Self;
    fn min(self, other: Self) -> Self;
    fn max(self, other: Self) -> Self;
    fn lt(self, other: Self) -> Self::Mask;
    fn le(self, other: Self) -> Self::Mask;
    fn gt(self, other: Self) -> Self::Mask;
    fn ge(self, other: Self) -> Self::Mask;
    fn eq(self, other: Self) -> Self::Mask;
    /// Whether the number is neither infinite nor NaN.
    fn finite(self) -> Self::Mask;
    /// Returns `then` where the mask is set, else `or`.
    fn select(mask: Self::Mask, then: Self, or: Self) -> Self;
    /// Whether a mask may be set anywhere: a kernel that is being compiled does not know, and says yes.
    fn any(mask: Self::Mask) -> bool;
    /// Length of a vector, without intermediate overflow or underflow.
    fn length(v: [Self; 3]) -> Self;

    /// Length of a vector in the plane.
    #[inline(always)]
    fn hypotenuse(self, other: Self) -> Self {
        Self::length([self, other, self.constant(0.0)])
    }

    /// Selects arrays by [`Self::select`].
    #[inline(always)]
    fn select_all<const C: usize>(mask: Self::Mask, then: [Self; C], or: [Self; C]) -> [Self; C] {
        let mut out = or;
        for i in 0..C {
            out[i] = Self::select(mask, then[i], or[i]);
        }
        out
    }

    /// Returns `above / below`, or `or` where the mask is not set. Nothing is divided by zero where `below` is not zero under the mask.
    #[inline(always)]
    fn ratio(mask: Self::Mask, above: Self, below: Self, or: f64) -> Self {
        let one = below.constant(1.0);
        Self::select(mask, above / Self::select(mask, below, one), below.constant(or))
    }
}

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

/// [`dot`] in the plane.
#[inline(always)]
pub(crate) fn dot2<F: Entry>(a: [F; 2], b: [F; 2]) -> F {
    a[0] * b[0] + a[1] * b[1]
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
