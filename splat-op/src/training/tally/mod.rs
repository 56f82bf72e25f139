//! Running sums of gradient norms, one per Gaussian. Density control reads them now and then (Kerbl et al. 2023, section 5.2).
//! They are tensor code, which takes seven passes over memory; a GPU takes one.
//!
//! With `g` the gradient at a projected centre and `s` the units per axis, one step is
//!
//! `sum ← sum + |g s|`, `count ← count + 1` where `|g s| > 0`. NaN counts as no gradient and is added to the sum.
//!
//! Shapes: gradients `[N, 2]`, sums and counts `[N]`; f32.

#[cfg(feature = "cube")]
mod forward;
#[cfg(all(test, feature = "cube"))]
mod kernel_tests;
#[cfg(feature = "cube")]
pub(crate) mod launch;
mod operation;

use burn::tensor::{DType, Tensor};

use crate::abilities::is_gpu;
use crate::backend::apply;

/// Sums of gradient norms and numbers of steps with a gradient, `[N]` each.
#[derive(Clone, Debug)]
pub struct Tally {
    /// Sums of norms.
    pub sums: Tensor<1>,
    /// Numbers of steps with a gradient.
    pub counts: Tensor<1>,
}

/// Returns the tally after one more step, or after the first if there is none. `grad`, `[N, 2]`, is without autodiff, and is scaled by
/// `per_axis`. Memory of the tally that nothing else holds is reused.
pub fn add(tally: Option<Tally>, grad: Tensor<2>, per_axis: [f32; 2]) -> Tally {
    if is_gpu(&grad.device()) && grad.dtype() == DType::F32 {
        let (sums, counts) = tally.map(|tally| (tally.sums, tally.counts)).unzip();
        let mut found = apply(operation::AddToTally { per_axis }, [grad.into(), sums.into(), counts.into()]);
        return Tally { sums: found.float(0), counts: found.float(1) };
    }
    let per_axis = Tensor::<1>::from_floats(per_axis, &grad.device());
    let norms = (grad * per_axis.unsqueeze()).square().sum_dim(1).squeeze_dim::<1>(1).sqrt();
    let shown = norms.clone().greater_elem(0.0).float();
    match tally {
        Some(Tally { sums, counts }) => Tally { sums: sums + norms, counts: counts + shown },
        None => Tally { sums: norms, counts: shown },
    }
}
