//! CPU twin of the loss: two sweeps down the pictures, parallel over bands of rows. A sweep filters each row along its
//! length once, keeps the last eleven filtered rows and filters down those, so that a map is never read twice from
//! memory. The results that the first sweep leaves for the second stay with the band, in the processor's caches. Both
//! neighbouring bands compute the rows that the window reaches beyond a band.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::border::Excess;
use super::sweep::{PlaneSize, Sweep, load, splat, store};
use super::taps::{C1, C2, Compared, HALF};
use crate::simd::{LANES, Real, dispatch};
use crate::tasks;

/// Number of rows per task. The first sweep goes over five rows more above and below, and filters ten.
const BAND: usize = 96;

/// Returns the loss and, if `with_gradient` is set, its gradient with respect to the picture.
pub(crate) fn photometric_cpu<F: Real>(
    inputs: Compared<&[F]>,
    size: PlaneSize,
    lambda: f64,
    with_gradient: bool,
) -> (F, Option<Vec<F>>) {
    if inputs.image.is_empty() {
        return (F::ZERO, with_gradient.then(Vec::new));
    }
    let share = F::of(1.0 / inputs.image.len() as f64);
    let job = LossTask { inputs, size, lambda: F::of(lambda), share, excess: &Excess::new(size) };
    let mut gradient = vec![F::ZERO; if with_gradient { inputs.image.len() } else { 0 }];
    let mut rest = gradient.as_mut_slice();
    let part = |band: RowBand| {
        let len = if with_gradient { band.rows.len() * size.width } else { 0 };
        (band, rest.split_off_mut(..len).expect("as many rows as the bands have"))
    };
    let parts: Vec<(RowBand, &mut [F])> = bands(inputs.image.len(), size).map(part).collect();
    let sums: Vec<f64> = tasks::map_with(parts, Vec::new, |maps, _, (band, gradient)| {
        dispatch!(F, simd => {
            if !with_gradient {
                return job.index(simd, &band, &band.rows, &mut []);
            }
            // The rows that the window reaches.
            let reached = band.rows.start.saturating_sub(HALF)..size.height.min(band.rows.end + HALF);
            maps.resize(3 * size.width * reached.len(), F::ZERO);
            let sum = job.index(simd, &band, &reached, maps);
            job.gradient(simd, &band, maps, reached.start, gradient);
            sum
        })
    });
    let loss = F::of(sums.iter().sum::<f64>() / inputs.image.len() as f64);
    (loss, with_gradient.then_some(gradient))
}

/// Returns the mean `μy` and `σy² + C2` of a photograph's planes, which are of one size.
pub(crate) fn moments_cpu<F: Real>(planes: &[F], size: PlaneSize) -> [Vec<F>; 2] {
    let [mut mean, mut variance] = [0, 1].map(|_| vec![F::ZERO; planes.len()]);
    let (mut means, mut variances) = (&mut mean[..], &mut variance[..]);
    let part = |band: RowBand| {
        let len = band.rows.len() * size.width;
        let [mean, variance] =
            [&mut means, &mut variances].map(|rest| rest.split_off_mut(..len).expect("as many rows as the bands have"));
        (band, mean, variance)
    };
    let parts: Vec<(RowBand, &mut [F], &mut [F])> = bands(planes.len(), size).map(part).collect();
    let excess = Excess::<F>::new(size);
    tasks::for_each(parts, |_, (band, mean, variance)| {
        dispatch!(F, simd => {
            let c2 = splat(simd, F::of(C2));
            let mut sweep = Sweep::<F, 2>::new(size.width);
            let fill = |row: usize, [to, own]: [&mut [F]; 2]| {
                let plane = &planes[size.row(band.plane, row)..][..size.width];
                for ((to, own), &y) in to.iter_mut().zip(own).zip(plane) {
                    (*to, *own) = (y, y * (F::ONE - y));
                }
            };
            sweep.run(simd, band.rows.clone(), size.height, fill, #[inline(always)] |row, column, [mean_y, own]| {
                let first = (row - band.rows.start) * size.width;
                let columns = first + column..first + size.width;
                let [rest_y] = excess.rest(simd, [row, column], [mean_y]);
                store(mean_y, &mut mean[columns.clone()]);
                store(mean_y * rest_y - own + c2, &mut variance[columns]);
            });
        });
    });
    [mean, variance]
}

/// Returns the bands of planes that have `len` values together.
fn bands(len: usize, size: PlaneSize) -> impl Iterator<Item = RowBand> {
    let planes = len.checked_div(size.pixels()).unwrap_or(0);
    (0..planes)
        .flat_map(move |plane| (0..size.height).step_by(BAND).map(move |first| (plane, first)))
        .map(move |(plane, first)| RowBand { plane, rows: first..size.height.min(first + BAND) })
}

/// Rows of a plane.
struct RowBand {
    plane: usize,
    rows: Range<usize>,
}

/// Arguments that all tasks share.
struct LossTask<'a, F> {
    inputs: Compared<&'a [F]>,
    size: PlaneSize,
    lambda: F,
    /// One divided by the number of values.
    share: F,
    excess: &'a Excess<F>,
}

