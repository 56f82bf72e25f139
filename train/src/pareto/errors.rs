//! Deviations of pictures and of gradients from the exact ones.

use super::subject::{GradientSums, PARAMETERS};

/// Parameters whose exact gradients are smaller than this fraction of the largest are not judged: such gradients are
/// rounding noise, for example of the rotations of spheres.
const NEGLIGIBLE: f64 = 1e-7;

/// Deviation of a setting from the exact reference.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredError {
    /// Root mean square error over all values of all views.
    pub rms: f64,
    /// Largest error of a value.
    pub max: f64,
    /// Largest relative L2 error of a parameter's gradients; `worst` names the parameter.
    pub gradient_error: f64,
    pub worst: &'static str,
    /// Smallest cosine between a parameter's gradients and the exact ones.
    pub gradient_cosine: f64,
}

/// Deviation of pictures from the exact ones.
#[derive(Clone, Copy, Debug, Default)]
pub struct PictureError {
    squares: f64,
    count: usize,
    /// Largest error of a value.
    pub max: f64,
}

impl PictureError {
    /// Compares the values of a picture with the exact ones.
    pub fn between(found: &[f64], exact: &[f64]) -> Self {
        found.iter().zip(exact).fold(Self::default(), |all, (found, exact)| {
            let difference = (found - exact).abs();
            all.and(Self { squares: difference * difference, count: 1, max: difference })
        })
    }

    /// The deviation over the pictures of both.
    pub fn and(self, other: Self) -> Self {
        Self { squares: self.squares + other.squares, count: self.count + other.count, max: self.max.max(other.max) }
    }

    /// Root mean square error over all values; NaN where a value is, or without any.
    pub fn rms(&self) -> f64 {
        (self.squares / self.count as f64).sqrt()
    }
}

pub fn within_rounding(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-5)
}

pub fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

/// Returns the largest relative L2 error of a parameter's gradients, the parameter's name, and the smallest cosine.
pub fn compare_gradients(found: &GradientSums, exact: &GradientSums) -> (f64, &'static str, f64) {
    let norm = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
    let largest = exact.iter().map(|values| norm(values)).fold(0.0, f64::max);
    let (mut error, mut worst, mut cosine) = (0.0, PARAMETERS[0], 1.0_f64);
    for ((found, exact), name) in found.iter().zip(exact).zip(PARAMETERS) {
        let (length, ours) = (norm(exact), norm(found));
        if length <= NEGLIGIBLE * largest {
            continue;
        }
        let difference: Vec<f64> = found.iter().zip(exact).map(|(found, exact)| found - exact).collect();
        let relative = norm(&difference) / length;
        if relative > error {
            (error, worst) = (relative, name);
        }
        let product: f64 = found.iter().zip(exact).map(|(found, exact)| found * exact).sum();
        cosine = cosine.min(if ours > 0.0 { product / (ours * length) } else { 0.0 });
    }
    (error, worst, cosine)
}

#[cfg(test)]
mod tests;
