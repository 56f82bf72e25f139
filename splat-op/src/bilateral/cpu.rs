//! CPU twin of the slice. A vector of pixels of one row adds up the maps of the grid around it, each by its weight, so that nothing is
//! gathered: the vector lies between few columns, and its lumas between few levels.
//!
//! The forward pass is parallel over rows of pixels, the backward pass over the bands of pixels between two rows of the grid. Within a
//! band it goes down vector by vector; the sums of a vector's maps stay in the processor's cache and are added over the lanes at the
//! end of the band.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::{LUMA, MAP, SliceSize, Sliced};
use crate::simd::blocks::{block_len, load, splat, store};
use crate::simd::real::Real;

/// Where the centres of `pixels` pixels lie along an axis of the grid, counted from the first of `count` places.
fn places<F: Real>(pixels: usize, count: usize) -> Vec<F> {
    (0..pixels).map(|pixel| F::of((pixel as f64 + 0.5) / pixels as f64 * (count - 1) as f64)).collect()
}

/// The lower neighbour of a place.
#[inline(always)]
fn below<F: Real>(at: F, count: usize) -> usize {
    at.index().min(count - 2)
}

/// The share of a place in what lies `away` from it.
#[inline(always)]
fn hat<S: Simd, F: Real>(away: F::Block<S>, zero: F::Block<S>, one: F::Block<S>) -> F::Block<S> {
    (one - away.abs()).max(zero)
}

/// Copies a grid, `[12, L, R, C]`, by row, then column, then level, with the entries of a map side by side.
fn by_place<F: Real>(grid: &[F], size: SliceSize) -> Vec<F> {
    let SliceSize { levels, rows, columns, .. } = size;
    let mut maps = vec![F::ZERO; grid.len()];
    for (plane, values) in grid.chunks_exact(columns).enumerate() {
        let (entry, level, row) = (plane / (levels * rows), plane / rows % levels, plane % rows);
        let first = (row * columns * levels + level) * MAP + entry;
        maps[first..].iter_mut().step_by(levels * MAP).zip(values).for_each(|(to, &from)| *to = from);
    }
    maps
}

/// The inverse of [`by_place`].
fn by_entry<F: Real>(maps: &[F], size: SliceSize) -> Vec<F> {
    let SliceSize { levels, rows, columns, .. } = size;
    let mut grid = vec![F::ZERO; maps.len()];
    for (plane, values) in grid.chunks_exact_mut(columns).enumerate() {
        let (entry, level, row) = (plane / (levels * rows), plane / rows % levels, plane % rows);
        let first = (row * columns * levels + level) * MAP + entry;
        values.iter_mut().zip(maps[first..].iter().step_by(levels * MAP)).for_each(|(to, &from)| *to = from);
    }
    grid
}

/// Writes the maps between two rows of the grid: `upper + share (lower − upper)`.
#[inline(always)]
fn mix<F: Real>(upper: &[F], lower: &[F], share: F, to: &mut [F]) {
    for (to, (&upper, &lower)) in to.iter_mut().zip(upper.iter().zip(lower)) {
        *to = (lower - upper) * share + upper;
    }
}

/// A vector of pixels of one row, and the maps around it.
struct Pixels<S: Simd, F: Real> {
    colour: [F::Block<S>; 3],
    luma: F::Block<S>,
    /// Places of the lumas along the levels.
    z: F::Block<S>,
    /// The levels around them.
    low: usize,
    high: usize,
}

impl<S: Simd, F: Real> Pixels<S, F> {
    #[inline(always)]
    fn new(simd: S, [r, g, b]: [&[F]; 3], levels: usize) -> Self {
        let colour = [load(simd, r), load(simd, g), load(simd, b)];
        let [zero, one] = [F::ZERO, F::ONE].map(|value| splat::<S, F>(simd, value));
        let mut luma = colour[0] * splat::<S, F>(simd, F::of(LUMA[0]));
        luma = colour[1].mul_add(splat::<S, F>(simd, F::of(LUMA[1])), luma);
        luma = colour[2].mul_add(splat::<S, F>(simd, F::of(LUMA[2])), luma);
        let z = luma.max(zero).min(one) * splat::<S, F>(simd, F::of((levels - 1) as f64));
        let (low, high) = (below(z.reduce_min(), levels), below(z.reduce_max(), levels) + 1);
        Self { colour, luma, z, low, high }
    }
}

