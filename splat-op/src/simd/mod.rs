//! `f32` and `f64` with their SIMD vectors, their rows of vectors, and the transposition of tensor rows into columns of such vectors.

pub(crate) mod blocks;
pub(crate) mod lanes;
pub(crate) mod real;
