//! CPU twin of the composition, parallel over runs of pixels of one length, whose sums are added in their order. Sums over a run go to the
//! lanes of a vector first.

use fearless_simd::prelude::*;

use super::Sky;
use crate::sh::basis::basis_of;
use crate::sh::{SH_COEFFICIENTS_MAX, degree_of};
use crate::simd::{Real, block_len, dispatch, load, splat, store};
use crate::tasks;

/// Number of pixels per task.
const RUN: usize = 4096;

/// Inputs of a run of pixels, which begins with pixel `first` of `pixels`.
struct PixelRun<'a, F> {
    inputs: Sky<&'a [F]>,
    pixels: usize,
    first: usize,
    len: usize,
}

impl<'a, F: Real> PixelRun<'a, F> {
    /// The runs of a picture.
    fn all(inputs: Sky<&'a [F]>) -> impl Iterator<Item = Self> {
        let pixels = inputs.alpha.len();
        let run = move |run: usize| Self { inputs, pixels, first: run * RUN, len: RUN.min(pixels - run * RUN) };
        (0..pixels.div_ceil(RUN)).map(run)
    }

    /// The run's part of three planes.
    fn of(&self, planes: &'a [F]) -> [&'a [F]; 3] {
        std::array::from_fn(|plane| &planes[plane * self.pixels + self.first..][..self.len])
    }

    /// The run's part of alpha.
    fn alpha(&self) -> &'a [F] {
        &self.inputs.alpha[self.first..][..self.len]
    }

    /// The coefficients, RGB.
    fn coefficients(&self) -> &'a [[F; 3]] {
        self.inputs.coefficients.as_chunks().0
    }

    /// Writes the render over the environment.
    #[inline(always)]
    fn compose<S: Simd>(&self, simd: S, out: [&mut [F]; 3]) {
        let (image, directions, alpha) = (self.of(self.inputs.image), self.of(self.inputs.directions), self.alpha());
        for at in (0..self.len).step_by(block_len::<S, F>()) {
            let sky = sky::<S, F>(&harmonics(simd, directions, at, self.coefficients().len()), self.coefficients());
            let through = splat(simd, F::ONE) - load(simd, &alpha[at..]);
            for channel in 0..3 {
                let colour = load(simd, &image[channel][at..]);
                store::<S, F>(through.mul_add(sky[channel], colour), &mut out[channel][at..]);
            }
        }
    }

    /// Writes the gradient of alpha, if it is needed, and returns the run's share of the coefficients' gradient, if that is needed.
    #[inline(always)]
    fn differentiate<S: Simd>(&self, simd: S, grad: &'a [F], of_alpha: &mut [F], needs: Sky<bool>) -> Vec<F> {
        let (grad, directions, alpha) = (self.of(grad), self.of(self.inputs.directions), self.alpha());
        let count = self.coefficients().len();
        let zero = splat(simd, F::ZERO);
        let mut sums = [[zero; 3]; SH_COEFFICIENTS_MAX];
        for at in (0..self.len).step_by(block_len::<S, F>()) {
            let harmonics = harmonics(simd, directions, at, count);
            let grad = [load(simd, &grad[0][at..]), load(simd, &grad[1][at..]), load(simd, &grad[2][at..])];
            if needs.alpha {
                let sky = sky::<S, F>(&harmonics, self.coefficients());
                let lost = grad[0].mul_add(sky[0], grad[1].mul_add(sky[1], grad[2] * sky[2]));
                store::<S, F>(-lost, &mut of_alpha[at..]);
            }
            if needs.coefficients {
                let through = splat(simd, F::ONE) - load(simd, &alpha[at..]);
                let seen = [grad[0] * through, grad[1] * through, grad[2] * through];
                for (sums, &harmonic) in sums.iter_mut().zip(&harmonics).take(count) {
                    for (sum, seen) in sums.iter_mut().zip(seen) {
                        *sum = harmonic.mul_add(seen, *sum);
                    }
                }
            }
        }
        let count = if needs.coefficients { count } else { 0 };
        let mut total = Vec::with_capacity(3 * count);
        for sum in sums[..count].as_flattened() {
            total.push(sum.reduce_sum());
        }
        total
    }
}

/// The values of `count` harmonics in the directions from pixel `at` of a run on.
#[inline(always)]
fn harmonics<S: Simd, F: Real>(
    simd: S,
    directions: [&[F]; 3],
    at: usize,
    count: usize,
) -> [F::Block<S>; SH_COEFFICIENTS_MAX] {
    let [x, y, z] = directions;
    let direction = [load(simd, &x[at..]), load(simd, &y[at..]), load(simd, &z[at..])];
    basis_of(
        direction,
        degree_of(count),
        #[inline(always)]
        |value| splat(simd, F::of(value)),
    )
}

/// The sky in pixels with these harmonics, RGB.
#[inline(always)]
fn sky<S: Simd, F: Real>(harmonics: &[F::Block<S>; SH_COEFFICIENTS_MAX], coefficients: &[[F; 3]]) -> [F::Block<S>; 3] {
    let simd = harmonics[0].token();
    let mut sky = [splat(simd, F::of(0.5)); 3];
    for (&harmonic, row) in harmonics.iter().zip(coefficients) {
        for (sky, &coefficient) in sky.iter_mut().zip(row) {
            *sky = harmonic.mul_add(splat::<S, F>(simd, coefficient), *sky);
        }
    }
    sky
}

/// `[3, H, W]`: the render over the environment.
pub(crate) fn environment_cpu<F: Real>(inputs: Sky<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    let (red, rest) = out.split_at_mut(inputs.alpha.len());
    let (green, blue) = rest.split_at_mut(inputs.alpha.len());
    let planes = red.chunks_mut(RUN).zip(green.chunks_mut(RUN)).zip(blue.chunks_mut(RUN));
    tasks::for_each(planes.zip(PixelRun::all(inputs)), |_, (((red, green), blue), run)| {
        dispatch!(F, simd => run.compose(simd, [red, green, blue]));
    });
    out
}

/// Returns the gradients of alpha and of the coefficients from `grad`, that of the composed picture, those that are needed. That of
/// the render is `grad` itself, and the directions have none.
pub(crate) fn environment_backward_cpu<F: Real>(inputs: Sky<&[F]>, grad: &[F], needs: Sky<bool>) -> Sky<Vec<F>> {
    let mut alpha = vec![F::ZERO; inputs.alpha.len()];
    let sums = tasks::map(
        alpha.chunks_mut(RUN).zip(PixelRun::all(inputs)),
        |_, (out, run)| dispatch!(F, simd => run.differentiate(simd, grad, out, needs)),
    );
    let mut coefficients = vec![F::ZERO; if needs.coefficients { inputs.coefficients.len() } else { 0 }];
    for sums in sums {
        coefficients.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Sky { alpha: if needs.alpha { alpha } else { Vec::new() }, coefficients, ..Sky::default() }
}
