//! CPU twin of the colour map, parallel over runs of pixels of one length, whose sums are added in their order. A pass reads each pixel
//! once, a vector at a time; the twelve sums of a run stay in registers.

use fearless_simd::prelude::*;

use super::{MAP, Mapped};
use crate::simd::blocks::{block_len, load, splat, store};
use crate::simd::real::Real;
use crate::simd::{dispatch, each};
use crate::tasks;

/// Number of pixels per task.
const RUN: usize = 8192;

/// The run's part of each plane.
fn planes<F>(values: &[F], run: usize) -> [&[F]; 3] {
    let pixels = values.len() / 3;
    let (first, end) = (run * RUN, pixels.min((run + 1) * RUN));
    std::array::from_fn(|channel| &values[channel * pixels..][first..end])
}

/// The parts of each plane, run by run.
fn planes_mut<F: Real>(values: &mut [F]) -> impl Iterator<Item = [&mut [F]; 3]> {
    let pixels = values.len() / 3;
    let (red, rest) = values.split_at_mut(pixels);
    let (green, blue) = rest.split_at_mut(pixels);
    let runs = red.chunks_mut(RUN).zip(green.chunks_mut(RUN)).zip(blue.chunks_mut(RUN));
    runs.map(|((red, green), blue)| [red, green, blue])
}

#[inline(always)]
fn load_colours<S: Simd, F: Real>(simd: S, [r, g, b]: [&[F]; 3], at: usize) -> [F::Block<S>; 3] {
    [load(simd, &r[at..]), load(simd, &g[at..]), load(simd, &b[at..])]
}

/// `[3, H, W]`: the mapped picture.
pub(crate) fn colour_map_cpu<F: Real>(inputs: Mapped<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    tasks::for_each(planes_mut(&mut out), |run, out| {
        dispatch!(F, simd => map_run(simd, planes(inputs.image, run), inputs.map, out));
    });
    out
}

#[inline(always)]
fn map_run<S: Simd, F: Real>(simd: S, image: [&[F]; 3], map: &[F], out: [&mut [F]; 3]) {
    for at in (0..image[0].len()).step_by(block_len::<S, F>()) {
        let [r, g, b] = load_colours(simd, image, at);
        for channel in 0..3 {
            let row = 4 * channel;
            let rest = b.mul_add(splat(simd, map[row + 2]), splat(simd, map[row + 3]));
            let shown = r.mul_add(splat(simd, map[row]), g.mul_add(splat(simd, map[row + 1]), rest));
            store::<S, F>(shown, &mut out[channel][at..]);
        }
    }
}

/// Returns the gradients of picture and map from `grad`, that of the mapped picture, those that are needed.
pub(crate) fn colour_map_backward_cpu<F: Real>(
    inputs: Mapped<&[F]>,
    grad: &[F],
    needs: Mapped<bool>,
) -> Mapped<Vec<F>> {
    let mut image = vec![F::ZERO; if needs.image { inputs.image.len() } else { 0 }];
    let runs = (inputs.image.len() / 3).div_ceil(RUN);
    let mut of_runs: Vec<Option<[&mut [F]; 3]>> = planes_mut(&mut image).map(Some).collect();
    of_runs.resize_with(runs, || None);
    let sums: Vec<[F; MAP]> = tasks::map(of_runs, |run, out| {
        let pixels = (planes(inputs.image, run), planes(grad, run));
        dispatch!(F, simd => differentiate_run(simd, pixels, inputs.map, out))
    });
    let mut map = vec![F::ZERO; if needs.map { MAP } else { 0 }];
    for sums in sums {
        map.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Mapped { image, map }
}

/// Writes the gradient of a run's colours to `out` if it is needed, and returns the run's share of the map's gradient. `map` is the colour
/// map; the pair holds the planes of the run and of its gradient.
#[inline(always)]
fn differentiate_run<S: Simd, F: Real>(
    simd: S,
    (image, grad): ([&[F]; 3], [&[F]; 3]),
    map: &[F],
    mut out: Option<[&mut [F]; 3]>,
) -> [F; MAP] {
    let mut sums = [splat(simd, F::ZERO); MAP];
    for at in (0..image[0].len()).step_by(block_len::<S, F>()) {
        let ([r, g, b], grad) = (load_colours(simd, image, at), load_colours(simd, grad, at));
        for (row, &grad) in grad.iter().enumerate() {
            sums[4 * row] = grad.mul_add(r, sums[4 * row]);
            sums[4 * row + 1] = grad.mul_add(g, sums[4 * row + 1]);
            sums[4 * row + 2] = grad.mul_add(b, sums[4 * row + 2]);
            sums[4 * row + 3] += grad;
        }
        if let Some(out) = &mut out {
            for (channel, out) in out.iter_mut().enumerate() {
                let rest = grad[1].mul_add(splat(simd, map[4 + channel]), grad[2] * splat(simd, map[8 + channel]));
                let back = grad[0].mul_add(splat(simd, map[channel]), rest);
                store::<S, F>(back, &mut out[at..]);
            }
        }
    }
    each!(sums, |sum| sum.reduce_sum())
}
