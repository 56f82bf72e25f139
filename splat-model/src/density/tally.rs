//! Running sums of gradient norms, one per Gaussian (Kerbl et al. 2023, section 5.2).

use burn::tensor::Tensor;

/// Sums of gradient norms and numbers of steps with a gradient, `[N]` each.
#[derive(Clone, Debug)]
pub struct Tally {
    /// Sums of norms.
    pub sums: Tensor<1>,
    /// Numbers of steps with a gradient.
    pub counts: Tensor<1>,
}

/// Returns the tally after one more step, or after the first if there is none. `grad`, `[N, 2]`, is without autodiff, and is scaled by
/// `per_axis`. NaN counts as no gradient and is added to the sum.
pub fn add(tally: Option<Tally>, grad: &Tensor<2>, per_axis: [f32; 2]) -> Tally {
    // Columns instead of a sum over the axis, so that a GPU computes all in one kernel.
    let [x, y] = [0, 1].map(|axis| grad.clone().narrow(1, axis, 1).squeeze_dim::<1>(1).mul_scalar(per_axis[axis]));
    let norms = (x.square() + y.square()).sqrt();
    let shown = norms.clone().greater_elem(0.0).float();
    match tally {
        Some(Tally { sums, counts }) => Tally { sums: sums + norms, counts: counts + shown },
        None => Tally { sums: norms, counts: shown },
    }
}

#[cfg(test)]
mod tests;
