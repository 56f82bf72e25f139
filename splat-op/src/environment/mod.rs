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
//! The values of the harmonics belong to a camera, so the caller keeps them from step to step. With directions in the camera's frame
//! and coefficients rotated into it, they serve every photograph of that camera.

pub(crate) mod cpu;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
#[cfg(test)]
mod tests;

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use crate::backend::environment::EnvironmentBackend;
use crate::check::Reference;
use crate::error::SplatError;
use crate::record::record;

record! {
    /// Inputs of the composition, or their gradients.
    pub struct Sky {
        /// `[3, H, W]`: the render over black.
        image,
        /// `[1, H, W]`: its alpha.
        alpha,
        /// `[K, H, W]`: values of the harmonics. A constant.
        harmonics,
        /// `[K, 3]`: coefficients.
        coefficients,
    }
}

/// Composites a render over an environment. `image`, `[H, W, 3]` f32, or f64 on CPUs, is a render over black, `alpha`, `[H, W, 1]`,
/// its alpha, `harmonics`, `[K, H, W]`, the values of `K` harmonics in the viewing directions of the pixels, and `coefficients` is
/// `[K, 3]`. Differentiable in all but the harmonics.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn over(
    image: &Tensor<3>,
    alpha: &Tensor<3>,
    harmonics: &Tensor<3>,
    coefficients: &Tensor<2>,
) -> Result<Tensor<3>, SplatError> {
    let reference = Reference::new(image)?;
    let [height, width, _] = image.dims();
    let count = harmonics.dims()[0];
    reference.check("image", image, [None, None, Some(3)], "[H, W, 3]")?;
    reference.check("alpha", alpha, [Some(height), Some(width), Some(1)], "[H, W, 1]")?;
    reference.check("harmonics", harmonics, [None, Some(height), Some(width)], "[K, H, W]")?;
    reference.check("coefficients", coefficients, [Some(count), Some(3)], "[K, 3]")?;
    // Renders come from `rasterize` as planes, so that this moves nothing.
    let planes = |picture: &Tensor<3>| picture.clone().permute([2, 0, 1]).into();
    let inputs = Sky {
        image: planes(image),
        alpha: planes(alpha),
        harmonics: harmonics.clone().into(),
        coefficients: coefficients.clone().into(),
    };
    let composed = Tensor::<3>::from_dispatch(<Dispatch as EnvironmentBackend>::environment(inputs));
    Ok(composed.permute([1, 2, 0]))
}
