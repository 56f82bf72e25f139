//! `f32` and `f64` with their SIMD vectors, and rows of tensors as columns of such vectors.

pub(crate) mod lanes;
pub(crate) mod real;
