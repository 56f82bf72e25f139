//! An affine colour map of a whole picture: what the exposure and the white balance of a photograph do to a render.
//!
//! `out = A (r, g, b)ᵀ + b` for every pixel, with `M = (A | b)`, 3 × 4. Tensor code on every device.

use burn::tensor::Tensor;

use crate::backend::custom_grad::constant;
use crate::check::Reference;
use crate::error::Result;
use crate::product::mixed;

/// Maps every pixel of `image`, `[H, W, 3]` f32, or f64 on CPUs, by `map`, `[3, 4]`: a matrix and, in the last column, an offset.
/// Differentiable in both.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn apply(image: &Tensor<3>, map: &Tensor<2>) -> Result<Tensor<3>> {
    let reference = Reference::new("image", image)?;
    reference.check("image", image, [None, None, Some(3)], "[H, W, 3]")?;
    reference.check("map", map, [Some(3), Some(4)], "[3, 4]")?;
    let tracked = image.is_autodiff() || map.is_autodiff();
    // Pictures come from `rasterize` as planes, so that this moves nothing.
    let (planes, map) = (constant(image, tracked).permute([2, 0, 1]), constant(map, tracked));
    let offset = map.clone().narrow(1, 3, 1).unsqueeze_dim::<3>(2);
    Ok((mixed(map.narrow(1, 0, 3), planes) + offset).permute([1, 2, 0]))
}

#[cfg(test)]
mod tests;
