//! Small vectors, matrices and quaternions for the CPU twins of `project` and `shade`.

use crate::real::Real;

/// Row-major.
pub(crate) type Mat3<F> = [[F; 3]; 3];

#[inline(always)]
pub(crate) fn add<F: Real>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<F: Real>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<F: Real>(a: [F; 3], factor: F) -> [F; 3] {
    [a[0] * factor, a[1] * factor, a[2] * factor]
}

#[inline(always)]
pub(crate) fn hadamard<F: Real>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub(crate) fn dot<F: Real>(a: [F; 3], b: [F; 3]) -> F {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn cross<F: Real>(a: [F; 3], b: [F; 3]) -> [F; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Length of a vector, without overflow or underflow on the way.
#[inline(always)]
pub(crate) fn norm<F: Real>(v: [F; 3]) -> F {
    let squared = dot(v, v);
    // Within these bounds no square has overflowed, and any that underflowed is too small to count.
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
pub(crate) fn matmul<F: Real>(a: &Mat3<F>, b: &Mat3<F>) -> Mat3<F> {
    let row = |r: [F; 3]| add(add(scale(b[0], r[0]), scale(b[1], r[1])), scale(b[2], r[2]));
    [row(a[0]), row(a[1]), row(a[2])]
}

/// `a v`.
#[inline(always)]
pub(crate) fn matvec<F: Real>(a: &Mat3<F>, v: [F; 3]) -> [F; 3] {
    [dot(a[0], v), dot(a[1], v), dot(a[2], v)]
}

/// `aᵀ v`.
#[inline(always)]
pub(crate) fn transposed_matvec<F: Real>(a: &Mat3<F>, v: [F; 3]) -> [F; 3] {
    add(add(scale(a[0], v[0]), scale(a[1], v[1])), scale(a[2], v[2]))
}

#[inline(always)]
pub(crate) fn transpose<F: Real>(a: &Mat3<F>) -> Mat3<F> {
    [[a[0][0], a[1][0], a[2][0]], [a[0][1], a[1][1], a[2][1]], [a[0][2], a[1][2], a[2][2]]]
}

/// The quaternion of length one and the length of the one given; `None` for length zero. Scaled first, so that no length
/// that the float type can hold overflows or vanishes.
#[inline(always)]
pub(crate) fn unit_quaternion<F: Real>(q: [F; 4]) -> Option<([F; 4], F)> {
    let largest = q.iter().fold(F::ZERO, |m, c| m.max_of(c.abs()));
    if !(largest > F::ZERO) {
        return None;
    }
    let s = q.map(|c| c / largest);
    let length = (s[0] * s[0] + s[1] * s[1] + s[2] * s[2] + s[3] * s[3]).sqrt();
    Some((s.map(|c| c / length), length * largest))
}

/// The rotation matrix of a unit quaternion wxyz.
#[inline(always)]
pub(crate) fn rotation_of<F: Real>([w, x, y, z]: [F; 4]) -> Mat3<F> {
    let two = F::of(2.0);
    [
        [F::ONE - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), F::ONE - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), F::ONE - two * (x * x + y * y)],
    ]
}

/// Gradient of a quaternion of any length from that of its rotation matrix: through [`rotation_of`], then through the
/// normalisation `q / |q|`, which leaves only what is normal to the unit quaternion. Where the length is so short that the
/// gradient is beyond the float's range, it is held at its end.
#[inline(always)]
pub(crate) fn quaternion_backward<F: Real>(unit: [F; 4], length: F, g: &Mat3<F>) -> [F; 4] {
    let [w, x, y, z] = unit;
    let two = F::of(2.0);
    // The antisymmetric part of `g`, and its symmetric sums.
    let (ax, ay, az) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (sx, sy, sz) = (g[2][1] + g[1][2], g[0][2] + g[2][0], g[1][0] + g[0][1]);
    let grad_unit = [
        two * (x * ax + y * ay + z * az),
        two * (w * ax + y * sz + z * sy - two * x * (g[1][1] + g[2][2])),
        two * (w * ay + x * sz + z * sx - two * y * (g[0][0] + g[2][2])),
        two * (w * az + x * sy + y * sx - two * z * (g[0][0] + g[1][1])),
    ];
    let radial = grad_unit[0] * w + grad_unit[1] * x + grad_unit[2] * y + grad_unit[3] * z;
    [0, 1, 2, 3].map(|i| ((grad_unit[i] - unit[i] * radial) / length).within(-F::MAX, F::MAX))
}
