//! CPU twin of the contributors of each pixel, parallel over rows of tiles.

use fearless_simd::prelude::*;

use super::layer_cpu::{Thresholds, Transmittances};
use super::pixels::{SIMD_BLOCK, SIMD_BLOCK_ROW, TilePixels, TileView, len, row_and_column};
use super::prepared::Prepared;
use super::splat_cpu::{Footprint, FootprintLanes};
use super::tile_blocks::{Blocks, TileBlocks};
use super::{Layers, MEDIAN, RasterizeSpec};
use crate::intersect::{IntersectionLists, TILE_PIXELS, TILE_SIZE};
use crate::simd::dispatch;
use crate::simd::real::Real;
use crate::tasks;

/// The id where there is no contributor.
const NONE: i32 = -1;

/// Contributors of a picture's pixels.
pub(super) struct PixelContributors<I, W> {
    /// `[H, W, K]`
    pub ids: I,
    pub weights: W,
    /// `[H, W]`
    pub median: I,
}

/// Returns the first `most` contributors of each pixel, front to back, and the one at which the transmittance falls to [`MEDIAN`]. Of
/// `inputs`, the features and the background have no elements.
pub(super) fn contributors_cpu<F: Real, P: Footprint<F>>(
    inputs: Layers<&[F]>,
    spec: &RasterizeSpec,
    intersections: &IntersectionLists,
    most: usize,
) -> PixelContributors<Vec<i32>, Vec<F>> {
    let prepared = Prepared::<F, P>::new(&inputs, spec, intersections);
    let ([width, height], [tiles_x, _]) = (prepared.size, prepared.grid);
    let (count, row) = (width * height * most, TILE_SIZE * width);
    let (mut ids, mut weights, mut median) = (vec![NONE; count], vec![F::ZERO; count], vec![NONE; width * height]);
    let rows = ids.chunks_mut(row * most).zip(weights.chunks_mut(row * most)).zip(median.chunks_mut(row));
    tasks::for_each(rows, |y, ((ids, weights), median)| {
        let mut out = PixelContributors { ids, weights, median };
        for tile in y * tiles_x..(y + 1) * tiles_x {
            let (view, long) = prepared.view(tile, &inputs, intersections);
            dispatch!(F, simd => {
                let thresholds = Thresholds::<_, F>::new(simd, prepared.thresholds);
                if long {
                    of_tile::<_, F, P, true>(&view, &thresholds, width, most, &mut out);
                } else {
                    of_tile::<_, F, P, false>(&view, &thresholds, width, most, &mut out);
                }
            });
        }
    });
    PixelContributors { ids, weights, median }
}

/// Fills the pixels of a tile in `out`, which has a row of tiles.
#[inline(always)]
fn of_tile<S: Simd, F: Real, P: Footprint<F>, const LONG: bool>(
    view: &TileView<F, P>,
    thresholds: &Thresholds<S, F>,
    width: usize,
    most: usize,
    out: &mut PixelContributors<&mut [i32], &mut [F]>,
) {
    let (simd, corner) = (thresholds.zero.token(), view.corner());
    let (pixels, blocks) = (TilePixels::new(view), TileBlocks::new(corner));
    let mut transmittance = Transmittances::new(pixels.open);
    let (mut open, mut found) = (view.open(&pixels.open), [0; TILE_PIXELS]);
    for &gaussian in view.gaussians {
        if open == 0 {
            break;
        }
        let footprint = &view.footprints[gaussian as usize];
        let splat = footprint.lanes(simd, corner[1]);
        for block in Blocks(footprint.met(simd, &blocks)) {
            for first in (block * SIMD_BLOCK..(block + 1) * SIMD_BLOCK).step_by(len::<S, F>()) {
                let column = splat.column(pixels.x(simd, first % SIMD_BLOCK_ROW));
                let before = transmittance.load::<S, LONG>(simd, first);
                let layer = thresholds.layer::<_, LONG>(&splat, &column, &pixels, first, before);
                transmittance.store::<S, LONG>(layer.transmittance, first);
                open -= layer.finished;
                let weight = layer.alpha * before[0];
                let mut shows = layer.alpha.simd_gt(thresholds.zero).to_bitmask();
                while shows != 0 {
                    let lane = shows.trailing_zeros() as usize;
                    shows &= shows - 1;
                    let place = first + lane;
                    let [row, column] = row_and_column(place);
                    let pixel = row * width + view.origin[0] + column;
                    if found[place] < most {
                        out.ids[pixel * most + found[place]] = gaussian as i32;
                        out.weights[pixel * most + found[place]] = weight[lane];
                        found[place] += 1;
                    }
                    if out.median[pixel] == NONE && transmittance.kept[place] <= F::of(MEDIAN) {
                        out.median[pixel] = gaussian as i32;
                    }
                    // Nothing behind is needed.
                    if found[place] == most && out.median[pixel] != NONE {
                        transmittance.kept[place] = -F::ONE;
                        open -= 1;
                    }
                }
            }
        }
    }
}
