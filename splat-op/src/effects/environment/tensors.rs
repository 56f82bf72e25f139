//! The composition as tensor code, by its definition.

use std::f64::consts::PI;

use burn::tensor::Tensor;

use crate::product::mixed;
use crate::sh::degree_of;

/// The render over the environment, `[3, H, W]`, from planes and coefficients.
pub(super) fn over(image: Tensor<3>, alpha: Tensor<3>, directions: Tensor<3>, coefficients: Tensor<2>) -> Tensor<3> {
    let harmonics = harmonics(&directions, degree_of(coefficients.dims()[0]));
    let sky = mixed(coefficients.transpose(), harmonics) + 0.5;
    image + (alpha.neg() + 1.0) * sky
}

/// `Yₖ(d)`, `[K, H, W]`, of unit directions, `[3, H, W]`: products of `(x + iy)ᵐ` and of associated Legendre functions without their
/// power of `1 − z²`, which follow from one another (Abramowitz and Stegun 1964, section 8.5).
fn harmonics(directions: &Tensor<3>, degree: usize) -> Tensor<3> {
    let [x, y, z] = [0, 1, 2].map(|axis| directions.clone().narrow(0, axis, 1));
    let mut all = vec![z.zeros_like(); (degree + 1) * (degree + 1)];
    let (mut real, mut imaginary, mut first) = (z.ones_like(), z.zeros_like(), 1.0);
    for m in 0..=degree {
        let (mut before, mut legendre) = (z.zeros_like(), z.ones_like() * first);
        for l in m..=degree {
            // (l + m)! / (l − m)!
            let ratio: f64 = (l - m + 1..=l + m).map(|factor| factor as f64).product();
            let norm = ((2 * l + 1) as f64 / (4.0 * PI) / ratio * if m > 0 { 2.0 } else { 1.0 }).sqrt();
            all[l * l + l - m] = imaginary.clone() * legendre.clone() * norm;
            all[l * l + l + m] = real.clone() * legendre.clone() * norm;
            let next = z.clone() * legendre.clone() * (2 * l + 1) as f64 - before * (l + m) as f64;
            (before, legendre) = (legendre, next / (l + 1 - m) as f64);
        }
        let product = x.clone() * real.clone() - y.clone() * imaginary.clone();
        (real, imaginary) = (product, x.clone() * imaginary + y.clone() * real);
        first *= -((2 * m + 1) as f64);
    }
    Tensor::cat(all, 0)
}