impl<F: Real> LossTask<'_, F> {
    /// First sweep. Returns the sum of `(1 − λ) |x − y| + λ (1 − S)` over a band. Writes to `maps`, unless it is empty,
    /// the derivatives of `−λ S`, divided by the number of values, with respect to `Kx`, `Kx²` (twice) and `Kxy`, row
    /// by row of `rows`, which may be more than the band's.
    #[inline(always)]
    fn index<S: Simd>(&self, simd: S, band: &RowBand, rows: &Range<usize>, maps: &mut [F]) -> f64 {
        let Self { inputs, size, .. } = *self;
        let lanes = |value: f64| F::Eight::<S>::splat(simd, F::of(value));
        let (one, two, c1, c2) = (lanes(1.0), lanes(2.0), lanes(C1), lanes(C2));
        let lambda = F::Eight::<S>::splat(simd, self.lambda);
        let scale = F::Eight::<S>::splat(simd, -self.lambda * self.share * F::of(2.0));
        let line = |row: usize| {
            let first = size.row(band.plane, row);
            first..first + size.width
        };
        let mut sum = 0.0;
        let zero = lanes(0.0);
        let lane = F::Eight::<S>::from_fn(simd, |lane| F::of(lane as f64));
        let mut row_sum = zero;
        let mut sweep = Sweep::<F, 3>::new(size.width);
        let fill = |row: usize, [to, own, both]: [&mut [F]; 3]| {
            let (x, y) = (&inputs.image[line(row)], &inputs.truth[line(row)]);
            let to = to.iter_mut().zip(own).zip(both);
            for ((((to, own), both), &x), &y) in to.zip(x).zip(y) {
                let rest = F::ONE - x;
                (*to, *own, *both) = (x, x * rest, x * (F::ONE - y) + y * rest);
            }
        };
        sweep.run(
            simd,
            rows.clone(),
            size.height,
            fill,
            #[inline(always)]
            |row, column, [mean_x, own, both]| {
                let rest = line(row).start + column..line(row).end;
                let (x, y) = (load(simd, &inputs.image[rest.clone()]), load(simd, &inputs.truth[rest.clone()]));
                let (mean_y, variance) = (load(simd, &inputs.mean[rest.clone()]), load(simd, &inputs.variance[rest]));
                let [rest_x, rest_y] = self.excess.rest(simd, [row, column], [mean_x, mean_y]);
                let a1 = (mean_x * mean_y).mul_add(two, c1);
                let a2 = mean_y.mul_add(rest_x, mean_x * rest_y) - both + c2;
                let b1 = mean_y.mul_add(mean_y, mean_x * mean_x) + c1;
                let b2 = mean_x * rest_x - own + variance;
                let inverse = one / (b1 * b2);
                let index = a1 * a2 * inverse;
                let share = (x - y).abs() * (one - lambda) + lambda * (one - index);
                if column + LANES < size.width {
                    row_sum += share;
                } else {
                    let inside = lane.simd_lt(F::Eight::<S>::splat(simd, F::of((size.width - column) as f64)));
                    row_sum += inside.select(share, zero);
                    sum += if band.rows.contains(&row) { row_sum.reduce_sum().f64() } else { 0.0 };
                    row_sum = zero;
                }
                if !maps.is_empty() {
                    let scaled = inverse * scale;
                    let d_xy = scaled * a1;
                    // The scaled index, divided by B1 and by B2.
                    let scaled_index = d_xy * a2;
                    let (over_b1, over_b2) = (scaled_index * (inverse * b2), scaled_index * (inverse * b1));
                    let d_mean = (a2 - a1) * scaled * mean_y - (over_b1 - over_b2) * mean_x;
                    let first = (row - rows.start) * 3 * size.width;
                    let (to_mean, rest) = maps[first..first + 3 * size.width].split_at_mut(size.width);
                    let (to_square, to_cross) = rest.split_at_mut(size.width);
                    store(d_mean, &mut to_mean[column..]);
                    store(-over_b2, &mut to_square[column..]);
                    store(d_xy, &mut to_cross[column..]);
                }
            },
        );
        sum
    }

    /// Second sweep. Computes `K ∂Kx + 2 x K ∂Kx² + y K ∂Kxy` and the derivative of `|x − y|` over a band from the maps
    /// of the first sweep, which begin with row `first`.
    #[inline(always)]
    fn gradient<S: Simd>(&self, simd: S, band: &RowBand, maps: &[F], first: usize, out: &mut [F]) {
        let Self { inputs, size, .. } = *self;
        let weight = (F::ONE - self.lambda) * self.share;
        let (up, down) = (F::Eight::<S>::splat(simd, weight), F::Eight::<S>::splat(simd, -weight));
        let zero = F::Eight::<S>::splat(simd, F::ZERO);
        let mut sweep = Sweep::<F, 3>::new(size.width);
        let fill = |row: usize, to: [&mut [F]; 3]| {
            let rows = &maps[3 * size.width * (row - first)..][..3 * size.width];
            to.into_iter().zip(rows.chunks_exact(size.width)).for_each(|(to, from)| to.copy_from_slice(from));
        };
        sweep.run(
            simd,
            band.rows.clone(),
            size.height,
            fill,
            #[inline(always)]
            |row, column, [mean, square, cross]| {
                let rest = size.row(band.plane, row) + column..size.row(band.plane, row + 1);
                let (x, y) = (load(simd, &inputs.image[rest.clone()]), load(simd, &inputs.truth[rest]));
                let difference = x - y;
                // Zero at zero; NaN stays NaN.
                let otherwise = difference * zero;
                let sign = difference.simd_gt(zero).select(up, difference.simd_lt(zero).select(down, otherwise));
                let gradient = square.mul_add(x, mean) + cross.mul_add(y, sign);
                store(gradient, &mut out[(row - band.rows.start) * size.width..][..size.width][column..]);
            },
        );
    }
}
