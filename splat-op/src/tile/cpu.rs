//! The CPU twin of `tile`: a depth sort of the visible Gaussians, then a stable counting sort of their hits by tile.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use super::{HitLists, TILE, tile_grid};
use crate::camera::Intrinsics;
use crate::project::{COLUMNS, Ellipse};
use crate::real::Real;

/// Visible Gaussians per task.
const CHUNK: usize = 2048;

/// The hits of consecutive visible Gaussians, in the order in which they are found. Counting and writing both read this
/// one result, so they cannot disagree.
#[derive(Default)]
struct Emission {
    /// Hits of each Gaussian.
    counts: Vec<u32>,
    /// Tile of each hit.
    tiles: Vec<u32>,
}

/// Computes the lists of a view from its `[N, 7]` packed ellipses.
pub(crate) fn tile_cpu<F: Real>(packed: &[F], camera: &Intrinsics, alpha_min: f64) -> HitLists {
    let grid = tile_grid(camera.width, camera.height);
    let reach = Reach { camera, grid, alpha_min: F::of(alpha_min) };
    let visible = depth_order(packed, &reach);
    let emissions: Vec<Emission> = visible.par_chunks(CHUNK).map(|chunk| emit(packed, chunk, &reach)).collect();
    let (tile_start, mut cursors) = offsets(&emissions, grid[0] * grid[1]);

    let hits = tile_start[tile_start.len() - 1];
    assert!(u32::try_from(hits).is_ok(), "{hits} hits: more than 2^32; raise `alpha_min` or render a smaller picture");
    // Each place is written once, by whichever thread holds its Gaussian.
    let gaussian: Vec<AtomicU32> = (0..hits).map(|_| AtomicU32::new(0)).collect();
    let places: Vec<Vec<u32>> = emissions
        .par_iter()
        .zip(cursors.par_iter_mut())
        .zip(visible.par_chunks(CHUNK))
        .map(|((emission, cursor), chunk)| {
            let mut places = Vec::with_capacity(emission.tiles.len());
            let mut tiles = emission.tiles.iter();
            for (&id, &count) in chunk.iter().zip(&emission.counts) {
                for &tile in tiles.by_ref().take(count as usize) {
                    let place = &mut cursor[tile as usize];
                    gaussian[*place as usize].store(id, Ordering::Relaxed);
                    places.push(*place);
                    *place += 1;
                }
            }
            places
        })
        .collect();

    let mut visible_start = Vec::with_capacity(visible.len() + 1);
    visible_start.push(0);
    let mut end = 0;
    for count in emissions.iter().flat_map(|e| &e.counts) {
        end += *count as usize;
        visible_start.push(end);
    }
    HitLists {
        tile_start,
        gaussian: gaussian.into_iter().map(AtomicU32::into_inner).collect(),
        visible,
        visible_start,
        hit_of_visible: places.concat(),
    }
}

/// Indices of the Gaussians that can show in the picture, by depth, then by index.
fn depth_order<F: Real>(packed: &[F], reach: &Reach<F>) -> Vec<u32> {
    let mut keys: Vec<(F::SortKey, u32)> = packed
        .par_chunks_exact(COLUMNS)
        .enumerate()
        .filter_map(|(i, row)| {
            let ellipse = Ellipse::from_row(row);
            reach.tiles(&ellipse).map(|_| (ellipse.depth.sort_key(), i as u32))
        })
        .collect();
    keys.par_sort_unstable();
    keys.into_iter().map(|(_, i)| i).collect()
}

fn emit<F: Real>(packed: &[F], chunk: &[u32], reach: &Reach<F>) -> Emission {
    let mut emission = Emission { counts: Vec::with_capacity(chunk.len()), tiles: Vec::with_capacity(4 * chunk.len()) };
    for &i in chunk {
        let ellipse = Ellipse::from_row(&packed[i as usize * COLUMNS..]);
        let before = emission.tiles.len();
        if let Some(area) = reach.tiles(&ellipse) {
            area.emit(&ellipse, reach, &mut emission.tiles);
        }
        emission.counts.push((emission.tiles.len() - before) as u32);
    }
    emission
}

/// Where each tile's hits begin, and for each emission where its first hit in each tile goes.
fn offsets(emissions: &[Emission], tiles: usize) -> (Vec<usize>, Vec<Vec<u32>>) {
    let mut cursors: Vec<Vec<u32>> = emissions
        .par_iter()
        .map(|emission| {
            let mut counts = vec![0; tiles];
            emission.tiles.iter().for_each(|&tile| counts[tile as usize] += 1);
            counts
        })
        .collect();
    let mut tile_start = Vec::with_capacity(tiles + 1);
    let mut next = 0_usize;
    for tile in 0..tiles {
        tile_start.push(next);
        for cursor in &mut cursors {
            let count = cursor[tile];
            cursor[tile] = next as u32;
            next += count as usize;
        }
    }
    tile_start.push(next);
    (tile_start, cursors)
}

/// What decides how far a Gaussian reaches.
struct Reach<'a, F> {
    camera: &'a Intrinsics,
    grid: [usize; 2],
    alpha_min: F,
}

/// The tiles of a Gaussian's bounding box, and the largest `u² + v²` that can show.
struct Area<F> {
    x: std::ops::Range<usize>,
    y: std::ops::Range<usize>,
    limit: F,
}

