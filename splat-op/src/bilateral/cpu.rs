//! CPU twin of the slice, parallel over rows of pixels; the gradient of the grid is summed over the pixels of a row, then over the
//! rows between two rows of the grid, then over both sides of a row.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::{LUMA, MAP, SliceSize, Sliced};
use crate::simd::real::Real;

/// Length of a map in memory, that of a vector of f32.
const WIDE: usize = 16;

/// An affine colour map, or its gradient; the last entries are zero.
type Map<F> = [F; WIDE];

/// A map in one vector of f32, or in two of f64.
#[derive(Clone, Copy)]
struct WideMap<S: Simd, F: Real>([F::Block<S>; 2]);

impl<S: Simd, F: Real> WideMap<S, F> {
    const LEN: usize = <F::Block<S> as SimdBase<S>>::LEN;

    #[inline(always)]
    fn load(simd: S, map: &Map<F>) -> Self {
        let part = |i: usize| F::Block::<S>::from_slice(simd, &map[i * Self::LEN..(i + 1) * Self::LEN]);
        let first = part(0);
        Self([first, if Self::LEN < WIDE { part(1) } else { first }])
    }

    #[inline(always)]
    fn store(self, map: &mut Map<F>) {
        for (part, to) in self.0.into_iter().zip(map.chunks_exact_mut(Self::LEN)) {
            part.store_slice(to);
        }
    }

    /// `self + share (to − self)`
    #[inline(always)]
    fn mixed(self, to: Self, share: F::Block<S>) -> Self {
        let part = |i: usize| (to.0[i] - self.0[i]).mul_add(share, self.0[i]);
        let first = part(0);
        Self([first, if Self::LEN < WIDE { part(1) } else { first }])
    }

    /// `to += weight self`
    #[inline(always)]
    fn add_to(self, to: &mut Map<F>, weight: F::Block<S>) {
        let simd = weight.token();
        for (part, to) in self.0.into_iter().zip(to.chunks_exact_mut(Self::LEN)) {
            part.mul_add(weight, F::Block::<S>::from_slice(simd, to)).store_slice(to);
        }
    }
}

#[inline(always)]
fn splat<S: Simd, F: Real>(simd: S, value: F) -> F::Block<S> {
    F::Block::<S>::splat(simd, value)
}

/// A place between two neighbours on an axis of the grid.
#[derive(Clone, Copy)]
struct Between<F> {
    below: usize,
    /// Weight of the upper neighbour.
    share: F,
}

impl<F: Real> Between<F> {
    /// `at` counts from the first of `count` places.
    #[inline(always)]
    fn new(at: F, count: usize) -> Self {
        let below = at.index().min(count - 2);
        Self { below, share: at - F::of(below as f64) }
    }

    /// The places of the centres of `pixels` pixels.
    fn all(pixels: usize, count: usize) -> Vec<Self> {
        let at = |pixel: usize| (pixel as f64 + 0.5) / pixels as f64 * (count - 1) as f64;
        (0..pixels).map(|pixel| Self::new(F::of(at(pixel)), count)).collect()
    }
}

/// A grid with the entries of a map side by side: by row, then column, then level.
struct Maps<F> {
    maps: Vec<Map<F>>,
    size: SliceSize,
}

impl<F: Real> Maps<F> {
    fn new(grid: &[F], size: SliceSize) -> Self {
        let mut maps = vec![[F::ZERO; WIDE]; grid.len() / MAP];
        for (entry, plane) in grid.chunks_exact(maps.len().max(1)).enumerate() {
            for (index, value) in plane.iter().enumerate() {
                let (level, place) = (index / (size.rows * size.columns), index % (size.rows * size.columns));
                maps[place * size.levels + level][entry] = *value;
            }
        }
        Self { maps, size }
    }

    /// Writes the maps at a place between two rows to `row`, by column, then level.
    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, at: Between<F>, row: &mut [Map<F>]) {
        let len = self.size.columns * self.size.levels;
        let (upper, lower) = self.maps[at.below * len..][..2 * len].split_at(len);
        let share = splat(simd, at.share);
        for (to, (upper, lower)) in row.iter_mut().zip(upper.iter().zip(lower)) {
            WideMap::load(simd, upper).mixed(WideMap::load(simd, lower), share).store(to);
        }
    }
}

