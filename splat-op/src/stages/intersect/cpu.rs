//! CPU twin of `intersect`. It finds the tiles of each Gaussian, sorts the Gaussians by depth, then sorts their
//! intersections by tile with a stable counting sort.

use std::sync::atomic::{AtomicU32, Ordering};

use super::extent::{ExtentRules, ExtentScratch};
use super::{Cut, IntersectionLists, PixelBox, tile_grid};
use crate::project::{COLUMNS, Ellipse};
use crate::simd::{ROW_BLOCK, Real, dispatch};
use crate::{Intrinsics, tasks};

/// Number of Gaussians per task that finds intersections.
const CHUNK: usize = 2048;

/// Number of tasks that sort intersections by tile. Each counts all tiles, so few are better; no result depends on their number.
const SORTERS: usize = 16;

/// Computes the lists of a view from its `[N, 7]` packed ellipses.
pub(crate) fn intersect_cpu<F: Real>(packed: &[F], camera: &Intrinsics, cut: Cut<&[i32]>) -> IntersectionLists {
    let extent = ExtentRules::new(camera, cut);
    let found = tasks::map_with(packed.chunks(CHUNK * COLUMNS), ExtentScratch::default, |scratch, chunk, rows| {
        ChunkIntersections::<F>::new((chunk * CHUNK) as u32, rows, &extent, scratch)
    });
    let intersections: usize = found.iter().map(|found| found.tiles.len()).sum();
    assert!(
        u32::try_from(intersections).is_ok(),
        "{intersections} intersections: more than 2^32; raise `alpha_min` or render a smaller picture"
    );

    let visible = concat(&found, |found| &found.gaussians);
    let mut visible_start = Vec::with_capacity(visible.len() + 1);
    visible_start.push(0);
    let mut end = 0;
    visible_start.extend(concat(&found, |found| &found.counts).into_iter().map(|count| {
        end += count;
        end
    }));
    let mut order: Vec<(F::SortKey, u32)> = concat(&found, |found| &found.depths).into_iter().zip(0..).collect();
    // Stable: Gaussians at the same depth stay in the order of their indices.
    F::sort_by_key(&mut order);
    let tiles = concat(&found, |found| &found.tiles);
    let boxes = concat(&found, |found| &found.boxes);
    drop(found);

    let sorters = tasks::map(order.chunks(order.len().div_ceil(SORTERS).max(1)), |_, order| {
        Sorter::new(order.iter().map(|(_, place)| *place as usize), &visible, &visible_start, &tiles)
    });
    let (tile_start, cursors) = offsets(&sorters, tile_grid(camera.width, camera.height).iter().product());
    // Each place is written once, by whichever thread holds its Gaussian.
    let (gaussian, intersection_of_visible) = (zeros(intersections), zeros(intersections));
    tasks::for_each(sorters.iter().zip(cursors), |_, (sorter, cursor)| {
        sorter.write(cursor, &gaussian, &intersection_of_visible);
    });
    IntersectionLists {
        tile_start,
        gaussian: plain(gaussian),
        visible,
        visible_start,
        intersection_of_visible: plain(intersection_of_visible),
        boxes,
    }
}

/// Intersections of consecutive Gaussians, in the order in which they are found. Counting and writing both read this
/// one result, so they cannot disagree.
struct ChunkIntersections<F: Real> {
    /// The Gaussians that have intersections.
    gaussians: Vec<u32>,
    /// Sort keys of their depths.
    depths: Vec<F::SortKey>,
    /// Number of intersections of each.
    counts: Vec<u32>,
    /// Tile of each intersection.
    tiles: Vec<u32>,
    /// Boxes of all Gaussians of the chunk, if they are asked for.
    boxes: Vec<PixelBox>,
}

