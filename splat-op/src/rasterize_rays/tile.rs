//! Forward pass of the CPU twin over one tile, a vector of pixels at a time, and what both passes share.

use fearless_simd::prelude::*;

use super::footprint::{RayBox, RayFootprint, RayPixels, RayRules};
use super::order::LayerSlots;
use crate::camera::NO_RAY;
use crate::intersect::{TILE, TILE_PIXELS};
use crate::rasterize::footprint::{ROWS, WIDTH};
use crate::rasterize::tile::{
    BLOCK, BLOCK_ROW, Plane, centres, in_blocks, in_rows, lanes, len, open_transmittance, pixel_rows, store,
};
use crate::simd::real::Real;

/// Number of blocks in a tile.
const BLOCKS: usize = TILE_PIXELS / BLOCK;

/// A tile with the Gaussians of its list, copied side by side, and the planes of its pixels' places.
pub(super) struct RayTile<F> {
    pub near: Vec<RayFootprint<F>>,
    /// `[Gaussians, channels]`: features; depth is not among them.
    pub features: Vec<F>,
    /// Number of features.
    pub channels: usize,
    /// The values of each Gaussian that the forward pass sums at a time.
    values: Vec<[F; TOGETHER]>,
    /// Places in the list of the Gaussians that each block may see.
    lists: [Vec<u32>; BLOCKS],
    /// Numbers of places in `lists`.
    ends: [usize; BLOCKS],
    pub x: [F; BLOCK_ROW],
    /// Centre of the first row of pixels, px.
    pub top: F,
    pub rows: Plane<F>,
    /// Slopes of the pixels' rays, if the camera has a lens.
    slopes: Option<Box<[Plane<F>; 2]>>,
    /// One inside the picture, less than zero outside.
    pub open: Plane<F>,
}

impl<F: Real> Default for RayTile<F> {
    fn default() -> Self {
        Self {
            near: Vec::new(),
            features: Vec::new(),
            channels: 0,
            values: Vec::new(),
            lists: Default::default(),
            ends: [0; BLOCKS],
            x: [F::ZERO; BLOCK_ROW],
            top: F::ZERO,
            rows: pixel_rows(),
            slopes: None,
            open: [F::ZERO; TILE_PIXELS],
        }
    }
}

/// Position of a tile and the Gaussians that it lists.
#[derive(Clone, Copy)]
pub(super) struct RayTileView<'a, F> {
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Number of the tile's pixels inside the picture along x and y.
    pub size: [usize; 2],
    /// Width of the picture, px, and the slopes of its rays, if the camera has a lens.
    pub rays: Option<(usize, &'a [[f64; 2]])>,
    /// Gaussians of the tile's intersections, front to back.
    pub gaussians: &'a [u32],
    pub footprints: &'a [RayFootprint<F>],
    pub boxes: &'a [RayBox<F>],
    /// `[N, channels]`
    pub features: &'a [F],
    /// Number of features.
    pub channels: usize,
}