/// The maps of a pixel on the levels below and above it, and the place that decides both.
struct Pixel<S: Simd, F: Real> {
    below: WideMap<S, F>,
    above: WideMap<S, F>,
    level: Between<F>,
    /// Whether the luma is within its limits, so that the place depends on it.
    free: bool,
}

impl<S: Simd, F: Real> Pixel<S, F> {
    /// `row` holds the maps of the pixel's row of the picture, by column, then level.
    #[inline(always)]
    fn new(simd: S, row: &[Map<F>], levels: usize, column: Between<F>, colour: [F; 3]) -> Self {
        let luma = F::of(LUMA[0]) * colour[0] + F::of(LUMA[1]) * colour[1] + F::of(LUMA[2]) * colour[2];
        let level = Between::new(luma.within(F::ZERO, F::ONE) * F::of((levels - 1) as f64), levels);
        let first = column.below * levels + level.below;
        let share = splat(simd, column.share);
        let at = |index: usize| WideMap::load(simd, &row[index]);
        let below = at(first).mixed(at(first + levels), share);
        let above = at(first + 1).mixed(at(first + levels + 1), share);
        Self { below, above, level, free: luma > F::ZERO && luma < F::ONE }
    }

    /// The pixel's map.
    #[inline(always)]
    fn map(&self, simd: S) -> Map<F> {
        let mut map = [F::ZERO; WIDE];
        self.below.mixed(self.above, splat(simd, self.level.share)).store(&mut map);
        map
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
    let (across, down) = (Between::all(size.width, size.columns), Between::all(size.height, size.rows));
    planes_mut(&mut out, size).into_par_iter().zip(down).enumerate().for_each_init(
        || vec![[F::ZERO; WIDE]; size.columns * size.levels],
        |row, (y, (out, down))| {
            let image = planes(inputs.image, size, y);
            dispatch!(Level::new(), simd => {
                maps.row(simd, down, row);
                row_forward(simd, row, size.levels, (image, &across), out);
            });
        },
    );
    out
}

/// Maps a row of pixels.
#[inline(always)]
fn row_forward<S: Simd, F: Real>(
    simd: S,
    row: &[Map<F>],
    levels: usize,
    ([r, g, b], across): ([&[F]; 3], &[Between<F>]),
    out: [&mut [F]; 3],
) {
    for (x, &column) in across.iter().enumerate() {
        let colour = [r[x], g[x], b[x]];
        let map = Pixel::new(simd, row, levels, column, colour).map(simd);
        for (channel, row) in map.as_chunks::<4>().0[..3].iter().enumerate() {
            out[channel][x] = row[3] + row[0] * colour[0] + row[1] * colour[1] + row[2] * colour[2];
        }
    }
}

/// A row of pixels: its number, its place in the grid, and room for the gradient of its planes if that is needed.
type Row<'a, F> = (usize, Between<F>, Option<[&'a mut [F]; 3]>);

