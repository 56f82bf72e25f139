//! An affine colour map of a whole picture: what the exposure and the white balance of a photograph do to a render.
//!
//! `out = A (r, g, b)ᵀ + b` for every pixel, with `M = (A | b)`, 3 × 4. Gradients, with `g = ∂out`: `∂(r, g, b) = Aᵀ g` and
//! `∂M = Σ g (r, g, b, 1)` over the pixels, in a fixed order, so that every run has the same bits.

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

use crate::backend;
use crate::bilateral::MAP;
use crate::check::Reference;
use crate::error::SplatError;
use crate::record::record;

record! {
    /// Inputs of the map, or their gradients.
    pub(crate) struct Mapped {
        /// `[3, H, W]`: the picture.
        image,
        /// `[3, 4]`: the map.
        map,
    }
}

/// Maps every pixel of `image`, `[H, W, 3]` f32, or f64 on CPUs, by `map`, `[3, 4]`: a matrix and, in the last column, an offset.
/// Differentiable in both.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn apply(image: &Tensor<3>, map: &Tensor<2>) -> Result<Tensor<3>, SplatError> {
    let reference = Reference::new("image", image)?;
    reference.check("image", image, [None, None, Some(3)], "[H, W, 3]")?;
    reference.check("map", map, [Some(3), Some(4)], "[3, 4]")?;
    // Pictures come from `rasterize` as planes, so that this moves nothing.
    let planes = image.clone().permute([2, 0, 1]);
    let inputs = Mapped { image: planes.into(), map: map.into() };
    let mapped: Tensor<3> = backend::apply(operation::ColourMap, inputs.into_array()).float(0);
    Ok(mapped.permute([1, 2, 0]))
}