/// The columns of the grid around the vectors of a row of pixels.
struct Columns<F> {
    /// Places of the pixels along the columns.
    x: Vec<F>,
    count: usize,
}

impl<F: Real> Columns<F> {
    fn new(size: SliceSize) -> Self {
        Self { x: places(size.width, size.columns), count: size.columns }
    }

    /// First and last column around the pixels `from..to`, of which there is one at least.
    fn around(&self, from: usize, to: usize) -> (usize, usize) {
        (below(self.x[from], self.count), below(self.x[to - 1], self.count) + 1)
    }
}

/// Returns the three planes of a row of pixels.
fn planes<F>(values: &[F], size: SliceSize, row: usize) -> [&[F]; 3] {
    std::array::from_fn(|channel| &values[(channel * size.height + row) * size.width..][..size.width])
}

/// Returns the three planes of each row of pixels, or of none if there are no values.
fn planes_mut<F>(values: &mut [F], size: SliceSize) -> Vec<[&mut [F]; 3]> {
    let mut rows = values.chunks_exact_mut((size.width * size.height).max(1)).map(|plane| plane.chunks_mut(size.width));
    match [rows.next(), rows.next(), rows.next()] {
        [Some(r), Some(g), Some(b)] => r.zip(g).zip(b).map(|((r, g), b)| [r, g, b]).collect(),
        _ => Vec::new(),
    }
}

/// `[3, H, W]`: the mapped picture.
pub(crate) fn slice_cpu<F: Real>(inputs: Sliced<&[F]>, size: SliceSize) -> Vec<F> {
    let mut out = vec![F::ZERO; inputs.image.len()];
    let (maps, columns) = (by_place(inputs.grid, size), Columns::new(size));
    let len = size.columns * size.levels * MAP;
    let down: Vec<F> = places(size.height, size.rows);
    planes_mut(&mut out, size).into_par_iter().zip(down).enumerate().for_each_init(
        || vec![F::ZERO; len],
        |row, (y, (out, down))| {
            let image = planes(inputs.image, size, y);
            let upper = below(down, size.rows);
            let share = down - F::of(upper as f64);
            dispatch!(Level::new(), simd => {
                mix(&maps[upper * len..][..len], &maps[(upper + 1) * len..][..len], share, row);
                row_forward(simd, row, size.levels, (image, &columns), out);
            });
        },
    );
    out
}

/// Maps a row of pixels. `maps` are those of the row, by column, then level.
#[inline(always)]
fn row_forward<S: Simd, F: Real>(
    simd: S,
    maps: &[F],
    levels: usize,
    (image, columns): ([&[F]; 3], &Columns<F>),
    out: [&mut [F]; 3],
) {
    let [zero, one] = [F::ZERO, F::ONE].map(|value| splat::<S, F>(simd, value));
    let width = image[0].len();
    for from in (0..width).step_by(block_len::<S, F>()) {
        let to = width.min(from + block_len::<S, F>());
        let (x, pixels) = (load(simd, &columns.x[from..]), Pixels::new(simd, image.map(|row| &row[from..]), levels));
        let (first, last) = columns.around(from, to);
        let mut map = [zero; MAP];
        for column in first..=last {
            let across = hat::<S, F>(x - splat::<S, F>(simd, F::of(column as f64)), zero, one);
            for level in pixels.low..=pixels.high {
                let weight = across * hat::<S, F>(pixels.z - splat::<S, F>(simd, F::of(level as f64)), zero, one);
                let entries = &maps[(column * levels + level) * MAP..][..MAP];
                for (sum, &entry) in map.iter_mut().zip(entries) {
                    *sum = weight.mul_add(splat::<S, F>(simd, entry), *sum);
                }
            }
        }
        let [r, g, b] = pixels.colour;
        for channel in 0..3 {
            let row = &map[4 * channel..][..4];
            let shown = row[0].mul_add(r, row[1].mul_add(g, row[2].mul_add(b, row[3])));
            store::<S, F>(shown, &mut out[channel][from..]);
        }
    }
}

