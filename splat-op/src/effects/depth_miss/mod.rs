//! How far the depth of a render is from known depths.
//!
//! A render accumulates `D = Σ wᵢ zᵢ` and `α = Σ wᵢ`, so its depth in a pixel is `D/α`. The miss is the mean of `|e|`,
//! `e = D/(α z) − 1`, over the samples of known depth `z` in pixels with `α ≥ ½`, or zero if there are none. With `n` their number,
//!
//! ```text
//! ∂D = Σ sign(e) / (n α z)     ∂α = −Σ sign(e) D / (n α² z)
//! ```
//!
//! over the samples of a pixel, with `sign(0) = 0`. Which pixels count is piecewise constant. It is tensor code.

#[cfg(test)]
mod tests;

use burn::tensor::{DType, Int, Tensor};

use crate::backend::custom_grad::{constant, plain};
use crate::check::Reference;
use crate::{Result, SplatError, is_gpu};

/// The least alpha of a pixel whose depth counts.
pub const COVERED: f64 = 0.5;

/// Returns the mean relative error of a render's depth as `[1]`. `depth` and `alpha`, `[H, W, 1]` f32, or f64 on CPUs, are those of a
/// [`Rendered`](crate::Rendered); `known`, `[M]`, are known depths, camera z, scene units, more than zero; `pixels`, `[M]` i32, or i64 on CPUs, are their
/// pixels, row-major, in ascending order. Samples of pixels beyond the picture are left out. Differentiable in depth and alpha.
///
/// # Errors
/// If a shape is not as documented, or if types or devices differ.
pub fn depth_miss(
    depth: &Tensor<3>,
    alpha: &Tensor<3>,
    known: &Tensor<1>,
    pixels: &Tensor<1, Int>,
) -> Result<Tensor<1>> {
    let reference = Reference::new("depth", depth)?;
    let ([height, width, _], count) = (depth.dims(), known.dims()[0]);
    reference.check("depth", depth, [None, None, Some(1)], "[H, W, 1]")?;
    reference.check("alpha", alpha, [Some(height), Some(width), Some(1)], "[H, W, 1]")?;
    reference.check("known", known, [None], "[M]")?;
    if pixels.dims() != [count] {
        let hint = "as many as known depths".into();
        return Err(SplatError::Shape { name: "pixels", found: pixels.dims().to_vec(), expected: "[M]", hint });
    }
    if !(pixels.dtype() == DType::I32 || pixels.dtype() == DType::I64 && !is_gpu(&pixels.device())) {
        let found = format!("{:?}", pixels.dtype());
        return Err(SplatError::DType { name: "pixels", found, expected: "I32, or I64 on a CPU".into() });
    }
    reference.check_device("pixels", &pixels.device())?;
    let (plane, tracked) = (height * width, depth.is_autodiff());
    if plane == 0 || known.dims() == [0] {
        return Ok(Tensor::zeros([1], (&depth.device(), depth.dtype())));
    }
    let at = |picture: Tensor<3>, pixels: Tensor<1, Int>| picture.reshape([plane]).select(0, pixels);
    let inside = pixels.clone().clamp(0, plane as i64 - 1);
    let exists = inside.clone().equal(pixels.clone());
    let counts =
        at(plain(alpha), inside.clone()).greater_equal_elem(COVERED).bool_and(exists).float().cast(depth.dtype());
    let share = counts.clone() / counts.sum().clamp_min(1.0);
    let inside = constant(&inside, tracked);
    let divisor = at(alpha.clone(), inside.clone()).clamp_min(COVERED) * constant(known, tracked);
    Ok(((at(depth.clone(), inside) / divisor - 1.0).abs() * constant(&share, tracked)).sum())
}