impl<F: Real> ChunkIntersections<F> {
    /// Finds the intersections of the Gaussians from `first` on, whose packed ellipses are `rows`.
    fn new(first: u32, rows: &[F], extent: &ExtentRules<F>, scratch: &mut ExtentScratch<F>) -> Self {
        let count = rows.len() / COLUMNS;
        let mut found = Self {
            gaussians: Vec::with_capacity(count),
            depths: Vec::with_capacity(count),
            counts: Vec::with_capacity(count),
            tiles: Vec::with_capacity(4 * count),
            boxes: Vec::new(),
        };
        for (first, rows) in (first..).step_by(ROW_BLOCK).zip(rows.chunks(ROW_BLOCK * COLUMNS)) {
            let counts = dispatch!(F, simd => {
                extent.emit(simd, rows, scratch, &mut found.tiles, &mut found.boxes)
            });
            for ((gaussian, row), count) in (first..).zip(rows.chunks_exact(COLUMNS)).zip(counts) {
                if count > 0 {
                    found.gaussians.push(gaussian);
                    found.depths.push(Ellipse::from_row(row).depth.sort_key());
                    found.counts.push(count);
                }
            }
        }
        found
    }
}

/// Consecutive Gaussians in depth order.
struct Sorter {
    gaussians: Vec<SortedGaussian>,
    /// Tile of each of their intersections.
    tiles: Vec<u32>,
}

struct SortedGaussian {
    id: u32,
    /// Index of its first intersection in the order in which they were found.
    first: u32,
    intersections: u32,
}

impl Sorter {
    /// Collects the Gaussians and their tiles, which are scattered in memory: first the entries of fixed size, so that
    /// many fetches are under way at a time.
    fn new(order: impl Iterator<Item = usize>, visible: &[u32], visible_start: &[u32], tiles: &[u32]) -> Self {
        let sorted = |place: usize| {
            let first = visible_start[place];
            SortedGaussian { id: visible[place], first, intersections: visible_start[place + 1] - first }
        };
        let gaussians: Vec<SortedGaussian> = order.map(sorted).collect();
        let intersections = gaussians.iter().map(|gaussian| gaussian.intersections as usize).sum();
        let mut own = Vec::with_capacity(intersections);
        for gaussian in &gaussians {
            let first = gaussian.first as usize;
            own.extend(&tiles[first..first + gaussian.intersections as usize]);
        }
        Self { gaussians, tiles: own }
    }

    /// Writes each intersection's Gaussian to the next place of its tile, and that place to the intersection's entry in
    /// the order in which they were found.
    fn write(&self, mut cursor: Vec<u32>, gaussian: &[AtomicU32], place_of_intersection: &[AtomicU32]) {
        let mut tiles = self.tiles.iter();
        for sorted in &self.gaussians {
            for (intersection, tile) in (sorted.first..sorted.first + sorted.intersections).zip(&mut tiles) {
                let place = &mut cursor[*tile as usize];
                gaussian[*place as usize].store(sorted.id, Ordering::Relaxed);
                place_of_intersection[intersection as usize].store(*place, Ordering::Relaxed);
                *place += 1;
            }
        }
    }
}

/// Returns the index of each tile's first intersection, and for each sorter the place of its first intersection in each tile.
fn offsets(sorters: &[Sorter], tiles: usize) -> (Vec<usize>, Vec<Vec<u32>>) {
    let mut cursors = tasks::map(sorters, |_, sorter| {
        let mut counts = vec![0; tiles];
        sorter.tiles.iter().for_each(|&tile| counts[tile as usize] += 1);
        counts
    });
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

fn concat<F: Real, T: Copy>(found: &[ChunkIntersections<F>], part: impl Fn(&ChunkIntersections<F>) -> &[T]) -> Vec<T> {
    found.iter().map(part).collect::<Vec<_>>().concat()
}

fn zeros(count: usize) -> Vec<AtomicU32> {
    (0..count).map(|_| AtomicU32::new(0)).collect()
}

fn plain(values: Vec<AtomicU32>) -> Vec<u32> {
    values.into_iter().map(AtomicU32::into_inner).collect()
}