/// A row of pixels: its number, the share of the lower row of the grid, and room for the gradient of its planes if that is needed.
type Row<'a, F> = (usize, F, Option<[&'a mut [F]; 3]>);

/// Returns the gradients of picture and grid from `grad`, that of the mapped picture, those that are needed.
pub(crate) fn slice_backward_cpu<F: Real>(
    inputs: Sliced<&[F]>,
    grad: &[F],
    size: SliceSize,
    needs: Sliced<bool>,
) -> Sliced<Vec<F>> {
    let mut of_image = vec![F::ZERO; if needs.image { inputs.image.len() } else { 0 }];
    let (maps, columns) = (by_place(inputs.grid, size), Columns::new(size));
    let len = size.columns * size.levels * MAP;
    let mut of_rows = planes_mut(&mut of_image, size).into_iter();
    let mut bands: Vec<(usize, Vec<Row<F>>)> = (0..size.rows - 1).map(|upper| (upper, Vec::new())).collect();
    for (y, down) in places::<F>(size.height, size.rows).into_iter().enumerate() {
        let upper = below(down, size.rows);
        bands[upper].1.push((y, down - F::of(upper as f64), of_rows.next()));
    }
    // The sums of a band go to the rows of the grid above and below it.
    let band_sums = |(upper, mut rows): (usize, Vec<Row<F>>)| {
        let mut sums = vec![F::ZERO; 2 * len];
        let band = Band { inputs, grad, maps: &maps[upper * len..][..2 * len], size, columns: &columns };
        dispatch!(Level::new(), simd => band.backward(simd, &mut rows, needs.grid, &mut sums));
        (upper, sums)
    };
    let sums: Vec<(usize, Vec<F>)> = bands.into_par_iter().map(band_sums).collect();
    if !needs.grid {
        return Sliced { image: of_image, grid: Vec::new() };
    }
    let mut total = vec![F::ZERO; maps.len()];
    for (upper, sums) in sums {
        total[upper * len..].iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
    }
    Sliced { image: of_image, grid: by_entry(&total, size) }
}

/// The pixels between two rows of the grid.
struct Band<'a, F> {
    inputs: Sliced<&'a [F]>,
    grad: &'a [F],
    /// The maps of both rows, by row, then column, then level.
    maps: &'a [F],
    size: SliceSize,
    columns: &'a Columns<F>,
}

impl<F: Real> Band<'_, F> {
    /// Writes the gradients of the rows' colours, where there is room for them, and if `sum` is set adds those of the maps to `sums`.
    #[inline(always)]
    fn backward<S: Simd>(&self, simd: S, rows: &mut [Row<F>], sum: bool, sums: &mut [F]) {
        let (width, levels, lanes) = (self.size.width, self.size.levels, block_len::<S, F>());
        let (upper, lower) = self.maps.split_at(self.maps.len() / 2);
        let (mut maps, mut wide) = (Vec::new(), Vec::new());
        for from in (0..width).step_by(lanes) {
            let to = width.min(from + lanes);
            let (first, last) = self.columns.around(from, to);
            let near = first * levels * MAP..(last + 1) * levels * MAP;
            maps.resize(near.len(), F::ZERO);
            wide.clear();
            wide.resize(2 * near.len() * lanes, F::ZERO);
            let x = load(simd, &self.columns.x[from..]);
            let (mut low, mut high) = (levels - 1, 0);
            for (y, down, out) in rows.iter_mut() {
                mix(&upper[near.clone()], &lower[near.clone()], *down, &mut maps);
                let pixels =
                    Pixels::new(simd, planes(self.inputs.image, self.size, *y).map(|row| &row[from..]), levels);
                let [red, green, blue] = planes(self.grad, self.size, *y);
                let grad = [load(simd, &red[from..]), load(simd, &green[from..]), load(simd, &blue[from..])];
                (low, high) = (low.min(pixels.low), high.max(pixels.high));
                let share = sum.then_some(*down);
                let of_colour = pixels.backward((x, first..=last), (&maps, levels), grad, (share, &mut wide));
                if let Some(out) = out {
                    for (channel, of_channel) in of_colour.into_iter().enumerate() {
                        store::<S, F>(of_channel, &mut out[channel][from..to]);
                    }
                }
            }
            if !sum || low > high {
                continue;
            }
            let (of_upper, of_lower) = sums.split_at_mut(self.maps.len() / 2);
            let (wide_upper, wide_lower) = wide.split_at(near.len() * lanes);
            for (sums, wide) in [(of_upper, wide_upper), (of_lower, wide_lower)] {
                let of_columns = sums[near.clone()].chunks_exact_mut(levels * MAP);
                for (sums, wide) in of_columns.zip(wide.chunks_exact(levels * MAP * lanes)) {
                    for i in low * MAP..(high + 1) * MAP {
                        sums[i] += load::<S, F>(simd, &wide[i * lanes..][..lanes]).reduce_sum();
                    }
                }
            }
        }
    }
}

