//! Opacity and size of Gaussians that replace one at its position (Kheradmand et al. 2024, section 4.4).

/// Upper bound of opacities: a fully opaque Gaussian cannot be shared.
const OPACITY_MAX: f64 = 1.0 - 1e-6;

/// The opacity of each of `count` Gaussians at one position that together have the given `opacity`, and the factor of their
/// standard deviations.
///
/// `1 − (1 − o')ᴺ = o` determines `o'`. With `g` the profile of a new Gaussian along a line through the centre, N of them
/// have the opacity `1 − (1 − o' g)ᴺ = Σₖ C(N, k) (−1)^(k−1) o'ᵏ gᵏ`, k from 1 to N, and `∫ gᵏ = σ' √(2π/k)`. The integral
/// of the old Gaussian is `o σ √(2π)`, so that `σ' / σ = o / Σₖ C(N, k) (−1)^(k−1) o'ᵏ / √k`. This is the paper's equation
/// 9, whose double sum over binomial coefficients is summed over its outer index.
///
/// Each term is the previous one times `−o' (N − k) / (k + 1)`, so that no term exceeds `e^(N o')` for any N: nothing
/// overflows, and cancellation leaves most digits of an f64.
pub(super) fn share(opacity: f64, count: usize) -> (f64, f64) {
    if count <= 1 || !(opacity > 0.0) {
        return (opacity, 1.0);
    }
    let opacity = opacity.min(OPACITY_MAX);
    let n = count as f64;
    let each = -((-opacity).ln_1p() / n).exp_m1();
    let mut term = n * each;
    let mut sum = term;
    for k in 1..count {
        let k = k as f64;
        term *= -each * (n - k) / (k + 1.0);
        sum += term / (k + 1.0).sqrt();
        if term == 0.0 {
            break;
        }
    }
    (each, opacity / sum)
}

#[cfg(test)]
mod tests;
