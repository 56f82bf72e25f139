//! Opacity and size of Gaussians that replace one at its position (Kheradmand et al. 2024, section 4.4).

use std::f64::consts::PI;

use burn::tensor::Tensor;

/// Upper bound of opacities: a fully opaque Gaussian cannot be shared.
const OPACITY_MAX: f64 = 1.0 - 1e-6;

/// Places at which a profile is summed, half a standard deviation apart. The sum of a function that is so smooth is its integral to 1e-8.
const PLACES: usize = 16;
const SPACING: f64 = 0.5;

/// The opacity of each of `counts` Gaussians, `[N]`, at one position that together have the given `opacities`, `[N]`, and the factor
/// of their standard deviations.
///
/// `1 − (1 − o')ᴺ = o` determines `o'`. With `g` the profile of a new Gaussian along a line through the centre, N of them
/// have the opacity `1 − (1 − o' g)ᴺ`. The integral of the old Gaussian is `o σ √(2π)`, so that
/// `σ' / σ = o √(2π) / ∫ 1 − (1 − o' exp(−x²/2))ᴺ dx`. This is the paper's equation 9, whose sum over binomial coefficients is this
/// integral and loses its digits where N or `o` is large. Here every term is positive.
pub(super) fn share(opacities: Tensor<1>, counts: Tensor<1>) -> (Tensor<1>, Tensor<1>) {
    let [rows] = opacities.dims();
    let opacities = opacities.clamp(0.0, OPACITY_MAX);
    // 1 − (1 − a)ᴺ = 1 − exp(−N · −ln(1 − a)).
    let each = one_minus_exp_minus(minus_ln_one_minus(opacities.clone()) / counts.clone());
    let profile: Vec<f32> = (0..PLACES).map(|i| (-0.5 * (SPACING * i as f64).powi(2)).exp() as f32).collect();
    let profile = Tensor::<1>::from_floats(profile.as_slice(), &opacities.device()).cast(opacities.dtype());
    let alphas = each.clone().reshape([rows, 1]) * profile.reshape([1, PLACES]);
    let together = one_minus_exp_minus(minus_ln_one_minus(alphas) * counts.reshape([rows, 1]));
    // Both sides of the centre.
    let sum = together.clone().sum_dim(1) * 2.0 - together.narrow(1, 0, 1);
    let factor = opacities.clone() * ((2.0 * PI).sqrt() / SPACING) / sum.reshape([rows]).clamp_min(f32::MIN_POSITIVE);
    (each, factor)
}

/// `−ln(1 − x)`, with the digits of small `x`.
fn minus_ln_one_minus<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let series = x.clone() * (x.clone() * (x.clone() * (x.clone() * 0.25 + 1.0 / 3.0) + 0.5) + 1.0);
    let small = x.clone().lower_elem(0.02);
    (x.neg() + 1.0).log().neg().mask_where(small, series)
}

/// `1 − exp(−x)`, with the digits of small `x`.
fn one_minus_exp_minus<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    let series = x.clone() * (x.clone() * (x.clone() * (x.clone() * (-1.0 / 24.0) + 1.0 / 6.0) - 0.5) + 1.0);
    let small = x.clone().lower_elem(0.02);
    (x.neg().exp().neg() + 1.0).mask_where(small, series)
}

#[cfg(test)]
mod tests;
