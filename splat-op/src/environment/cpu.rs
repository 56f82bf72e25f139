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

    /// The sky, a row of the run's length for each channel.
    fn sky(&self, sky: &mut Vec<F>) {
        sky.clear();
        sky.resize(3 * self.len, F::of(0.5));
        for (k, row) in self.inputs.coefficients.chunks_exact(3).enumerate() {
            let values = self.of(self.inputs.harmonics, k);
            for (sky, &coefficient) in sky.chunks_exact_mut(self.len).zip(row) {
                sky.iter_mut().zip(values).for_each(|(sky, &value)| *sky += value * coefficient);
            }
        }
    }

    /// `[K, 3]`: the run's share of the coefficients' gradient.
    fn sums(&self, grad: &[F], seen: &mut Vec<F>) -> Vec<F> {
        seen.clear();
        for channel in 0..3 {
            let visible = self.of(grad, channel).iter().zip(self.of(self.inputs.alpha, 0));
            seen.extend(visible.map(|(&grad, &alpha)| grad * (F::ONE - alpha)));
        }
        let products = |(k, channel): (usize, usize)| {
            dot(self.of(self.inputs.harmonics, k), &seen[channel * self.len..][..self.len])
        };
        let count = self.inputs.coefficients.len() / 3;
        (0..count).flat_map(|k| (0..3).map(move |channel| (k, channel))).map(products).collect()
    }
}

/// The sum of products, in a fixed order.
fn dot<F: Real>(a: &[F], b: &[F]) -> F {
    let mut lanes = [F::ZERO; LANES];
    let (whole, rest) = a.as_chunks::<LANES>();
    let (of_whole, of_rest) = b.as_chunks::<LANES>();
    for (a, b) in whole.iter().zip(of_whole) {
        for lane in 0..LANES {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    lanes.iter_mut().zip(rest.iter().zip(of_rest)).for_each(|(lane, (&a, &b))| *lane += a * b);
    lanes.into_iter().sum()
}

/// `[3, H, W]`: the render over the environment.
pub(crate) fn environment_cpu<F: Real>(inputs: Sky<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    let (red, rest) = out.split_at_mut(inputs.alpha.len());
    let (green, blue) = rest.split_at_mut(inputs.alpha.len());
    let planes = red.par_chunks_mut(RUN).zip(green.par_chunks_mut(RUN)).zip(blue.par_chunks_mut(RUN));
    planes.zip(Run::all(inputs)).for_each_init(Vec::new, |sky, (((red, green), blue), run)| {
        run.sky(sky);
        let alpha = run.of(inputs.alpha, 0);
        for ((channel, out), sky) in [red, green, blue].into_iter().enumerate().zip(sky.chunks_exact(run.len)) {
            let image = run.of(inputs.image, channel);
            for (((out, &colour), &alpha), &sky) in out.iter_mut().zip(image).zip(alpha).zip(sky) {
                *out = colour + (F::ONE - alpha) * sky;
            }
        }
    });
    out
}

/// Returns the gradients of alpha and of the coefficients from `grad`, that of the composed picture, those that are needed. That of
/// the render is `grad` itself, and the harmonics have none.
pub(crate) fn environment_backward_cpu<F: Real>(inputs: Sky<&[F]>, grad: &[F], needs: Sky<bool>) -> Sky<Vec<F>> {
    let mut alpha = vec![F::ZERO; inputs.alpha.len()];
    let of_run = |scratch: &mut Vec<F>, (out, run): (&mut [F], Run<F>)| {
        if needs.alpha {
            run.sky(scratch);
            for (channel, sky) in scratch.chunks_exact(run.len).enumerate() {
                let grad = run.of(grad, channel);
                out.iter_mut().zip(grad).zip(sky).for_each(|((out, &grad), &sky)| *out += -grad * sky);
            }
        }
        if needs.coefficients { run.sums(grad, scratch) } else { Vec::new() }
    };
    let sums: Vec<Vec<F>> = alpha.par_chunks_mut(RUN).zip(Run::all(inputs)).map_init(Vec::new, of_run).collect();
    let mut coefficients = vec![F::ZERO; if needs.coefficients { inputs.coefficients.len() } else { 0 }];
    for sums in sums {
        coefficients.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Sky { alpha: if needs.alpha { alpha } else { Vec::new() }, coefficients, ..Sky::default() }
}