/// The largest `u² + v²` at which a Gaussian's alpha reaches `alpha_min`; negative if none does.
#[inline(always)]
pub(crate) fn whitened_limit<F: Real>(opacity: F, alpha_min: F) -> F {
    if alpha_min > F::ZERO { F::of(2.0) * (opacity / alpha_min).ln() } else { F::MAX }
}

/// Half the width and height of the box around `u² + v² <= limit`, px.
#[inline(always)]
pub(crate) fn half_extent<F: Real>(ellipse: &Ellipse<F>, limit: F) -> [F; 2] {
    let reach = limit.sqrt();
    let across = ellipse.shear * ellipse.sigma_u;
    let vertical = crate::linalg::norm([ellipse.sigma_v, across, F::ZERO]);
    [reach * ellipse.sigma_u, reach * vertical]
}

impl<F: Real> Reach<'_, F> {
    /// `None` for a Gaussian that cannot show in the picture.
    fn tiles(&self, ellipse: &Ellipse<F>) -> Option<Area<F>> {
        let shows = ellipse.depth > F::ZERO && ellipse.opacity > F::ZERO && ellipse.opacity >= self.alpha_min;
        let finite = ellipse.to_row().iter().all(|value| value.finite());
        if !(shows && finite) {
            return None;
        }
        let exact = whitened_limit(ellipse.opacity, self.alpha_min);
        // A relative margin for the logarithm, an absolute one for the exponential.
        let limit = exact * F::of(1.0 + 1e-5) + F::of(1e-4);
        let [half_x, half_y] = half_extent(ellipse, limit);
        let x = tile_range(ellipse.mean_px[0], half_x, self.camera.width, self.grid[0])?;
        let y = tile_range(ellipse.mean_px[1], half_y, self.camera.height, self.grid[1])?;
        Some(Area { x, y, limit })
    }
}

/// The tiles that hold a pixel centre within `half` of `mean`.
fn tile_range<F: Real>(mean: F, half: F, pixels: usize, tiles: usize) -> Option<std::ops::Range<usize>> {
    // The margin covers the rounding of centre and extent.
    let margin = F::of(0.01) + F::of(8.0) * F::EPSILON * (mean.abs() + half);
    let (low, high) = (mean - half - F::of(0.5) - margin, mean + half - F::of(0.5) + margin);
    if !(high >= F::ZERO && low <= F::of((pixels - 1) as f64)) {
        return None;
    }
    let pixel = |position: F| position.within(F::ZERO, F::of((pixels - 1) as f64)).f64() as usize;
    Some(pixel(low) / TILE..(pixel(high) / TILE + 1).min(tiles))
}

impl<F: Real> Area<F> {
    fn emit(&self, ellipse: &Ellipse<F>, reach: &Reach<F>, tiles: &mut Vec<u32>) {
        let single = self.x.len() == 1 && self.y.len() == 1;
        for y in self.y.clone() {
            for x in self.x.clone() {
                if single || self.meets(ellipse, reach, x, y) {
                    tiles.push((y * reach.grid[0] + x) as u32);
                }
            }
        }
    }

    /// Whether the ellipse reaches the rectangle of a tile's pixel centres: the least `u² + v²` over the rectangle lies
    /// at the centre, or on a side that faces it, where it is the minimum of a parabola.
    fn meets(&self, ellipse: &Ellipse<F>, reach: &Reach<F>, x: usize, y: usize) -> bool {
        let side = |tile: usize, pixels: usize, mean: F| {
            let first = tile * TILE;
            let last = (first + TILE).min(pixels) - 1;
            (F::of(first as f64 + 0.5) - mean, F::of(last as f64 + 0.5) - mean)
        };
        let (left, right) = side(x, reach.camera.width, ellipse.mean_px[0]);
        let (top, bottom) = side(y, reach.camera.height, ellipse.mean_px[1]);
        let near_x = F::ZERO.within(left, right);
        let near_y = F::ZERO.within(top, bottom);
        if near_x == F::ZERO && near_y == F::ZERO {
            return true;
        }
        let whitened = |dx: F, dy: F| {
            let (u, v) = (dx / ellipse.sigma_u, (dy - ellipse.shear * dx) / ellipse.sigma_v);
            u * u + v * v
        };
        let mut least = F::MAX;
        if near_x != F::ZERO {
            least = least.min_of(whitened(near_x, (ellipse.shear * near_x).within(top, bottom)));
        }
        if near_y != F::ZERO {
            let across = ellipse.shear * ellipse.sigma_u;
            let slope = across * ellipse.sigma_u / (across * across + ellipse.sigma_v * ellipse.sigma_v);
            least = least.min_of(whitened((slope * near_y).within(left, right), near_y));
        }
        // `dy − shear dx` loses digits when both terms are large; `blend` may then see a smaller value than this.
        let farthest = left.abs().max_of(right.abs()) * ellipse.shear.abs() + top.abs().max_of(bottom.abs());
        let slip = F::of(8.0) * F::EPSILON * farthest / ellipse.sigma_v;
        let limit = self.limit.sqrt() + slip;
        // Written so that a value that is not a number keeps the tile.
        !(least > limit * limit)
    }
}
