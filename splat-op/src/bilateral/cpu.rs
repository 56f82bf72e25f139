//! CPU twin of the slice, parallel over rows of pixels. The two rows of the grid around a row of pixels are interpolated once. A vector of
//! pixels then visits the corners that any of its pixels has, two or three columns and as few levels; a corner's weight in a pixel is a
//! product of hat functions, which vanish where the pixel has other corners.
//!
//! The gradient of the grid is summed by cells, the parts of a row between two columns of the grid. One vector holds the weights of a pixel
//! on both columns and on all levels, so that the twelve sums of a cell stay in registers. They go to both rows of the grid around
//! the pixels, and the bands between two such rows are added in their order.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::{LUMA, MAP, SliceSize, Sliced};
use crate::simd::blocks::{block_len, load, splat, store};
use crate::simd::real::Real;

/// Number of pixels whose products are stored side by side: a vector of f32, or two of f64.
const BLOCK: usize = 16;

/// `max(0, 1 − |distance|)`: the weight of a corner in linear interpolation.
#[inline(always)]
fn hat<S: Simd, F: Real>(distance: F::Block<S>) -> F::Block<S> {
    let simd = distance.token();
    (splat::<S, F>(simd, F::ONE) - distance.abs()).max(splat::<S, F>(simd, F::ZERO))
}

/// Places of pixels on an axis of the grid, from 0 to one less than the number of corners.
fn places<F: Real>(pixels: usize, corners: usize) -> Vec<F> {
    let at = |pixel: usize| (pixel as f64 + 0.5) / pixels as f64 * (corners - 1) as f64;
    (0..pixels).map(|pixel| F::of(at(pixel))).collect()
}

/// The corner below a place.
#[inline(always)]
fn below<F: Real>(at: F, corners: usize) -> usize {
    at.index().min(corners - 2)
}

/// A grid with the entries of a map side by side: by row, then column, then level.
struct Maps<F> {
    maps: Vec<[F; MAP]>,
    size: SliceSize,
}

impl<F: Real> Maps<F> {
    fn new(grid: &[F], size: SliceSize) -> Self {
        let mut maps = vec![[F::ZERO; MAP]; grid.len() / MAP];
        for (entry, plane) in grid.chunks_exact(maps.len().max(1)).enumerate() {
            for (index, value) in plane.iter().enumerate() {
                let (level, place) = (index / (size.rows * size.columns), index % (size.rows * size.columns));
                maps[place * size.levels + level][entry] = *value;
            }
        }
        Self { maps, size }
    }

    /// Room for the maps of a row of pixels.
    fn room(&self) -> Vec<[F; MAP]> {
        vec![[F::ZERO; MAP]; self.size.columns * self.size.levels]
    }

    /// Writes the maps at a place between two rows to `row`, by column, then level.
    #[inline(always)]
    fn row(&self, at: F, row: &mut [[F; MAP]]) {
        let (len, below) = (row.len(), below(at, self.size.rows));
        let share = at - F::of(below as f64);
        let (upper, lower) = self.maps[below * len..][..2 * len].split_at(len);
        let pairs = upper.as_flattened().iter().zip(lower.as_flattened());
        for (to, (&upper, &lower)) in row.as_flattened_mut().iter_mut().zip(pairs) {
            *to = upper + share * (lower - upper);
        }
    }
}

/// A vector of pixels: what decides their maps.
struct Pixels<S: Simd, F: Real> {
    colour: [F::Block<S>; 3],
    /// Places among columns and levels.
    column: F::Block<S>,
    level: F::Block<S>,
    /// Where the luma is within its limits, so that the level depends on it.
    free: <F::Block<S> as SimdBase<S>>::Mask,
    /// Corners that any of the pixels has.
    columns: Range<usize>,
    levels: Range<usize>,
}

