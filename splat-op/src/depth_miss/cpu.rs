//! CPU twin of the miss.

use super::{COVERED, Depths};
use crate::simd::real::Real;

/// Calls `f` with the pixel and the known depth of each sample that counts.
fn each_sample<F: Real>(inputs: &Depths<&[F]>, pixels: &[i32], mut f: impl FnMut(usize, F)) {
    for (&pixel, &known) in pixels.iter().zip(inputs.known) {
        let Ok(pixel) = usize::try_from(pixel) else { continue };
        if inputs.alpha.get(pixel).is_some_and(|&alpha| alpha >= F::of(COVERED)) {
            f(pixel, known);
        }
    }
}

/// The share of a sample in the mean.
fn share<F: Real>(inputs: &Depths<&[F]>, pixels: &[i32]) -> F {
    let mut count = 0.0_f64;
    each_sample(inputs, pixels, |_, _| count += 1.0);
    F::of(1.0 / count.max(1.0))
}

/// `[1]`: the miss.
pub(crate) fn depth_miss_cpu<F: Real>(inputs: Depths<&[F]>, pixels: &[i32]) -> Vec<F> {
    let mut sum = 0.0_f64;
    each_sample(&inputs, pixels, |pixel, known| {
        sum += (inputs.depth[pixel] / (inputs.alpha[pixel] * known) - F::ONE).abs().f64();
    });
    vec![F::of(sum) * share(&inputs, pixels)]
}

/// Returns the gradients of depth and alpha from `grad`, that of the miss, those that are needed.
pub(crate) fn depth_miss_backward_cpu<F: Real>(
    inputs: Depths<&[F]>,
    pixels: &[i32],
    grad: F,
    needs: Depths<bool>,
) -> Depths<Vec<F>> {
    let zeros = |needed: bool| vec![F::ZERO; if needed { inputs.alpha.len() } else { 0 }];
    let (mut of_depth, mut of_alpha) = (zeros(needs.depth), zeros(needs.alpha));
    let share = grad * share(&inputs, pixels);
    each_sample(&inputs, pixels, |pixel, known| {
        let (depth, alpha) = (inputs.depth[pixel], inputs.alpha[pixel]);
        let slope = share / (alpha * known);
        let error = depth / (alpha * known) - F::ONE;
        let slope = match error {
            error if error > F::ZERO => slope,
            error if error < F::ZERO => -slope,
            _ => F::ZERO,
        };
        if needs.depth {
            of_depth[pixel] += slope;
        }
        if needs.alpha {
            of_alpha[pixel] += -(slope * (depth / alpha));
        }
    });
    Depths { depth: of_depth, alpha: of_alpha, known: Vec::new() }
}
