//! Spherical harmonics → colour. Differentiable.
//!
//! `colour = max(0, 0.5 + Σₖ Yₖ(d) cₖ)` with `d` the unit direction from the camera's centre to the Gaussian's, `Yₖ` the
//! real spherical harmonics in the order and with the signs of the original code (Kerbl et al. 2023; the polynomials
//! are those of Sloan 2013, "Efficient Spherical Harmonic Evaluation"). The gradient flows to the coefficients and,
//! through the direction, to the centre and the pose; it is zero in a channel that the clamp holds at zero.
//!
//! Coefficients may be half-precision numbers where everything else is f32 or f64 ([`crate::Storage`]): they are read as such, and
//! all that is computed, their gradients too, is of the other type.
//!
//! Shapes: coefficients `[N, (degree+1)², 3]`, means `[N, 3]`, pose `[3, 4]` → colours `[N, 3]`.

#[cfg(feature = "cube")]
pub(crate) mod backward;
mod basis;
pub(crate) mod cpu;
#[cfg(feature = "cube")]
pub(crate) mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, ExtensionType};

#[cfg(feature = "cube")]
use crate::dials::Storage;
use crate::op::Slot;

/// The highest degree of spherical harmonics.
pub const SH_DEGREE_MAX: usize = 4;

/// Coefficients per channel at the highest degree.
pub const SH_COEFFICIENTS_MAX: usize = (SH_DEGREE_MAX + 1) * (SH_DEGREE_MAX + 1);

/// The degree that a number of coefficients per channel stands for; `None` unless it is 1, 4, 9, 16 or 25.
pub fn sh_degree(coefficients: usize) -> Option<usize> {
    (0..=SH_DEGREE_MAX).find(|degree| (degree + 1) * (degree + 1) == coefficients)
}

/// The real spherical harmonics `Yₖ(d)` of the unit direction `d`, for `k < (degree+1)²` with a degree of 0 to 4, in the order
/// of the coefficients; zero from there on.
pub fn harmonics(d: [f64; 3], degree: usize) -> [f64; SH_COEFFICIENTS_MAX] {
    basis::basis(d, degree)
}

/// [`sh_degree`] of a number of coefficients that was checked where tensors entered.
pub(crate) fn degree_of(coefficients: usize) -> usize {
    sh_degree(coefficients).expect("the number of coefficients is checked where tensors enter")
}

/// Coefficients per channel at a degree.
#[cfg(feature = "cube")]
const fn coefficients_of(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// What a kernel is compiled for.
#[cfg(feature = "cube")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Harmonics {
    /// 0 to 4.
    pub degree: usize,
    /// Of the coefficients, in memory.
    pub storage: Storage,
}

#[cfg(feature = "cube")]
impl Harmonics {
    /// Coefficients per channel.
    pub const fn coefficients(self) -> usize {
        coefficients_of(self.degree)
    }

    /// Of Gaussians with the constant alone, stored in the same way.
    pub const fn constant(self) -> Self {
        Self { degree: 0, ..self }
    }
}

/// Inputs of the stage.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ShadeInputs<B: Backend> {
    /// `[N, (degree+1)², 3]`, of half precision or of the type of the others.
    pub sh: FloatTensor<B>,
    /// `[N, 3]`, world frame.
    pub means: FloatTensor<B>,
    /// `[3, 4]`.
    pub cam_from_world: FloatTensor<B>,
}

/// Gradients of the stage's inputs, each only where it was asked for.
#[derive(Clone, Debug, ExtensionType)]
#[extension_type(fusion: cfg(feature = "fusion"))]
pub struct ShadeGrads<B: Backend> {
    /// `[N, (degree+1)², 3]`.
    #[extension_type]
    pub sh: Slot<B>,
    /// `[N, 3]`.
    #[extension_type]
    pub means: Slot<B>,
    /// `[3, 4]`, every entry taken as free.
    #[extension_type]
    pub cam_from_world: Slot<B>,
}

/// Which gradients are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShadeNeeds {
    pub sh: bool,
    pub means: bool,
    pub cam_from_world: bool,
}
