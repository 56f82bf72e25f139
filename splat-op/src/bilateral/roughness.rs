//! The roughness of a grid: the mean squared difference between neighbours, over levels, rows and columns, with its derivative.
//!
//! With `Δ` the differences between neighbours along an axis, `N` in number, the roughness is the sum of `Σ Δ² / N` over the three axes.
//! Its derivative adds `2 Δ / N` to the upper neighbour of each pair and takes it from the lower.

use burn::tensor::Tensor;

use super::{MAP, operation};
use crate::abilities::is_gpu;
use crate::backend::apply;
use crate::check::Reference;
use crate::custom_grad::with_gradient;
use crate::error::SplatError;
use crate::simd::real::Real;

/// Size of a grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridSize {
    pub levels: usize,
    pub rows: usize,
    pub columns: usize,
}

impl GridSize {
    /// Takes the shape `[12, L, R, C]`.
    pub fn new(shape: &[usize]) -> Self {
        Self { levels: shape[1], rows: shape[2], columns: shape[3] }
    }

    /// For levels, rows and columns: the number of places, the distance in memory from one to the next, and the share of one squared
    /// difference in the mean, zero if there is no difference.
    pub fn axes(&self) -> [(usize, usize, f64); 3] {
        let Self { levels, rows, columns } = *self;
        let values = MAP * levels * rows * columns;
        [(levels, rows * columns), (rows, columns), (columns, 1)].map(|(count, stride)| {
            let differences = values / count.max(1) * count.saturating_sub(1);
            (count, stride, if differences > 0 { 1.0 / differences as f64 } else { 0.0 })
        })
    }
}

/// `Σ (a − b)²`, sixteen sums side by side.
fn squared_distance<F: Real>(a: &[F], b: &[F]) -> F {
    let mut sums = [F::ZERO; 16];
    for (a, b) in a.chunks(sums.len()).zip(b.chunks(sums.len())) {
        for (sum, (&a, &b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += (a - b) * (a - b);
        }
    }
    sums.into_iter().sum()
}

/// Returns the roughness of a grid and its derivative.
pub(crate) fn roughness_cpu<F: Real>(grid: &[F], size: GridSize) -> (F, Vec<F>) {
    let (mut total, mut gradient) = (F::ZERO, vec![F::ZERO; grid.len()]);
    for (count, stride, share) in size.axes() {
        let (mut sum, twice) = (F::ZERO, F::of(2.0 * share));
        let len = (count * stride).max(1);
        for (values, gradient) in grid.chunks_exact(len).zip(gradient.chunks_exact_mut(len)) {
            let pairs = || values.iter().zip(&values[stride..]).map(|(&lower, &upper)| upper - lower);
            sum += squared_distance(&values[..len - stride], &values[stride..]);
            gradient[stride..].iter_mut().zip(pairs()).for_each(|(of, difference)| *of += twice * difference);
            gradient.iter_mut().zip(pairs()).for_each(|(of, difference)| *of += -twice * difference);
        }
        total += F::of(share) * sum;
    }
    (total, gradient)
}

/// Returns the roughness of `grid`, `[12, L, R, C]` f32, or f64 on CPUs, as `[1]`: the mean squared difference between neighbours, over
/// levels, rows and columns. Differentiable.
///
/// # Errors
/// If the shape is not as documented, or the float type has no kernel.
pub fn roughness(grid: &Tensor<4>) -> Result<Tensor<1>, SplatError> {
    Reference::new(grid)?.check("grid", grid, [Some(MAP), None, None, None], "[12, L, R, C]")?;
    if is_gpu(&grid.device()) {
        return Ok(in_tensors(grid));
    }
    let tracked = grid.is_autodiff();
    let values = if tracked { grid.clone().inner() } else { grid.clone() };
    let mut found = apply(operation::Roughness(GridSize::new(&grid.dims())), [values.into()]);
    Ok(if tracked { with_gradient(grid.clone(), found.float(0), found.float(1)) } else { found.float(0) })
}

/// The roughness in tensor code, for GPUs.
pub(super) fn in_tensors(grid: &Tensor<4>) -> Tensor<1> {
    let zero = Tensor::zeros([1], &grid.device());
    (1..4).filter(|&axis| grid.dims()[axis] > 1).fold(zero, |sum, axis| {
        let differences = grid.dims()[axis] - 1;
        let difference = grid.clone().narrow(axis, 1, differences) - grid.clone().narrow(axis, 0, differences);
        sum + difference.square().mean()
    })
}