impl<S: Simd, F: Real> Pixels<S, F> {
    /// The pixels from `x` on. `across` are the places of a row's pixels among the columns.
    #[inline(always)]
    fn new(simd: S, size: SliceSize, across: &[F], [r, g, b]: [&[F]; 3], x: usize) -> Self {
        let end = across.len().min(x + block_len::<S, F>());
        let colour = [load(simd, &r[x..end]), load(simd, &g[x..end]), load(simd, &b[x..end])];
        let [of_r, of_g, of_b] = LUMA.map(|weight| splat(simd, F::of(weight)));
        let luma = colour[0].mul_add(of_r, colour[1].mul_add(of_g, colour[2] * of_b));
        let (zero, one) = (splat(simd, F::ZERO), splat(simd, F::ONE));
        // A luma that is not a number has the lowest level.
        let level = luma.max_precise(zero).min(one) * splat(simd, F::of((size.levels - 1) as f64));
        let (lowest, highest) = (level.reduce_min(), level.reduce_max());
        Self {
            colour,
            column: load(simd, &across[x..end]),
            level,
            free: luma.simd_gt(zero) & luma.simd_lt(one),
            columns: below(across[x], size.columns)..below(across[end - 1], size.columns) + 2,
            levels: below(lowest, size.levels)..below(highest, size.levels) + 2,
        }
    }

    /// Distances from a column.
    #[inline(always)]
    fn from_column(&self, column: usize) -> F::Block<S> {
        self.column - splat(self.column.token(), F::of(column as f64))
    }

    /// Distances from a level.
    #[inline(always)]
    fn from_level(&self, level: usize) -> F::Block<S> {
        self.level - splat(self.level.token(), F::of(level as f64))
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
    let maps = Maps::new(inputs.grid, size);
    let (across, down) = (places(size.width, size.columns), places::<F>(size.height, size.rows));
    let rows = planes_mut(&mut out, size).into_par_iter().zip(down).enumerate();
    rows.for_each_init(
        || maps.room(),
        |row, (y, (out, down))| {
            let image = planes(inputs.image, size, y);
            dispatch!(Level::new(), simd => {
                maps.row(down, row);
                row_forward(simd, row, size, (image, &across), out);
            });
        },
    );
    out
}

/// Maps a row of pixels.
#[inline(always)]
fn row_forward<S: Simd, F: Real>(
    simd: S,
    row: &[[F; MAP]],
    size: SliceSize,
    (image, across): ([&[F]; 3], &[F]),
    mut out: [&mut [F]; 3],
) {
    for x in (0..across.len()).step_by(block_len::<S, F>()) {
        let pixels = Pixels::<S, F>::new(simd, size, across, image, x);
        let [r, g, b] = pixels.colour;
        let mut shown = [splat(simd, F::ZERO); 3];
        for column in pixels.columns.clone() {
            let of_column = hat::<S, F>(pixels.from_column(column));
            for level in pixels.levels.clone() {
                let weight = of_column * hat::<S, F>(pixels.from_level(level));
                let map = row[column * size.levels + level].map(|entry| splat(simd, entry));
                for channel in 0..3 {
                    let [of_r, of_g, of_b, offset] = [0, 1, 2, 3].map(|entry| map[4 * channel + entry]);
                    let value = r.mul_add(of_r, g.mul_add(of_g, b.mul_add(of_b, offset)));
                    shown[channel] = value.mul_add(weight, shown[channel]);
                }
            }
        }
        for (shown, out) in shown.into_iter().zip(&mut out) {
            store::<S, F>(shown, &mut out[x..]);
        }
    }
}

/// Sums over the pixels of a cell, for each entry of a map: the first half of the vector belongs to the left column and the second to the
/// right one, each with as many levels.
type CellSums<F> = [[F; BLOCK]; MAP];

/// What the sums over a row of pixels need of each of them.
struct RowProducts<F> {
    /// Places among levels.
    levels: Vec<F>,
    /// `∂M` by blocks of pixels.
    products: Vec<[[F; BLOCK]; MAP]>,
}

/// The cells of a row: pixels by the column of the grid to their left.
fn cells<F: Real>(across: &[F], columns: usize) -> Vec<Range<usize>> {
    let first = |cell: usize| across.partition_point(|&at| below(at, columns) < cell);
    (0..columns - 1).map(|cell| first(cell)..first(cell + 1)).collect()
}

/// A row of pixels: its number, its place in the grid, and room for the gradient of its planes if that is needed.
type Row<'a, F> = (usize, F, Option<[&'a mut [F]; 3]>);