/// Returns the gradients of picture and grid from `grad`, that of the mapped picture. The one of the picture is empty if it is
/// not needed.
pub(crate) fn slice_backward_cpu<F: Real>(
    inputs: Sliced<&[F]>,
    grad: &[F],
    size: SliceSize,
    needs: Sliced<bool>,
) -> Sliced<Vec<F>> {
    let mut of_image = vec![F::ZERO; if needs.image { inputs.image.len() } else { 0 }];
    let mut of_grid = vec![F::ZERO; inputs.grid.len()];
    let maps = Maps::new(inputs.grid, size);
    let (across, down) = (Between::all(size.width, size.columns), Between::all(size.height, size.rows));
    let len = size.columns * size.levels;
    let mut of_rows = planes_mut(&mut of_image, size).into_iter();
    let mut bands: Vec<(usize, Vec<Row<F>>)> = (0..size.rows - 1).map(|below| (below, Vec::new())).collect();
    for (y, down) in down.into_iter().enumerate() {
        bands[down.below].1.push((y, down, of_rows.next()));
    }
    // The sums of a band of rows go to the rows of the grid above and below it.
    let band_sums = |(below, band): (usize, Vec<Row<F>>)| {
        let mut sums = vec![[F::ZERO; WIDE]; 2 * len];
        let (mut row, mut row_sums) = (vec![[F::ZERO; WIDE]; len], vec![[F::ZERO; WIDE]; len]);
        for (y, down, of_image) in band {
            let pixels = (planes(inputs.image, size, y), planes(grad, size, y));
            dispatch!(Level::new(), simd => {
                maps.row(simd, down, &mut row);
                row_sums.fill([F::ZERO; WIDE]);
                row_backward(simd, (&row, &mut row_sums), size.levels, &across, pixels, of_image);
                let (upper, lower) = sums.split_at_mut(len);
                let shares = [F::ONE - down.share, down.share].map(|share| splat(simd, share));
                for ((sum, upper), lower) in row_sums.iter().zip(upper).zip(lower) {
                    WideMap::load(simd, sum).add_to(upper, shares[0]);
                    WideMap::load(simd, sum).add_to(lower, shares[1]);
                }
            });
        }
        (below, sums)
    };
    let sums: Vec<(usize, Vec<Map<F>>)> = bands.into_par_iter().map(band_sums).collect();
    let mut total = vec![[F::ZERO; WIDE]; maps.maps.len()];
    for (below, sums) in sums {
        let total = total[below * len..][..2 * len].as_flattened_mut();
        total.iter_mut().zip(sums.as_flattened()).for_each(|(total, sum)| *total += *sum);
    }
    for (index, map) in total.iter().enumerate() {
        let (place, level) = (index / size.levels, index % size.levels);
        for (entry, value) in map[..MAP].iter().enumerate() {
            of_grid[entry * total.len() + level * size.rows * size.columns + place] = *value;
        }
    }
    Sliced { image: of_image, grid: of_grid }
}

/// Adds the gradients of a row of pixels to those of its maps, and writes that of its colours to `of_image` if it is needed.
/// `across` are the places of the pixels; the pair holds the planes of the row and of the mapped row's gradient.
#[inline(always)]
fn row_backward<S: Simd, F: Real>(
    simd: S,
    (row, sums): (&[Map<F>], &mut [Map<F>]),
    levels: usize,
    across: &[Between<F>],
    ([r, g, b], grads): ([&[F]; 3], [&[F]; 3]),
    mut of_image: Option<[&mut [F]; 3]>,
) {
    for (x, &column) in across.iter().enumerate() {
        let (colour, grad) = ([r[x], g[x], b[x]], [grads[0][x], grads[1][x], grads[2][x]]);
        let pixel = Pixel::new(simd, row, levels, column, colour);
        let level = pixel.level;
        let mut of_map = [F::ZERO; WIDE];
        for (of_row, grad) in of_map.as_chunks_mut::<4>().0.iter_mut().zip(grad) {
            *of_row = [grad * colour[0], grad * colour[1], grad * colour[2], grad];
        }
        let of_map = WideMap::load(simd, &of_map);
        let first = column.below * levels + level.below;
        for (corner, weight) in [(first, F::ONE - column.share), (first + levels, column.share)] {
            of_map.add_to(&mut sums[corner], splat(simd, weight * (F::ONE - level.share)));
            of_map.add_to(&mut sums[corner + 1], splat(simd, weight * level.share));
        }
        if let Some(out) = &mut of_image {
            let along = |i: usize| (of_map.0[i] * (pixel.above.0[i] - pixel.below.0[i])).reduce_sum();
            let along = if WideMap::<S, F>::LEN < WIDE { along(0) + along(1) } else { along(0) };
            let of_luma = if pixel.free { along * F::of((levels - 1) as f64) } else { F::ZERO };
            let map = pixel.map(simd);
            for (from, out) in out.iter_mut().enumerate() {
                let direct = map[from] * grad[0] + map[4 + from] * grad[1] + map[8 + from] * grad[2];
                out[x] = direct + F::of(LUMA[from]) * of_luma;
            }
        }
    }
}
