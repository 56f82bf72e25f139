//! CPU twin of the colour map, parallel over runs of pixels of one length, whose sums are added in their order.

use rayon::prelude::*;

use super::{MAP, Mapped};
use crate::simd::real::Real;

/// Number of pixels per task.
const RUN: usize = 4096;

/// Number of pixels whose sums are kept apart, so that they are added side by side.
const LANES: usize = 16;

/// The run's part of each plane.
fn planes<F>(values: &[F], run: usize) -> [&[F]; 3] {
    let pixels = values.len() / 3;
    let (first, end) = (run * RUN, pixels.min((run + 1) * RUN));
    std::array::from_fn(|channel| &values[channel * pixels..][first..end])
}

/// The parts of each plane, run by run.
fn planes_mut<F: Real>(values: &mut [F]) -> impl IndexedParallelIterator<Item = [&mut [F]; 3]> {
    let pixels = values.len() / 3;
    let (red, rest) = values.split_at_mut(pixels);
    let (green, blue) = rest.split_at_mut(pixels);
    let runs = red.par_chunks_mut(RUN).zip(green.par_chunks_mut(RUN)).zip(blue.par_chunks_mut(RUN));
    runs.map(|((red, green), blue)| [red, green, blue])
}

/// Writes `weights · (r, g, b) + offset` to a run of a plane.
fn combine<F: Real>(out: &mut [F], [r, g, b]: [&[F]; 3], weights: [F; 3], offset: F) {
    for (((out, &r), &g), &b) in out.iter_mut().zip(r).zip(g).zip(b) {
        *out = offset + weights[0] * r + weights[1] * g + weights[2] * b;
    }
}

/// `[3, H, W]`: the mapped picture.
pub(crate) fn colour_map_cpu<F: Real>(inputs: Mapped<&[F]>) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    planes_mut(&mut out).enumerate().for_each(|(run, out)| {
        let image = planes(inputs.image, run);
        for (out, row) in out.into_iter().zip(inputs.map.as_chunks::<4>().0) {
            combine(out, image, [row[0], row[1], row[2]], row[3]);
        }
    });
    out
}

/// Returns the gradients of picture and map from `grad`, that of the mapped picture, those that are needed.
pub(crate) fn colour_map_backward_cpu<F: Real>(
    inputs: Mapped<&[F]>,
    grad: &[F],
    needs: Mapped<bool>,
) -> Mapped<Vec<F>> {
    let mut image = vec![F::ZERO; if needs.image { inputs.image.len() } else { 0 }];
    if needs.image {
        planes_mut(&mut image).enumerate().for_each(|(run, out)| {
            let grad = planes(grad, run);
            for (channel, out) in out.into_iter().enumerate() {
                combine(out, grad, [0, 1, 2].map(|row| inputs.map[4 * row + channel]), F::ZERO);
            }
        });
    }
    if !needs.map {
        return Mapped { image, map: Vec::new() };
    }
    let runs = (inputs.image.len() / 3).div_ceil(RUN);
    let sums: Vec<[F; MAP]> = (0..runs).into_par_iter().map(|run| sums(inputs.image, grad, run)).collect();
    let mut map = vec![F::ZERO; MAP];
    for sums in sums {
        map.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Mapped { image, map }
}

/// A run's share of the map's gradient.
fn sums<F: Real>(image: &[F], grad: &[F], run: usize) -> [F; MAP] {
    let (image, grad) = (planes(image, run), planes(grad, run));
    std::array::from_fn(|entry| {
        let grad = grad[entry / 4];
        match entry % 4 {
            3 => sum(grad.iter().copied()),
            channel => sum(grad.iter().zip(image[channel]).map(|(&grad, &value)| grad * value)),
        }
    })
}

/// The sum of values, in a fixed order.
fn sum<F: Real>(values: impl Iterator<Item = F>) -> F {
    let mut lanes = [F::ZERO; LANES];
    values.enumerate().for_each(|(i, value)| lanes[i % LANES] += value);
    lanes.into_iter().sum()
}