/// Returns the gradients of picture and grid from `grad`, that of the mapped picture. The one of the picture is empty if it is
/// not needed.
pub(crate) fn slice_backward_cpu<F: Real>(
    inputs: Sliced<&[F]>,
    grad: &[F],
    size: SliceSize,
    needs: Sliced<bool>,
) -> Sliced<Vec<F>> {
    let mut of_image = vec![F::ZERO; if needs.image { inputs.image.len() } else { 0 }];
    let maps = Maps::new(inputs.grid, size);
    let (across, down) = (places(size.width, size.columns), places::<F>(size.height, size.rows));
    let cells = cells(&across, size.columns);
    let mut of_rows = planes_mut(&mut of_image, size).into_iter();
    let mut bands: Vec<(usize, Vec<Row<F>>)> = (0..size.rows - 1).map(|below| (below, Vec::new())).collect();
    for (y, down) in down.into_iter().enumerate() {
        bands[below(down, size.rows)].1.push((y, down, of_rows.next()));
    }
    // The sums of a band of rows go to the rows of the grid above and below it.
    let band_sums = |(below, band): (usize, Vec<Row<F>>)| {
        let blocks = size.width.div_ceil(BLOCK);
        let mut of_row =
            RowProducts { levels: vec![F::ZERO; blocks * BLOCK], products: vec![[[F::ZERO; BLOCK]; MAP]; blocks] };
        let mut sums = [(); 2].map(|()| vec![[[F::ZERO; BLOCK]; MAP]; parts(size) * cells.len()]);
        let mut row = maps.room();
        for (y, down, of_image) in band {
            let pixels = (planes(inputs.image, size, y), planes(grad, size, y));
            let share = down - F::of(below as f64);
            dispatch!(Level::new(), simd => {
                maps.row(down, &mut row);
                row_backward(simd, &row, size, (pixels, &across), of_image, &mut of_row);
                if needs.grid {
                    add_row(simd, size, (&of_row, &across), &cells, ([F::ONE - share, share], &mut sums));
                }
            });
        }
        (below, sums)
    };
    let sums: Vec<(usize, [Vec<CellSums<F>>; 2])> = bands.into_par_iter().map(band_sums).collect();
    let mut of_grid = vec![F::ZERO; if needs.grid { inputs.grid.len() } else { 0 }];
    if needs.grid {
        for (below, sums) in sums {
            for (row, sums) in sums.iter().enumerate() {
                add_to_grid(&mut of_grid, size, below + row, sums);
            }
        }
    }
    Sliced { image: of_image, grid: of_grid }
}

/// Number of levels whose sums one [`CellSums`] holds.
const LEVELS: usize = BLOCK / 2;

/// Number of [`CellSums`] of a cell.
fn parts(size: SliceSize) -> usize {
    size.levels.div_ceil(LEVELS)
}

/// Adds the sums of a row's cells, by cell, then part, to a row of the grid's gradient.
fn add_to_grid<F: Real>(of_grid: &mut [F], size: SliceSize, row: usize, sums: &[CellSums<F>]) {
    let plane = size.rows * size.columns;
    for (index, sums) in sums.iter().enumerate() {
        let (cell, first) = (index / parts(size), index % parts(size) * LEVELS);
        for (entry, sums) in sums.iter().enumerate() {
            for (side, sums) in sums.chunks_exact(LEVELS).enumerate() {
                for (level, &sum) in (first..size.levels).zip(sums) {
                    let place = row * size.columns + cell + side;
                    of_grid[(entry * size.levels + level) * plane + place] += sum;
                }
            }
        }
    }
}

