//! Running sums of gradient norms, one per Gaussian (Kerbl et al. 2023, section 5.2).

use burn::tensor::Tensor;

/// Sums of gradient norms and numbers of steps with a gradient, `[N]` each.
#[derive(Clone, Debug)]
pub struct Tally {
    pub sums: Tensor<1>,
    pub counts: Tensor<1>,
}

/// Returns the tally after one more step, or after the first if there is none. `grad`, `[N, 2]`, is without autodiff, and is scaled by
/// `per_axis`.
pub fn add(tally: Option<Tally>, grad: Tensor<2>, per_axis: [f32; 2]) -> Tally {
    let per_axis = Tensor::<1>::from_floats(per_axis, &grad.device());
    let norms = (grad * per_axis.unsqueeze()).square().sum_dim(1).sqrt().squeeze_dim::<1>(1);
    let shown = norms.clone().sign();
    match tally {
        Some(Tally { sums, counts }) => Tally { sums: sums + norms, counts: counts + shown },
        None => Tally { sums: norms, counts: shown },
    }
}

#[cfg(test)]
mod tests;
