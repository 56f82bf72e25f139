//! CPU twin of the convolution, parallel over chunks of Gaussians, a vector of them at a time.

use fearless_simd::prelude::*;

use super::Smooth;
use crate::linalg::norm;
use crate::simd::blocks::{block_len, load, splat, store};
use crate::simd::dispatch;
use crate::simd::real::Real;
use crate::tasks;

/// Number of Gaussians per task.
const CHUNK: usize = 2048;

/// `√(a² + b²)`, without intermediate overflow or underflow.
#[inline(always)]
fn hypotenuse<S: Simd, F: Real>(a: F::Block<S>, b: F::Block<S>) -> F::Block<S> {
    let simd = a.token();
    let square = a * a + b * b;
    // The bounds of `norm`.
    let plain = square.simd_gt(splat::<S, F>(simd, F::of(1e-20))) & square.simd_lt(splat::<S, F>(simd, F::of(1e30)));
    if plain.all_true() {
        square.sqrt()
    } else {
        F::Block::<S>::from_fn(simd, |lane| norm([a[lane], b[lane], F::ZERO]))
    }
}

/// `[N, 3]`: the new standard deviations.
pub(crate) fn smoothed_scales_cpu<F: Real>(scales: &[F], widths: &[F]) -> Vec<F> {
    let mut out = vec![F::ZERO; scales.len()];
    let chunks = out.chunks_mut(3 * CHUNK).zip(scales.chunks(3 * CHUNK).zip(widths.chunks(CHUNK)));
    tasks::for_each(chunks, |_, (out, (scales, widths))| {
        dispatch!(F, simd => scales_of_run(simd, scales, widths, out));
    });
    out
}

#[inline(always)]
fn scales_of_run<S: Simd, F: Real>(simd: S, scales: &[F], widths: &[F], out: &mut [F]) {
    for at in (0..scales.len()).step_by(block_len::<S, F>()) {
        let width = F::Block::<S>::from_fn(simd, |lane| widths[((at + lane) / 3).min(widths.len() - 1)]);
        store::<S, F>(hypotenuse::<S, F>(load(simd, &scales[at..]), width), &mut out[at..]);
    }
}

/// A vector of Gaussians: inverses of the new standard deviations, and the shares of the old ones in them, by axis.
struct Shares<S: Simd, F: Real> {
    width: F::Block<S>,
    inverse: [F::Block<S>; 3],
    share: [F::Block<S>; 3],
}

impl<S: Simd, F: Real> Shares<S, F> {
    /// Reads the Gaussians from `at` on. Beyond the last, all lanes have the last.
    #[inline(always)]
    fn new(simd: S, scales: &[[F; 3]], widths: &[F], at: usize) -> Self {
        let last = widths.len() - 1;
        let width = F::Block::<S>::from_fn(simd, |lane| widths[(at + lane).min(last)]);
        let at = |axis: usize| F::Block::<S>::from_fn(simd, |lane| scales[(at + lane).min(last)][axis]);
        let scale = [at(0), at(1), at(2)];
        let (mut inverse, mut share) = (scale, scale);
        for axis in 0..3 {
            inverse[axis] = splat::<S, F>(simd, F::ONE) / hypotenuse::<S, F>(scale[axis], width);
            share[axis] = scale[axis] * inverse[axis];
        }
        Self { width, inverse, share }
    }

    /// The product of the shares.
    #[inline(always)]
    fn product(&self) -> F::Block<S> {
        let [x, y, z] = self.share;
        x * y * z
    }
}

/// `[N]`: the new opacities.
pub(crate) fn smoothed_opacities_cpu<F: Real>(inputs: Smooth<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.opacities.len()];
    let scales = inputs.scales.as_chunks::<3>().0.chunks(CHUNK);
    let chunks = scales.zip(inputs.widths.chunks(CHUNK)).zip(inputs.opacities.chunks(CHUNK));
    tasks::for_each(out.chunks_mut(CHUNK).zip(chunks), |_, (out, (gaussians, opacities))| {
        dispatch!(F, simd => opacities_of_run(simd, gaussians, opacities, out));
    });
    out
}

#[inline(always)]
fn opacities_of_run<S: Simd, F: Real>(simd: S, (scales, widths): (&[[F; 3]], &[F]), opacities: &[F], out: &mut [F]) {
    for at in (0..out.len()).step_by(block_len::<S, F>()) {
        let shares = Shares::<S, F>::new(simd, scales, widths, at);
        store::<S, F>(load(simd, &opacities[at..]) * shares.product(), &mut out[at..]);
    }
}

/// Returns the gradients of the standard deviations and of the opacities from `grad`, `[N]`, that of the new opacities.
pub(crate) fn smoothed_opacities_backward_cpu<F: Real>(inputs: Smooth<&[F]>, grad: &[F]) -> Smooth<Vec<F>> {
    let (mut scales, mut opacities) = (vec![F::ZERO; inputs.scales.len()], vec![F::ZERO; inputs.opacities.len()]);
    let of = inputs.scales.as_chunks::<3>().0.chunks(CHUNK).zip(inputs.widths.chunks(CHUNK));
    let chunks = of.zip(inputs.opacities.chunks(CHUNK).zip(grad.chunks(CHUNK)));
    let out = scales.as_chunks_mut::<3>().0.chunks_mut(CHUNK).zip(opacities.chunks_mut(CHUNK));
    tasks::for_each(out.zip(chunks), |_, (out, (gaussians, grads))| {
        dispatch!(F, simd => run_backward(simd, gaussians, grads, out));
    });
    Smooth { scales, opacities, widths: Vec::new() }
}

/// Writes the gradients of a run's standard deviations and opacities.
#[inline(always)]
fn run_backward<S: Simd, F: Real>(
    simd: S,
    (scales, widths): (&[[F; 3]], &[F]),
    (opacities, grad): (&[F], &[F]),
    (of_scales, of_opacities): (&mut [[F; 3]], &mut [F]),
) {
    for at in (0..grad.len()).step_by(block_len::<S, F>()) {
        let (shares, grad) = (Shares::<S, F>::new(simd, scales, widths, at), load(simd, &grad[at..]));
        store::<S, F>(grad * shares.product(), &mut of_opacities[at..]);
        shares.backward(grad * load(simd, &opacities[at..]), &mut of_scales[at..]);
    }
}

impl<S: Simd, F: Real> Shares<S, F> {
    /// Writes the gradients of the standard deviations from that of the product of the shares.
    #[inline(always)]
    fn backward(&self, grad: F::Block<S>, out: &mut [[F; 3]]) {
        let [x, y, z] = self.share;
        let others = [y * z, x * z, x * y];
        let mut of_scale = others;
        for axis in 0..3 {
            let added = self.width * self.inverse[axis];
            of_scale[axis] = grad * others[axis] * (added * added * self.inverse[axis]);
        }
        for (lane, out) in out.iter_mut().enumerate().take(block_len::<S, F>()) {
            *out = [of_scale[0][lane], of_scale[1][lane], of_scale[2][lane]];
        }
    }
}