/// Writes the gradient of a row's colours to `of_image` if it is needed, and the gradients of its maps to `of_row`. The pair holds the
/// planes of the row and of the mapped row's gradient.
#[inline(always)]
fn row_backward<S: Simd, F: Real>(
    simd: S,
    row: &[[F; MAP]],
    size: SliceSize,
    ((image, grads), across): (([&[F]; 3], [&[F]; 3]), &[F]),
    mut of_image: Option<[&mut [F]; 3]>,
    of_row: &mut RowProducts<F>,
) {
    let zero = splat(simd, F::ZERO);
    for x in (0..across.len()).step_by(block_len::<S, F>()) {
        let pixels = Pixels::<S, F>::new(simd, size, across, image, x);
        let [r, g, b] = pixels.colour;
        let grad = [load(simd, &grads[0][x..]), load(simd, &grads[1][x..]), load(simd, &grads[2][x..])];
        store::<S, F>(pixels.level, &mut of_row.levels[x..]);
        let products = &mut of_row.products[x / BLOCK];
        for (channel, &grad) in grad.iter().enumerate() {
            for (entry, product) in [grad * r, grad * g, grad * b, grad].into_iter().enumerate() {
                store::<S, F>(product, &mut products[4 * channel + entry][x % BLOCK..]);
            }
        }
        let Some(out) = &mut of_image else { continue };
        let (mut direct, mut along) = ([zero; 3], zero);
        for column in pixels.columns.clone() {
            let of_column = hat::<S, F>(pixels.from_column(column));
            for level in pixels.levels.clone() {
                let above = pixels.from_level(level);
                let weight = of_column * hat::<S, F>(above);
                // The hat's derivative: falling from its level up to the next one, rising from the one below.
                let near = above.simd_lt(splat(simd, F::ONE)) & above.simd_ge(splat(simd, -F::ONE));
                let slope = near.select(above.simd_lt(zero).select(of_column, -of_column), zero);
                let map = row[column * size.levels + level].map(|entry| splat(simd, entry));
                // Mᵀ g, with the offsets last.
                let mut back = [zero; 4];
                for (entry, back) in back.iter_mut().enumerate() {
                    let rest = grad[1].mul_add(map[4 + entry], grad[2] * map[8 + entry]);
                    *back = grad[0].mul_add(map[entry], rest);
                }
                for (direct, back) in direct.iter_mut().zip(back) {
                    *direct = back.mul_add(weight, *direct);
                }
                let change = r.mul_add(back[0], g.mul_add(back[1], b.mul_add(back[2], back[3])));
                along = change.mul_add(slope, along);
            }
        }
        let of_luma = pixels.free.select(along * splat(simd, F::of((size.levels - 1) as f64)), zero);
        for (channel, out) in out.iter_mut().enumerate() {
            let weight = splat(simd, F::of(LUMA[channel]));
            store::<S, F>(of_luma.mul_add(weight, direct[channel]), &mut out[x..]);
        }
    }
}

/// Adds the sums over the cells of a row, times `shares`, to those of the two rows of the grid around it.
#[inline(always)]
fn add_row<S: Simd, F: Real>(
    simd: S,
    size: SliceSize,
    (of_row, across): (&RowProducts<F>, &[F]),
    cells: &[Range<usize>],
    (shares, sums): ([F; 2], &mut [Vec<CellSums<F>>; 2]),
) {
    let parts = parts(size);
    for part in 0..parts {
        // A vector has both columns, or one of them in f64.
        for first in (0..BLOCK).step_by(block_len::<S, F>()) {
            let sides = F::Block::<S>::from_fn(simd, |lane| F::of(((first + lane) / LEVELS) as f64));
            let level = F::Block::<S>::from_fn(simd, |lane| F::of((part * LEVELS + (first + lane) % LEVELS) as f64));
            for (cell, pixels) in cells.iter().enumerate() {
                let column = sides + splat(simd, F::of(cell as f64));
                let mut of_cell = [splat(simd, F::ZERO); MAP];
                for x in pixels.clone() {
                    let of_column = hat::<S, F>(splat(simd, across[x]) - column);
                    let weight = of_column * hat::<S, F>(splat(simd, of_row.levels[x]) - level);
                    let products = &of_row.products[x / BLOCK];
                    for (sum, products) in of_cell.iter_mut().zip(products) {
                        *sum = splat(simd, products[x % BLOCK]).mul_add(weight, *sum);
                    }
                }
                for (share, sums) in shares.into_iter().zip(sums.iter_mut()) {
                    let share = splat(simd, share);
                    for (to, &sum) in sums[cell * parts + part].iter_mut().zip(&of_cell) {
                        let to = &mut to[first..first + block_len::<S, F>()];
                        sum.mul_add(share, F::Block::<S>::from_slice(simd, to)).store_slice(to);
                    }
                }
            }
        }
    }
}