impl<F: Real> RayTile<F> {
    /// Copies the Gaussians of a tile.
    pub fn read(&mut self, view: &RayTileView<F>) {
        let corner = view.origin.map(|px| F::of(px as f64));
        let count = view.gaussians.len();
        self.channels = view.channels;
        self.near.resize(count, RayFootprint::default());
        self.features.resize(count * view.channels, F::ZERO);
        self.lists.iter_mut().for_each(|list| list.resize(count, 0));
        self.ends = [0; BLOCKS];
        // Gaussians are scattered in memory; fetched together, their latencies overlap.
        for (near, &gaussian) in self.near.iter_mut().zip(view.gaussians) {
            *near = view.footprints[gaussian as usize];
        }
        for (place, &gaussian) in view.gaussians.iter().enumerate() {
            let window = view.boxes[gaussian as usize].window(corner);
            for row in window.first_row / ROWS..window.end_row / ROWS {
                for column in window.first_column..window.end_column {
                    let block = row * (TILE / WIDTH) + column;
                    self.lists[block][self.ends[block]] = place as u32;
                    self.ends[block] += 1;
                }
            }
        }
        for (place, &gaussian) in view.gaussians.iter().enumerate() {
            let (to, from) = (place * view.channels, gaussian as usize * view.channels);
            for channel in 0..view.channels {
                self.features[to + channel] = view.features[from + channel];
            }
        }
        self.x = centres(corner[0]);
        self.top = corner[1] + F::of(0.5);
        self.open = open_transmittance(view.size);
        self.slopes = view.rays.map(|(width, rays)| {
            let mut slopes = Box::new([[F::of(NO_RAY); TILE_PIXELS]; 2]);
            for (row, column) in (0..view.size[1]).flat_map(|row| (0..view.size[0]).map(move |column| (row, column))) {
                let slope = rays[(view.origin[1] + row) * width + view.origin[0] + column];
                (0..2).for_each(|axis| slopes[axis][row * TILE + column] = F::of(slope[axis]));
            }
            slopes.iter_mut().for_each(|plane| *plane = in_blocks(plane));
            slopes
        });
    }

    /// Fills `values` with the channels from `first` on: features, then the depth of the centre.
    fn fill_values(&mut self, first: usize) {
        self.values.resize(self.near.len(), [F::ZERO; TOGETHER]);
        for (place, values) in self.values.iter_mut().enumerate() {
            let features = &self.features[place * self.channels..][..self.channels];
            for (channel, value) in (first..).zip(values) {
                *value = if channel < self.channels { features[channel] } else { self.near[place].depth };
            }
        }
    }

    /// Returns the vector of pixels at `place`.
    #[inline(always)]
    pub fn pixels<S: Simd>(&self, simd: S, place: usize) -> RayPixels<S, F> {
        RayPixels {
            x: lanes(simd, &self.x, place % BLOCK_ROW),
            y: lanes::<S, F>(simd, &self.rows, place) + self.top,
            slopes: self.slopes.as_ref().map(|slopes| [lanes(simd, &slopes[0], place), lanes(simd, &slopes[1], place)]),
        }
    }

    /// Returns the places in the list of the Gaussians that the vector of pixels at `place` may see.
    #[inline(always)]
    pub fn list(&self, place: usize) -> &[u32] {
        &self.lists[place / BLOCK][..self.ends[place / BLOCK]]
    }

    #[inline(always)]
    pub fn feature(&self, place: usize) -> &[F] {
        &self.features[place * self.channels..][..self.channels]
    }
}

/// Number of channels that are summed at a time, in registers.
pub(super) const TOGETHER: usize = 4;

/// Layers of the forward pass: key, alpha, and the values of some channels.
pub(super) type ColourSlots<F> = LayerSlots<F, { 2 + TOGETHER }>;

/// Rasterizes a tile. Writes the sums `Σ w c`, of the features and then of depth if there is one, and the transmittance to
/// `planes`, `[channels + 1, 256]`. More than [`TOGETHER`] features take a pass for each part of them.
///
/// `EXACT` takes the maximum along the ray, and `SORTED` the order of each pixel.
#[inline(always)]
pub(super) fn rasterize_tile<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &mut RayTile<F>,
    rules: &RayRules<S, F>,
    planes: &mut [F],
    slots: &mut ColourSlots<F>,
) {
    let planes = planes.as_chunks_mut::<TILE_PIXELS>().0;
    let (sums, transmittance) = planes.split_at_mut(planes.len() - 1);
    let depth = sums.len() > tile.channels;
    // The depth of a Gaussian is a channel like others, unless it differs from pixel to pixel.
    let channels = if EXACT { tile.channels } else { sums.len() };
    for first in (0..channels).step_by(TOGETHER) {
        tile.fill_values(first);
        for place in (0..TILE_PIXELS).step_by(len::<S, F>()) {
            let sum_depth = EXACT && depth && first == 0;
            let (totals, left) = sum::<S, F, EXACT, SORTED>(simd, tile, rules, place, sum_depth, slots);
            for (plane, total) in sums[first..channels].iter_mut().zip(&totals) {
                store(*total, plane, place);
            }
            if sum_depth {
                store(totals[TOGETHER], &mut sums[channels], place);
            }
            store(left, &mut transmittance[0], place);
        }
    }
    for plane in planes {
        *plane = in_rows(plane);
    }
}

