//! Convolution of Gaussians with isotropic Gaussians of their own widths: the 3D smoothing filter of Mip-Splatting (Yu et al. 2024,
//! section 5.1).
//!
//! With standard deviations `sᵢ` along the axes, an opacity `o` and a width `g > 0`,
//!
//! ```text
//! sᵢ' = √(sᵢ² + g²)     rᵢ = sᵢ / sᵢ'     o' = o r₀ r₁ r₂
//! ∂sᵢ'/∂sᵢ = rᵢ     ∂o'/∂o = r₀ r₁ r₂     ∂o'/∂sᵢ = o (g / sᵢ')² rⱼ rₖ / sᵢ'
//! ```
//!
//! so that the integral of each Gaussian stays the same. No determinant is computed, because sixth powers of lengths are zero in f32
//! from 10⁻⁷ scene units down, and nothing is divided by a standard deviation, which may be zero. Widths are constants.

pub(crate) mod cpu;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::backend::apply;
use crate::check::Reference;
use crate::error::SplatError;
use crate::record::record;

record! {
    /// Inputs of the convolution, or their gradients.
    pub struct Smooth {
        /// `[N, 3]`: standard deviations, scene units.
        scales,
        /// `[N]`: opacities.
        opacities,
        /// `[N, 1]`: standard deviations of the filter, scene units, greater than zero. Constants.
        widths,
    }
}

/// Returns the standard deviations `[N, 3]` and opacities `[N]` of Gaussians that are convolved with isotropic Gaussians of the standard
/// deviations `widths`, `[N, 1]`, greater than zero; scene units. Differentiable in all but the widths.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn smoothed(
    scales: &Tensor<2>,
    opacities: &Tensor<1>,
    widths: &Tensor<2>,
) -> Result<(Tensor<2>, Tensor<1>), SplatError> {
    let reference = Reference::new("scales", scales)?;
    let count = scales.dims()[0];
    reference.check("scales", scales, [None, Some(3)], "[N, 3]")?;
    reference.check("opacities", opacities, [Some(count)], "[N]")?;
    reference.check("widths", widths, [Some(count), Some(1)], "[N, 1]")?;
    let inputs = Smooth { scales: scales.into(), opacities: opacities.into(), widths: widths.into() };
    let opacities = apply(operation::SmoothedOpacities, inputs.into_array()).float(0);
    Ok((apply(operation::SmoothedScales, [scales.into(), widths.into()]).float(0), opacities))
}
