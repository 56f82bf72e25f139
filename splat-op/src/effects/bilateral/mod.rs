//! Slicing of a bilateral grid of colour maps (Chen, Paris and Durand 2007; Wang et al. 2024, "Bilateral Guided Radiance Field
//! Processing", section 4): each pixel has the map at its place in the picture and at its brightness.
//!
//! The grid holds a map `M`, 3 × 4, at each of `L` levels, `R` rows and `C` columns. A pixel with its centre at `(x, y)` px in a
//! picture of `W` × `H` px and with the luma `ℓ` (Rec. 601, limited to 0 to 1) lies at
//! `((L − 1) ℓ, (R − 1) y / H, (C − 1) x / W`) in the grid. Trilinear interpolation gives its map, and `out = M (r, g, b, 1)ᵀ`.
//!
//! With `g = ∂out`: `∂M = g (r, g, b, 1)`, which the eight corners share by their weights, and
//! `∂(r, g, b) = Mᵀ g + (L − 1) ⟨∂M, M₁ − M₀⟩ luma weights`, with `M₁` and `M₀` the maps on the levels above and below the pixel.
//! The second term is zero where the luma is limited.
//!
//! As tensor code the interpolation takes 96 numbers per pixel. This operation keeps none. The gradient of the grid is summed
//! in a fixed order, so it has the same bits in every run.

pub(crate) mod cpu;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
mod kernels;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;
pub(crate) mod roughness;
mod tensors;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

pub use self::roughness::roughness;
use crate::backend::apply;
use crate::backend::custom_grad::constant;
use crate::check::Reference;
use crate::record::record;
use crate::{Result, SplatError, is_tensor_code};

/// Entries of a colour map: three rows of four.
pub const MAP: usize = 12;

/// Weights of red, green and blue in the luma (Rec. 601).
pub const LUMA: [f64; 3] = [0.299, 0.587, 0.114];

record! {
    /// Inputs of the slice, or their gradients.
    pub(crate) struct Sliced {
        /// `[3, H, W]`: the picture.
        image,
        /// `[12, L, R, C]`: the grid.
        grid,
    }
}

/// Sizes of picture and grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SliceSize {
    pub width: usize,
    pub height: usize,
    pub levels: usize,
    pub rows: usize,
    pub columns: usize,
}

impl SliceSize {
    /// Takes the shapes of picture and grid.
    pub fn new(image: &[usize], grid: &[usize]) -> Self {
        Self { height: image[1], width: image[2], levels: grid[1], rows: grid[2], columns: grid[3] }
    }
}

/// Maps each pixel of `image`, `[H, W, 3]` f32, or f64 on CPUs, by `grid`, `[12, L, R, C]`: a colour map, row by row, at each of `L`
/// levels from dark to bright, `R` rows and `C` columns, each at least 2. The ends of the grid are at the ends of the picture.
/// Differentiable in both.
///
/// # Errors
/// If a shape is not as documented, or if float types or devices differ.
pub fn slice(image: &Tensor<3>, grid: &Tensor<4>) -> Result<Tensor<3>> {
    let reference = Reference::new("image", image)?;
    reference.check("image", image, [None, None, Some(3)], "[H, W, 3]")?;
    reference.check("grid", grid, [Some(MAP), None, None, None], "[12, L, R, C]")?;
    let [_, levels, rows, columns] = grid.dims();
    if levels.min(rows).min(columns) < 2 {
        let hint = "interpolation takes at least two levels, rows and columns".into();
        return Err(SplatError::Shape { name: "grid", found: grid.dims().to_vec(), expected: "[12, L, R, C]", hint });
    }
    // Pictures come from `rasterize` as planes, so that this moves nothing.
    let planes = image.clone().permute([2, 0, 1]);
    if is_tensor_code() {
        let tracked = planes.is_autodiff() || grid.is_autodiff();
        return Ok(tensors::slice(constant(&planes, tracked), constant(grid, tracked)).permute([1, 2, 0]));
    }
    let size = SliceSize::new(&planes.dims(), &grid.dims());
    let inputs = Sliced { image: planes.into(), grid: grid.into() };
    let mapped: Tensor<3> = apply(operation::Slice(size), inputs.into_array()).float(0);
    Ok(mapped.permute([1, 2, 0]))
}
