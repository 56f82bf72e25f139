//! CPU twin of the slice. A vector of pixels of one row adds up the maps of the grid around it, each by its weight, so that nothing is
//! gathered: the vector lies between few columns, and its lumas between few levels.
//!
//! The forward pass is parallel over rows of pixels, the backward pass over the bands of pixels between two rows of the grid. Within a
//! band it goes down vector by vector; the sums of a vector's maps stay in the processor's cache and are added over the lanes at the
//! end of the band.

use std::ops::RangeInclusive;

use fearless_simd::prelude::*;

use super::{LUMA, MAP, SliceSize, Sliced};
use crate::simd::{Real, block_len, dispatch, load, splat, store};
use crate::tasks;

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

/// The share of pixels at the places `x` in a column or level.
#[inline(always)]
fn share_of<S: Simd, F: Real>(x: F::Block<S>, at: usize) -> F::Block<S> {
    let simd = x.token();
    hat::<S, F>(x - splat::<S, F>(simd, F::of(at as f64)), splat::<S, F>(simd, F::ZERO), splat::<S, F>(simd, F::ONE))
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

/// Loads the pixels from `from` on of a row's planes.
#[inline(always)]
fn load_rgb<S: Simd, F: Real>(simd: S, [r, g, b]: [&[F]; 3], from: usize) -> [F::Block<S>; 3] {
    [load(simd, &r[from..]), load(simd, &g[from..]), load(simd, &b[from..])]
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
    /// Reads the pixels from `from` on of a row's planes.
    #[inline(always)]
    fn new(simd: S, planes: [&[F]; 3], from: usize, levels: usize) -> Self {
        let colour = load_rgb(simd, planes, from);
        let (zero, one) = (splat::<S, F>(simd, F::ZERO), splat::<S, F>(simd, F::ONE));
        let mut luma = colour[0] * splat::<S, F>(simd, F::of(LUMA[0]));
        luma = colour[1].mul_add(splat::<S, F>(simd, F::of(LUMA[1])), luma);
        luma = colour[2].mul_add(splat::<S, F>(simd, F::of(LUMA[2])), luma);
        let z = luma.max(zero).min(one) * splat::<S, F>(simd, F::of((levels - 1) as f64));
        let (low, high) = (below(z.reduce_min(), levels), below(z.reduce_max(), levels) + 1);
        Self { colour, luma, z, low, high }
    }
}

/// The columns of the grid around the vectors of a row of pixels.
struct GridColumns<F> {
    /// Places of the pixels along the columns.
    x: Vec<F>,
    count: usize,
}

impl<F: Real> GridColumns<F> {
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
    let (maps, columns) = (by_place(inputs.grid, size), GridColumns::new(size));
    let len = size.columns * size.levels * MAP;
    let down: Vec<F> = places(size.height, size.rows);
    tasks::map_with(
        planes_mut(&mut out, size).into_iter().zip(down),
        || vec![F::ZERO; len],
        |row, y, (out, down)| {
            let image = planes(inputs.image, size, y);
            let upper = below(down, size.rows);
            let share = down - F::of(upper as f64);
            dispatch!(F, simd => {
                mix(&maps[upper * len..][..len], &maps[(upper + 1) * len..][..len], share, row);
                row_forward(simd, row, size.levels, image, &columns, out);
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
    image: [&[F]; 3],
    columns: &GridColumns<F>,
    out: [&mut [F]; 3],
) {
    let (zero, width) = (splat::<S, F>(simd, F::ZERO), image[0].len());
    for from in (0..width).step_by(block_len::<S, F>()) {
        let to = width.min(from + block_len::<S, F>());
        let (x, pixels) = (load(simd, &columns.x[from..]), Pixels::new(simd, image, from, levels));
        let (first, last) = columns.around(from, to);
        let mut map = [zero; MAP];
        for column in first..=last {
            let across = share_of::<S, F>(x, column);
            for level in pixels.low..=pixels.high {
                let weight = across * share_of::<S, F>(pixels.z, level);
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
    let (maps, columns) = (by_place(inputs.grid, size), GridColumns::new(size));
    let len = size.columns * size.levels * MAP;
    let mut of_rows = planes_mut(&mut of_image, size).into_iter();
    let mut bands: Vec<(usize, Vec<Row<F>>)> = (0..size.rows - 1).map(|upper| (upper, Vec::new())).collect();
    for (y, down) in places::<F>(size.height, size.rows).into_iter().enumerate() {
        let upper = below(down, size.rows);
        bands[upper].1.push((y, down - F::of(upper as f64), of_rows.next()));
    }
    // The sums of a band go to the rows of the grid above and below it.
    let sums = tasks::map(bands, |_, (upper, mut rows)| {
        let mut sums = vec![F::ZERO; 2 * len];
        let band = PixelBand { inputs, grad, maps: &maps[upper * len..][..2 * len], size, columns: &columns };
        dispatch!(F, simd => band.backward(simd, &mut rows, needs.grid, &mut sums));
        (upper, sums)
    });
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
struct PixelBand<'a, F> {
    inputs: Sliced<&'a [F]>,
    grad: &'a [F],
    /// The maps of both rows, by row, then column, then level.
    maps: &'a [F],
    size: SliceSize,
    columns: &'a GridColumns<F>,
}

impl<F: Real> PixelBand<'_, F> {
    /// Writes the gradients of the rows' colours, where there is room for them, and if `sum` is set adds those of the maps to `sums`.
    #[inline(always)]
    fn backward<S: Simd>(&self, simd: S, rows: &mut [Row<F>], sum: bool, sums: &mut [F]) {
        let (width, levels, lanes) = (self.size.width, self.size.levels, block_len::<S, F>());
        // Number of entries of a column, and of a row of the grid.
        let (entries, row_len) = (levels * MAP, self.maps.len() / 2);
        let (mut maps, mut wide) = (vec![F::ZERO; 2 * entries * lanes], vec![F::ZERO; 2 * entries * lanes]);
        for from in (0..width).step_by(lanes) {
            let to = width.min(from + lanes);
            let (first, last) = self.columns.around(from, to);
            let x = load(simd, &self.columns.x[from..]);
            self.mix_columns(simd, x, first..=last, &mut maps);
            wide.fill(F::ZERO);
            let (mut low, mut high) = (levels - 1, 0);
            for (y, down, out) in rows.iter_mut() {
                let pixels = Pixels::new(simd, planes(self.inputs.image, self.size, *y), from, levels);
                let grad = load_rgb(simd, planes(self.grad, self.size, *y), from);
                (low, high) = (low.min(pixels.low), high.max(pixels.high));
                let of_colour = pixels.backward(&maps, levels, *down, grad, sum.then_some(&mut wide[..]));
                if let Some(out) = out {
                    for (channel, of_channel) in of_colour.into_iter().enumerate() {
                        store::<S, F>(of_channel, &mut out[channel][from..to]);
                    }
                }
            }
            if !sum || low > high {
                continue;
            }
            for column in first..=last {
                let across = share_of::<S, F>(x, column);
                for (row, wide) in wide.chunks_exact(entries * lanes).enumerate() {
                    let sums = &mut sums[row * row_len + column * entries..][..entries];
                    for i in low * MAP..(high + 1) * MAP {
                        sums[i] += (across * load::<S, F>(simd, &wide[i * lanes..][..lanes])).reduce_sum();
                    }
                }
            }
        }
    }

    /// Writes the maps of a vector of pixels in the upper row of the grid, by level and entry, a vector each, and then what the lower row
    /// adds to them. They are the same for every row of pixels.
    #[inline(always)]
    fn mix_columns<S: Simd>(&self, simd: S, x: F::Block<S>, columns: RangeInclusive<usize>, to: &mut [F]) {
        let (entries, lanes) = (self.size.levels * MAP, block_len::<S, F>());
        let (upper, lower) = self.maps.split_at(self.maps.len() / 2);
        let (of_upper, of_lower) = to.split_at_mut(entries * lanes);
        of_upper.fill(F::ZERO);
        of_lower.fill(F::ZERO);
        for column in columns {
            let across = share_of::<S, F>(x, column);
            let (upper, lower) = (&upper[column * entries..][..entries], &lower[column * entries..][..entries]);
            for (i, (&upper, &lower)) in upper.iter().zip(lower).enumerate() {
                for (to, value) in [(&mut *of_upper, upper), (&mut *of_lower, lower - upper)] {
                    let at = &mut to[i * lanes..][..lanes];
                    let sum = across.mul_add(splat::<S, F>(simd, value), F::Block::<S>::from_slice(simd, at));
                    sum.store_slice(at);
                }
            }
        }
    }
}

impl<S: Simd, F: Real> Pixels<S, F> {
    /// Returns the gradient of the colours from `grad`, that of the mapped colours. `maps` are those of [`PixelBand::mix_columns`], `down` the
    /// share of the lower row of the grid. Adds the gradients of the maps to `sums`, if it is given, in the same order.
    #[inline(always)]
    fn backward(
        &self,
        maps: &[F],
        levels: usize,
        down: F,
        grad: [F::Block<S>; 3],
        mut sums: Option<&mut [F]>,
    ) -> [F::Block<S>; 3] {
        let simd = self.z.token();
        let lanes = block_len::<S, F>();
        let (zero, one) = (splat::<S, F>(simd, F::ZERO), splat::<S, F>(simd, F::ONE));
        let down = splat::<S, F>(simd, down);
        let [r, g, b] = self.colour;
        let (upper, lower) = maps.split_at(maps.len() / 2);
        let (mut direct, mut along) = ([zero; 3], zero);
        for level in self.low..=self.high {
            let away = self.z - splat::<S, F>(simd, F::of(level as f64));
            let weight = hat::<S, F>(away, zero, one);
            // The slope of the hat towards larger lumas.
            let falls = away.simd_ge(zero) & away.simd_lt(one);
            let rises = away.simd_lt(zero) & away.simd_ge(-one);
            let slope = falls.select(-one, rises.select(one, zero));
            let place = level * MAP * lanes;
            let (upper, lower) = (&upper[place..][..MAP * lanes], &lower[place..][..MAP * lanes]);
            // Mᵀ g and the gradient of the offset's weight.
            let mut back = [zero; 4];
            for (row, grad) in grad.into_iter().enumerate() {
                for (entry, back) in back.iter_mut().enumerate() {
                    let at = (4 * row + entry) * lanes;
                    let upper = F::Block::<S>::from_slice(simd, &upper[at..][..lanes]);
                    let lower = F::Block::<S>::from_slice(simd, &lower[at..][..lanes]);
                    *back = grad.mul_add(lower.mul_add(down, upper), *back);
                }
            }
            for (direct, back) in direct.iter_mut().zip(back) {
                *direct = weight.mul_add(back, *direct);
            }
            let of_weight = r.mul_add(back[0], g.mul_add(back[1], b.mul_add(back[2], back[3])));
            along = slope.mul_add(of_weight, along);
            let Some(sums) = &mut sums else { continue };
            let (of_upper, of_lower) = sums.split_at_mut(levels * MAP * lanes);
            let lower = weight * down;
            for (sums, weight) in [(of_upper, weight - lower), (of_lower, lower)] {
                let sums = &mut sums[place..][..MAP * lanes];
                for (row, grad) in grad.into_iter().enumerate() {
                    let grad = weight * grad;
                    for (entry, value) in [r, g, b, one].into_iter().enumerate() {
                        let at = &mut sums[(4 * row + entry) * lanes..][..lanes];
                        value.mul_add(grad, F::Block::<S>::from_slice(simd, at)).store_slice(at);
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
