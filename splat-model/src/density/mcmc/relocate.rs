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
mod tests {
    use super::*;
    use crate::gaussians::testing::devices;
    use crate::gaussians::values_of;

    /// Both results on each device, for each opacity and count.
    fn shared(all: &[(f64, usize)]) -> Vec<Vec<(f64, f64)>> {
        let on = |device| {
            let tensor = |of: &dyn Fn(&(f64, usize)) -> f32| {
                Tensor::<1>::from_floats(all.iter().map(of).collect::<Vec<_>>().as_slice(), &device)
            };
            let (each, factor) = share(tensor(&|of| of.0 as f32), tensor(&|of| of.1 as f32));
            values_of(each).into_iter().zip(values_of(factor)).map(|(a, b)| (a.into(), b.into())).collect()
        };
        devices().map(on).to_vec()
    }

    /// The opacity of `count` Gaussians at one position, integrated along a line through it by the trapezoidal rule, which
    /// converges faster than any power here.
    fn stopped(opacity: f64, sigma: f64, count: usize) -> f64 {
        let step = sigma / 50.0;
        let at =
            |i: i32| 1.0 - (1.0 - opacity * (-0.5 * (f64::from(i) * step / sigma).powi(2)).exp()).powi(count as i32);
        (-500..=500).map(at).sum::<f64>() * step
    }

    #[test]
    fn several_stop_what_one_did() {
        let counts = [1, 2, 3, 7, 51, 400];
        let cases: Vec<(f64, usize)> =
            [1e-4, 0.005, 0.1, 0.5, 0.9, 0.99, 0.999].iter().flat_map(|o| counts.map(|n| (*o, n))).collect();
        for found in shared(&cases) {
            for (&(opacity, count), (each, factor)) in cases.iter().zip(found) {
                let together = 1.0 - (1.0 - each).powi(count as i32);
                assert!((together / opacity - 1.0).abs() < 1e-4, "{opacity}, {count}: {together}");
                let (before, after) = (stopped(opacity, 1.0, 1), stopped(each, factor, count));
                assert!((after / before - 1.0).abs() < 1e-4, "{opacity}, {count}: {after} instead of {before}");
            }
        }
    }

    /// The double sum of the paper's equation 9.
    #[test]
    fn it_is_the_papers_double_sum() {
        let binomial = |n: usize, k: usize| (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product::<f64>();
        let cases = [(0.3, 2), (0.8, 5), (0.95, 9)];
        for found in shared(&cases) {
            for ((opacity, count), (each, factor)) in cases.into_iter().zip(found) {
                let inner = |i: usize| {
                    (0..i).map(move |k| {
                        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
                        binomial(i - 1, k) * sign * each.powi(k as i32 + 1) / ((k + 1) as f64).sqrt()
                    })
                };
                let sum: f64 = (1..=count).flat_map(inner).sum();
                let of_covariance = opacity * opacity / (sum * sum);
                assert!((factor * factor / of_covariance - 1.0).abs() < 1e-4, "{opacity}, {count}");
            }
        }
    }

    #[test]
    fn what_cannot_be_shared_stays_finite() {
        let cases: Vec<(f64, usize)> =
            [0.0, 1.0, f64::from(f32::MIN_POSITIVE)].iter().flat_map(|o| [2, 100_000].map(|n| (*o, n))).collect();
        for found in shared(&cases) {
            for ((opacity, count), (each, factor)) in cases.iter().zip(found) {
                assert!((0.0..1.0).contains(&each), "{opacity}, {count}: {each}");
                assert!(*opacity < 1e-30 || (0.05..2.0).contains(&factor), "{opacity}, {count}: {factor}");
            }
        }
    }
}
