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
