//! CPU twin of the composition, parallel over runs of pixels of one length, whose sums are added in their order.

use rayon::prelude::*;

use super::Sky;
use crate::simd::real::Real;

/// Number of pixels per task.
const RUN: usize = 4096;

/// Number of pixels whose sums are kept apart, so that they are added side by side.
const LANES: usize = 16;

/// Inputs of a run of pixels, which begins with pixel `first` of `pixels`.
struct Run<'a, F> {
    inputs: Sky<&'a [F]>,
    pixels: usize,
    first: usize,
    len: usize,
}

impl<'a, F: Real> Run<'a, F> {
    /// The runs of a picture.
    fn all(inputs: Sky<&'a [F]>) -> impl IndexedParallelIterator<Item = Self> {
        let pixels = inputs.alpha.len();
        let run = move |run: usize| Self { inputs, pixels, first: run * RUN, len: RUN.min(pixels - run * RUN) };
        (0..pixels.div_ceil(RUN)).into_par_iter().map(run)
    }

    /// The run's part of a plane.
    fn of(&self, planes: &'a [F], plane: usize) -> &'a [F] {
        &planes[plane * self.pixels + self.first..][..self.len]
    }

    /// The sky in one channel.
    fn sky(&self, channel: usize, sky: &mut Vec<F>) {
        sky.clear();
        sky.resize(self.len, F::of(0.5));
        for (k, row) in self.inputs.coefficients.chunks_exact(3).enumerate() {
            let values = self.of(self.inputs.harmonics, k);
            sky.iter_mut().zip(values).for_each(|(sky, &value)| *sky += value * row[channel]);
        }
    }
}

/// `[3, H, W]`: the render over the environment.
pub(crate) fn environment_cpu<F: Real>(inputs: Sky<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    let pixels = inputs.alpha.len();
    for (channel, plane) in out.chunks_exact_mut(pixels.max(1)).enumerate() {
        plane.par_chunks_mut(RUN).zip(Run::all(inputs)).for_each_init(Vec::new, |sky, (out, run)| {
            run.sky(channel, sky);
            let (image, alpha) = (run.of(inputs.image, channel), run.of(inputs.alpha, 0));
            for (((out, &colour), &alpha), &sky) in out.iter_mut().zip(image).zip(alpha).zip(sky.iter()) {
                *out = colour + (F::ONE - alpha) * sky;
            }
        });
    }
    out
}

/// Returns the gradients of alpha and of the coefficients from `grad`, that of the composed picture, those that are needed. That of
/// the render is `grad` itself, and the harmonics have none.
pub(crate) fn environment_backward_cpu<F: Real>(inputs: Sky<&[F]>, grad: &[F], needs: Sky<bool>) -> Sky<Vec<F>> {
    let mut alpha = vec![F::ZERO; if needs.alpha { inputs.alpha.len() } else { 0 }];
    if needs.alpha {
        alpha.par_chunks_mut(RUN).zip(Run::all(inputs)).for_each_init(Vec::new, |sky, (out, run)| {
            for channel in 0..3 {
                run.sky(channel, sky);
                let grad = run.of(grad, channel);
                out.iter_mut().zip(grad).zip(sky.iter()).for_each(|((out, &grad), &sky)| *out += -grad * sky);
            }
        });
    }
    let mut coefficients = vec![F::ZERO; if needs.coefficients { inputs.coefficients.len() } else { 0 }];
    if needs.coefficients {
        let sums: Vec<Vec<F>> = Run::all(inputs).map_init(Vec::new, |seen, run| sums(&run, grad, seen)).collect();
        for sums in sums {
            coefficients.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
        }
    }
    Sky { alpha, coefficients, ..Sky::default() }
}

/// `[K, 3]`: a run's share of the coefficients' gradient.
fn sums<F: Real>(run: &Run<F>, grad: &[F], seen: &mut Vec<F>) -> Vec<F> {
    let mut out = vec![F::ZERO; run.inputs.coefficients.len()];
    for channel in 0..3 {
        seen.clear();
        let visible = run.of(grad, channel).iter().zip(run.of(run.inputs.alpha, 0));
        seen.extend(visible.map(|(&grad, &alpha)| grad * (F::ONE - alpha)));
        for (k, row) in out.chunks_exact_mut(3).enumerate() {
            let values = run.of(run.inputs.harmonics, k);
            let mut lanes = [F::ZERO; LANES];
            let (whole, rest) = values.as_chunks::<LANES>();
            let (seen, seen_rest) = seen.as_chunks::<LANES>();
            for (values, seen) in whole.iter().zip(seen) {
                for lane in 0..LANES {
                    lanes[lane] += values[lane] * seen[lane];
                }
            }
            lanes.iter_mut().zip(rest.iter().zip(seen_rest)).for_each(|(lane, (&value, &seen))| *lane += value * seen);
            row[channel] = lanes.into_iter().sum();
        }
    }
    out
}
