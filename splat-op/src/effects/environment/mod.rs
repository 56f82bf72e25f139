//! Light from infinitely far away behind the Gaussians: a sky without parallax.
//!
//! With `Yₖ(d)` the real spherical harmonics of [`mod@crate::sh`] in the viewing direction `d` of a pixel, `cₖ` coefficients, and `α` the
//! alpha of a render over black,
//!
//! `out = colour + (1 − α) sky`, `sky = ½ + Σₖ Yₖ(d) cₖ`.
//!
//! Gradients, with `g = ∂out`: `∂colour = g`, `∂α = −⟨g, sky⟩`, `∂cₖ = Σ Yₖ(d) (1 − α) g` over the pixels, in a fixed order, so that
//! every run has the same bits.
//!
//! The directions in the camera's frame serve every photograph of that camera, so the caller keeps them from step to step, and rotates
//! them. The harmonics are evaluated in both passes: reading sixteen numbers for each pixel takes longer than computing them from three.

pub(crate) mod cpu;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
mod tensors;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::backend::apply;
use crate::backend::custom_grad::constant;
use crate::check::Reference;
use crate::record::record;
use crate::sh::sh_degree;
use crate::{Result, SplatError, is_tensor_code};

record! {
    /// Inputs of the composition, or their gradients.
    pub(crate) struct Sky {
        /// `[3, H, W]`: the render over black.
        image,
        /// `[1, H, W]`: its alpha.
        alpha,
        /// `[3, H, W]`: unit viewing directions of the pixels. A constant.
        directions,
        /// `[K, 3]`: coefficients.
        coefficients,
    }
}

/// Composites a render over an environment. `image`, `[H, W, 3]` f32, or f64 on CPUs, is a render over black, `alpha`, `[H, W, 1]`, its
/// alpha, `directions`, `[3, H, W]`, the unit viewing directions of the pixels, x, y and z, and `coefficients`, `[(degree+1)², 3]`, those
/// of the harmonics in the frame of the directions, degree 0 to 4. Differentiable in all but the directions.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn over(
    image: &Tensor<3>,
    alpha: &Tensor<3>,
    directions: &Tensor<3>,
    coefficients: &Tensor<2>,
) -> Result<Tensor<3>> {
    const COEFFICIENTS: &str = "[(degree+1)², 3]";
    let reference = Reference::new("image", image)?;
    let [height, width, _] = image.dims();
    reference.check("image", image, [None, None, Some(3)], "[H, W, 3]")?;
    reference.check("alpha", alpha, [Some(height), Some(width), Some(1)], "[H, W, 1]")?;
    reference.check("directions", directions, [Some(3), Some(height), Some(width)], "[3, H, W]")?;
    reference.check("coefficients", coefficients, [None, Some(3)], COEFFICIENTS)?;
    if sh_degree(coefficients.dims()[0]).is_none() {
        let (found, hint) = (coefficients.dims().to_vec(), "give 1, 4, 9, 16 or 25 rows".into());
        return Err(SplatError::Shape { name: "coefficients", found, expected: COEFFICIENTS, hint });
    }
    // Renders come from `rasterize` as planes, so that this moves nothing.
    let planes = |picture: &Tensor<3>| picture.clone().permute([2, 0, 1]);
    let (image, alpha) = (planes(image), planes(alpha));
    if is_tensor_code() {
        let tracked = image.is_autodiff() || coefficients.is_autodiff();
        let (image, alpha) = (constant(&image, tracked), constant(&alpha, tracked));
        let (directions, coefficients) = (constant(directions, tracked), constant(coefficients, tracked));
        return Ok(tensors::over(image, alpha, directions, coefficients).permute([1, 2, 0]));
    }
    let inputs = Sky {
        image: image.into(),
        alpha: alpha.into(),
        directions: directions.into(),
        coefficients: coefficients.into(),
    };
    let composed: Tensor<3> = apply(operation::OverEnvironment, inputs.into_array()).float(0);
    Ok(composed.permute([1, 2, 0]))
}
