//! CPU twin of the miss, parallel over runs of samples of one length, whose sums are added in their order. All samples of a pixel are in
//! one run when gradients are added to it.

use super::{COVERED, Depths};
use crate::simd::real::Real;
use crate::tasks;

/// Number of samples per task.
const RUN: usize = 1024;

/// Calls `f` with the pixel and the known depth of each sample that counts.
fn each_sample<F: Real>(alpha: &[F], pixels: &[i32], known: &[F], mut f: impl FnMut(usize, F)) {
    for (&pixel, &known) in pixels.iter().zip(known) {
        let Ok(pixel) = usize::try_from(pixel) else { continue };
        if alpha.get(pixel).is_some_and(|&alpha| alpha >= F::of(COVERED)) {
            f(pixel, known);
        }
    }
}

/// Returns the sum of `f`, of pixel and known depth, over the samples that count, and the share of each of them in a mean.
fn sum_and_share<F: Real>(inputs: &Depths<&[F]>, pixels: &[i32], f: impl Fn(usize, F) -> F + Send + Sync) -> (F, F) {
    let sums = tasks::map(pixels.chunks(RUN).zip(inputs.known.chunks(RUN)), |_, (pixels, known)| {
        let (mut sum, mut count) = (0.0_f64, 0_usize);
        each_sample(inputs.alpha, pixels, known, |pixel, known| {
            sum += f(pixel, known).f64();
            count += 1;
        });
        (sum, count)
    });
    let (sum, count) =
        sums.into_iter().fold((0.0, 0), |(sum, count), (of_run, counted)| (sum + of_run, count + counted));
    (F::of(sum), F::of(1.0 / count.max(1) as f64))
}

/// `[1]`: the miss.
pub(crate) fn depth_miss_cpu<F: Real>(inputs: Depths<&[F]>, pixels: &[i32]) -> Vec<F> {
    let error = |pixel: usize, known: F| F::abs(inputs.depth[pixel] / (inputs.alpha[pixel] * known) - F::ONE);
    let (sum, share) = sum_and_share(&inputs, pixels, error);
    vec![sum * share]
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
    let share = grad * sum_and_share(&inputs, pixels, |_, _| F::ZERO).1;
    // Runs, each with the first of its pixels and its part of both gradients.
    let (mut runs, mut start, mut first) = (Vec::new(), 0, 0);
    let (mut depths, mut alphas) = (&mut of_depth[..], &mut of_alpha[..]);
    while start < pixels.len() {
        let mut end = pixels.len().min(start + RUN);
        end += pixels[end..].iter().take_while(|&&pixel| pixel == pixels[end - 1]).count();
        // Samples of pixels beyond the picture come last.
        let next = pixels.get(end).map_or(inputs.alpha.len(), |&pixel| inputs.alpha.len().min(pixel as u32 as usize));
        let [depths, alphas] = [&mut depths, &mut alphas].map(|rest| {
            let len = rest.len().min(next - first);
            rest.split_off_mut(..len).expect("no more than there are")
        });
        runs.push((start..end, first, depths, alphas));
        (start, first) = (end, next);
    }
    tasks::for_each(runs, |_, (samples, first, of_depth, of_alpha)| {
        each_sample(inputs.alpha, &pixels[samples.clone()], &inputs.known[samples], |pixel, known| {
            let (depth, alpha) = (inputs.depth[pixel], inputs.alpha[pixel]);
            let slope = share / (alpha * known);
            let error = depth / (alpha * known) - F::ONE;
            let slope = match error {
                error if error > F::ZERO => slope,
                error if error < F::ZERO => -slope,
                _ => F::ZERO,
            };
            if needs.depth {
                of_depth[pixel - first] += slope;
            }
            if needs.alpha {
                of_alpha[pixel - first] += -(slope * (depth / alpha));
            }
        });
    });
    Depths { depth: of_depth, alpha: of_alpha, known: Vec::new() }
}
