//! Convolution of Gaussians with isotropic Gaussians of their own widths: the 3D smoothing filter of Mip-Splatting (Yu et al. 2024,
//! section 5.1). Tensor code on every device.
//!
//! With standard deviations `sᵢ` along the axes, an opacity `o` and a width `g > 0`,
//!
//! ```text
//! sᵢ' = √(sᵢ² + g²)     rᵢ = sᵢ / sᵢ'     o' = o r₀ r₁ r₂
//! ∂sᵢ'/∂sᵢ = rᵢ     ∂o'/∂o = r₀ r₁ r₂     ∂o'/∂sᵢ = o (g / sᵢ')² rⱼ rₖ / sᵢ'
//! ```
//!
//! so that the integral of each Gaussian stays the same. No determinant is computed, because sixth powers of lengths are zero in f32
//! from 10⁻⁷ scene units down, and nothing is divided by a standard deviation, which may be zero. The last derivative is not left to
//! autodiff, which would subtract almost equal numbers where `sᵢ` is much larger than `g`. Widths are constants.

use burn::tensor::Tensor;

use crate::backend::custom_grad::{constant, plain};
use crate::check::Reference;
use crate::error::Result;

/// Returns the standard deviations `[N, 3]` and opacities `[N]` of Gaussians that are convolved with isotropic Gaussians of the standard
/// deviations `widths`, `[N, 1]`, greater than zero; scene units. Differentiable in all but the widths.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn smoothed(scales: &Tensor<2>, opacities: &Tensor<1>, widths: &Tensor<2>) -> Result<(Tensor<2>, Tensor<1>)> {
    let reference = Reference::new("scales", scales)?;
    let count = scales.dims()[0];
    reference.check("scales", scales, [None, Some(3)], "[N, 3]")?;
    reference.check("opacities", opacities, [Some(count)], "[N]")?;
    reference.check("widths", widths, [Some(count), Some(1)], "[N, 1]")?;
    if count == 0 {
        return Ok((scales.clone(), opacities.clone()));
    }
    let (s, o, g) = (plain(scales), plain(opacities), plain(widths).expand([count, 3]));
    // Relative to the larger of the two, whose square may be beyond the range of f32.
    let larger = s.clone().max_pair(g.clone());
    let relative = (s.clone() / larger.clone()).square() + (g.clone() / larger.clone()).square();
    let wide = larger * relative.sqrt();
    let share = s.clone() / wide.clone();
    let [x, y, z] = [0, 1, 2].map(|axis| share.clone().narrow(1, axis, 1));
    let product: Tensor<1> = (x.clone() * y.clone() * z.clone()).squeeze_dim(1);
    let fainter = o.clone() * product.clone();
    if !(scales.is_autodiff() || opacities.is_autodiff()) {
        return Ok((wide, fainter));
    }
    let others = Tensor::cat(vec![y.clone() * z.clone(), x.clone() * z, x * y], 1);
    let slope = o.clone().unsqueeze_dim(1) * (g / wide.clone()).square() * others / wide.clone();
    // A variable less its value is zero, and brings the derivative.
    let tracked = |values| constant(&values, true);
    let step = constant(scales, true) - Tensor::from_inner(s);
    let of_opacities = (constant(opacities, true) - Tensor::from_inner(o)) * Tensor::from_inner(product);
    let of_scales: Tensor<1> = (step.clone() * tracked(slope)).sum_dim(1).squeeze_dim(1);
    Ok((tracked(wide) + step * tracked(share), Tensor::from_inner(fainter) + of_opacities + of_scales))
}

#[cfg(test)]
mod tests;
