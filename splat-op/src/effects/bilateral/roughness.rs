//! The roughness of a grid: the mean squared difference between neighbours, over levels, rows and columns.
//!
//! With `Δ` the differences between neighbours along an axis, `N` in number, the roughness is the sum of `Σ Δ² / N` over the three axes.
//! It is tensor code.

use burn::tensor::Tensor;

use super::MAP;
use crate::check::Reference;
use crate::error::Result;

/// Returns the roughness of `grid`, `[12, L, R, C]` f32, or f64 on CPUs, as `[1]`: the mean squared difference between neighbours, over
/// levels, rows and columns. Differentiable.
///
/// # Errors
/// If the shape is not as documented, or the float type has no kernel.
pub fn roughness(grid: &Tensor<4>) -> Result<Tensor<1>> {
    Reference::new("grid", grid)?.check("grid", grid, [Some(MAP), None, None, None], "[12, L, R, C]")?;
    let zero = Tensor::zeros([1], (&grid.device(), grid.dtype()));
    Ok((1..4).filter(|&axis| grid.dims()[axis] > 1).fold(zero, |sum, axis| {
        let differences = grid.dims()[axis] - 1;
        let difference = grid.clone().narrow(axis, 1, differences) - grid.clone().narrow(axis, 0, differences);
        sum + difference.square().mean()
    }))
}