/// Returns the sums over the layers of the vector of pixels at `place`, of the tile's values and of the depths, and the
/// transmittances behind all layers.
#[inline(always)]
fn sum<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    place: usize,
    depth: bool,
    slots: &mut ColourSlots<F>,
) -> ([F::Block<S>; TOGETHER + 1], F::Block<S>) {
    let pixels = tile.pixels(simd, place);
    let mut sums = [rules.zero; TOGETHER + 1];
    let mut open = Open::<S, F>::new(lanes(simd, &tile.open, place));
    slots.clear();
    for &i in tile.list(place) {
        let layer = rules.layer::<EXACT, SORTED>(&tile.near[i as usize], &pixels);
        let mut slot = [layer.key; 2 + TOGETHER];
        slot[1] = layer.alpha;
        for (value, &of_gaussian) in slot[2..].iter_mut().zip(&tile.values[i as usize]) {
            *value = F::Block::<S>::splat(simd, of_gaussian);
        }
        if SORTED {
            slots.insert::<S>(slot, layer.shows);
        } else if open.add(slot, &mut sums, depth, rules) {
            break;
        }
    }
    if SORTED {
        slots.finish::<S>();
        for slot in 0..slots.count() {
            if open.add(slots.get::<S>(simd, slot), &mut sums, depth, rules) {
                break;
            }
        }
    }
    (sums, open.transmittance.abs())
}

/// Transmittances of a vector of pixels on the way from front to back, negated where a pixel is finished.
#[derive(Clone, Copy)]
pub(super) struct Open<S: Simd, F: Real> {
    pub transmittance: F::Block<S>,
}

impl<S: Simd, F: Real> Open<S, F> {
    #[inline(always)]
    pub fn new(transmittance: F::Block<S>) -> Self {
        Self { transmittance }
    }

    /// Passes a layer, whose alphas are zero where it does not show. Returns its weights and its alphas, both zero where the pixel
    /// is finished or the layer finishes it, and whether all pixels are finished.
    #[inline(always)]
    pub fn pass(&mut self, alpha: F::Block<S>, rules: &RayRules<S, F>) -> ([F::Block<S>; 2], bool) {
        let before = self.transmittance;
        let mut alpha = before.simd_ge(rules.zero).select(alpha, rules.zero);
        self.transmittance = (-alpha).mul_add(before, before);
        let ends = alpha.simd_gt(rules.zero) & self.transmittance.simd_le(rules.transmittance_min);
        let mut finished = false;
        // A pixel ends at most once.
        if ends.any_true() {
            alpha = ends.select(rules.zero, alpha);
            self.transmittance = ends.select(-before, (-alpha).mul_add(before, before));
            finished = !self.transmittance.simd_ge(rules.zero).any_true();
        }
        ([alpha * before, alpha], finished)
    }

    /// Passes a layer of [`ColourSlots`] and adds it to the sums, the last of which is that of the keys if `depth` is set.
    /// Returns whether all pixels are finished.
    #[inline(always)]
    fn add(
        &mut self,
        slot: [F::Block<S>; 2 + TOGETHER],
        sums: &mut [F::Block<S>; TOGETHER + 1],
        depth: bool,
        rules: &RayRules<S, F>,
    ) -> bool {
        let ([weight, _], finished) = self.pass(slot[1], rules);
        for channel in 0..TOGETHER {
            sums[channel] = weight.mul_add(slot[2 + channel], sums[channel]);
        }
        if depth {
            sums[TOGETHER] = weight.mul_add(slot[0], sums[TOGETHER]);
        }
        finished
    }
}
