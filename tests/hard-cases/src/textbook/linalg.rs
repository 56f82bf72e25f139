//! Vectors and matrices of any [`Number`].

use crate::number::Number;

pub type Vec3<N> = [N; 3];
/// Row-major.
pub type Mat3<N> = [[N; 3]; 3];

pub fn zero<N: Number>() -> Mat3<N> {
    [[N::of(0.0); 3]; 3]
}

pub fn add<N: Number>(a: Vec3<N>, b: Vec3<N>) -> Vec3<N> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub fn scale<N: Number>(a: Vec3<N>, by: N) -> Vec3<N> {
    a.map(|v| v * by)
}

pub fn dot<N: Number>(a: Vec3<N>, b: Vec3<N>) -> N {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn transpose<N: Number>(a: &Mat3<N>) -> Mat3<N> {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| a[j][i]))
}

pub fn plus<N: Number>(a: &Mat3<N>, b: &Mat3<N>) -> Mat3<N> {
    [0, 1, 2].map(|i| add(a[i], b[i]))
}

pub fn times<N: Number>(a: &Mat3<N>, b: &Mat3<N>) -> Mat3<N> {
    let columns = transpose(b);
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| dot(a[i], columns[j])))
}

pub fn apply<N: Number>(a: &Mat3<N>, v: Vec3<N>) -> Vec3<N> {
    [0, 1, 2].map(|i| dot(a[i], v))
}

/// `a bᵀ`.
pub fn outer<N: Number>(a: Vec3<N>, b: Vec3<N>) -> Mat3<N> {
    a.map(|v| scale(b, v))
}