impl<S: Simd, F: Real> Pixels<S, F> {
    /// Returns the gradient of the colours from `grad`, that of the mapped colours. With the share of the lower row of the grid it adds
    /// the gradients of the maps to `sums`, lane by lane: those of the upper row, then those of the lower. `x` are the pixels' places
    /// along the columns `columns`, whose `maps` are given by column, then level.
    #[inline(always)]
    fn backward(
        &self,
        (x, columns): (F::Block<S>, std::ops::RangeInclusive<usize>),
        (maps, levels): (&[F], usize),
        grad: [F::Block<S>; 3],
        (down, sums): (Option<F>, &mut [F]),
    ) -> [F::Block<S>; 3] {
        let simd = x.token();
        let lanes = block_len::<S, F>();
        let [zero, one] = [F::ZERO, F::ONE].map(|value| splat::<S, F>(simd, value));
        let [r, g, b] = self.colour;
        let (of_upper, of_lower) = sums.split_at_mut(sums.len() / 2);
        let (mut direct, mut along) = ([zero; 3], zero);
        let first = *columns.start();
        for column in columns {
            let across = hat::<S, F>(x - splat::<S, F>(simd, F::of(column as f64)), zero, one);
            for level in self.low..=self.high {
                let away = self.z - splat::<S, F>(simd, F::of(level as f64));
                let weight = across * hat::<S, F>(away, zero, one);
                // The slope of the hat towards larger lumas.
                let falls = away.simd_ge(zero) & away.simd_lt(one);
                let rises = away.simd_lt(zero) & away.simd_ge(-one);
                let slope = falls.select(-across, rises.select(across, zero));
                let place = ((column - first) * levels + level) * MAP;
                let entries = &maps[place..][..MAP];
                // Mᵀ g and the gradient of the offset's weight.
                let mut back = [zero; 4];
                for (row, grad) in entries.chunks_exact(4).zip(grad) {
                    for (back, &entry) in back.iter_mut().zip(row) {
                        *back = grad.mul_add(splat::<S, F>(simd, entry), *back);
                    }
                }
                for (direct, back) in direct.iter_mut().zip(back) {
                    *direct = weight.mul_add(back, *direct);
                }
                let of_weight = r.mul_add(back[0], g.mul_add(back[1], b.mul_add(back[2], back[3])));
                along = slope.mul_add(of_weight, along);
                let Some(down) = down else { continue };
                let of_lower = &mut of_lower[place * lanes..][..MAP * lanes];
                let of_upper = &mut of_upper[place * lanes..][..MAP * lanes];
                let lower = weight * splat::<S, F>(simd, down);
                for (sums, weight) in [(of_upper, weight - lower), (of_lower, lower)] {
                    for (row, grad) in grad.into_iter().enumerate() {
                        let grad = weight * grad;
                        for (entry, value) in [r, g, b, one].into_iter().enumerate() {
                            let at = &mut sums[(4 * row + entry) * lanes..][..lanes];
                            value.mul_add(grad, F::Block::<S>::from_slice(simd, at)).store_slice(at);
                        }
                    }
                }
            }
        }
        // The place along the levels is constant where the luma is at its limits.
        let free = self.luma.simd_gt(zero) & self.luma.simd_lt(one);
        let of_luma = free.select(along * splat::<S, F>(simd, F::of((levels - 1) as f64)), zero);
        for (channel, direct) in direct.iter_mut().enumerate() {
            *direct = of_luma.mul_add(splat::<S, F>(simd, F::of(LUMA[channel])), *direct);
        }
        direct
    }
}
