//! Forward pass of the CPU twin over one tile, a vector of pixels at a time, and what both passes share.

use fearless_simd::prelude::*;

use super::footprint::{RayFootprint, RayPixels, RayRules};
use super::order::LayerSlots;
use super::reach::{BlockLists, Reach};
use crate::camera::LEAST_NO_RAY;
use crate::intersect::{PixelBox, TILE, TILE_PIXELS};
use crate::rasterize::footprint::{TileBlocks, WIDTH};
use crate::rasterize::tile::{
    BLOCK, BLOCK_ROW, Plane, centres, in_block_order, in_rows, lanes, len, open_transmittance, pixel_rows, store,
};
use crate::ray_space::{LENS_COLUMNS, LensFrame};
use crate::simd::real::Real;

/// The place, in the order of blocks, of the pixel on row 7 of column 7.
const MIDDLE: usize = in_block_order(7 * TILE / WIDTH) * WIDTH + 7;

/// A tile with Gaussians of its list, copied side by side, and the planes of its pixels' places.
pub(super) struct RayTile<F: Real> {
    /// Gaussians in the order in which their layers come.
    pub near: Vec<RayFootprint<F>>,
    /// [`RayFootprint::whitening`] of each of `near`, if the camera has a lens.
    frames: Vec<LensFrame<F>>,
    /// Place in the tile's list of each of `near`.
    pub places: Vec<u32>,
    /// `[near, channels]`: features; depth is not among them.
    features: Vec<F>,
    /// Number of features.
    pub channels: usize,
    /// The values of each Gaussian that are summed at a time.
    pub values: Vec<[F; TOGETHER]>,
    /// The Gaussians that each block may see, as indices in `near`.
    lists: BlockLists,
    /// Keys at the middle of the tile.
    keys: Vec<(F::SortKey, u32)>,
    x: [F; BLOCK_ROW],
    /// Centre of the first row of pixels, px.
    top: F,
    rows: Plane<F>,
    /// Slopes of the pixels' rays, if the camera has a lens.
    slopes: Option<Box<[Plane<F>; 2]>>,
    /// One where a pixel is in the picture and has a ray, elsewhere less than zero.
    pub open: Plane<F>,
}

impl<F: Real> Default for RayTile<F> {
    fn default() -> Self {
        Self {
            near: Vec::new(),
            frames: Vec::new(),
            places: Vec::new(),
            features: Vec::new(),
            channels: 0,
            values: Vec::new(),
            lists: BlockLists::default(),
            keys: Vec::new(),
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
    /// `[N, 9]`, with a lens `[N, 15]`: rows of `ray_space`.
    pub ray_space: &'a [F],
    /// `[N, channels]`
    pub features: &'a [F],
    /// Number of features.
    pub channels: usize,
}

impl<F: Copy> RayTileView<'_, F> {
    /// Index of the Gaussian at a place in the tile's list.
    #[inline(always)]
    fn gaussian(&self, place: u32) -> usize {
        self.gaussians[place as usize] as usize
    }
}

impl<F: Real> RayTile<F> {
    /// Copies the Gaussians of a tile that some block may see.
    ///
    /// With `SORTED` their layers come in the order of their keys in the middle of the tile, from which the order of a pixel differs
    /// less than from the order of their centres.
    #[inline(always)]
    pub fn read<S: Simd, const SORTED: bool>(&mut self, simd: S, view: &RayTileView<F>, reach: Reach) {
        let corner = view.origin.map(|px| F::of(px as f64));
        self.x = centres(corner[0]);
        self.top = corner[1] + F::of(0.5);
        self.open = open_transmittance(view.size);
        if let Some((width, rays)) = view.rays {
            self.read_slopes(view, width, rays);
        } else {
            self.slopes = None;
        }
        self.places.clear();
        match reach {
            Reach::Boxes(_) => self.places.extend(0..view.gaussians.len() as u32),
            Reach::Blocks(seen) => {
                self.places.extend((0..seen.len() as u32).filter(|&place| seen[place as usize] != 0));
            }
        }
        // Gaussians are scattered in memory; fetched together, their latencies overlap.
        self.near.clear();
        self.near.extend(self.places.iter().map(|&place| view.footprints[view.gaussian(place)]));
        self.frames.clear();
        if view.rays.is_some() {
            for (place, splat) in self.places.iter().zip(&self.near) {
                let row = &view.ray_space[view.gaussian(*place) * LENS_COLUMNS..][..LENS_COLUMNS];
                self.frames.push(splat.whitening(LensFrame::of(row).unwrap_or_default()));
            }
        }
        if SORTED {
            self.sort();
        }
        self.lists.blocks.clear();
        match reach {
            Reach::Boxes(boxes) => {
                let blocks = TileBlocks::new(view.origin.map(|px| px as f32));
                for place in &self.places {
                    // Lists of another projection may have none.
                    let found = boxes.get(view.gaussian(*place)).unwrap_or(&PixelBox::EVERYWHERE);
                    self.lists.blocks.push(blocks.met(simd, found.middle, found.half));
                }
            }
            Reach::Blocks(seen) => self.lists.blocks.extend(self.places.iter().map(|&place| seen[place as usize])),
        }
        self.lists.fill();
        self.channels = view.channels;
        self.features.clear();
        for &place in &self.places {
            let first = view.gaussian(place) * view.channels;
            self.features.extend_from_slice(&view.features[first..first + view.channels]);
        }
    }

    /// Reads the slopes of the pixels' rays. A pixel without a ray sees nothing, like one outside the picture.
    #[inline(always)]
    fn read_slopes(&mut self, view: &RayTileView<F>, width: usize, rays: &[[f64; 2]]) {
        let planes = self.slopes.get_or_insert_with(|| Box::new([[F::ZERO; TILE_PIXELS]; 2]));
        for row in 0..view.size[1] {
            let rays = &rays[(view.origin[1] + row) * width + view.origin[0]..][..view.size[0]];
            for (half, rays) in rays.chunks(WIDTH).enumerate() {
                let first = in_block_order(row * (TILE / WIDTH) + half) * WIDTH;
                for (at, slope) in (first..).zip(rays) {
                    let sees = slope[0] < LEAST_NO_RAY;
                    planes[0][at] = F::of(if sees { slope[0] } else { 0.0 });
                    planes[1][at] = F::of(if sees { slope[1] } else { 0.0 });
                    self.open[at] = if sees { self.open[at] } else { -F::ONE };
                }
            }
        }
    }

    /// Sorts `near` by the keys in the middle of the tile, stably.
    #[inline(always)]
    fn sort(&mut self) {
        let middle = [self.x[MIDDLE % BLOCK_ROW], self.rows[MIDDLE] + self.top];
        let slopes = self.slopes.as_ref().map(|slopes| slopes.each_ref().map(|plane| plane[MIDDLE]));
        self.keys.clear();
        for (i, splat) in self.near.iter().enumerate() {
            let key = splat.key(middle, self.frames.get(i).zip(slopes));
            // Keys below zero are behind all others: the camera's other side.
            self.keys.push((key.sort_key(), i as u32));
        }
        if self.keys.is_sorted_by_key(|(key, _)| *key) {
            return;
        }
        F::sort_by_key(&mut self.keys);
        let order = || self.keys.iter().map(|&(_, i)| i as usize);
        self.places = order().map(|i| self.places[i]).collect();
        self.near = order().map(|i| self.near[i]).collect();
        if !self.frames.is_empty() {
            self.frames = order().map(|i| self.frames[i]).collect();
        }
    }

    /// Fills `values` with the channels from `first` on: features, then the depth of the centre.
    pub fn fill_values(&mut self, first: usize) {
        self.values.resize(self.near.len(), [F::ZERO; TOGETHER]);
        for (i, values) in self.values.iter_mut().enumerate() {
            let features = &self.features[i * self.channels..][..self.channels];
            for (channel, value) in (first..).zip(values) {
                *value = if channel < self.channels { features[channel] } else { self.near[i].depth };
            }
        }
    }

    /// Returns the vector of pixels at `place`.
    #[inline(always)]
    pub fn pixels<S: Simd>(&self, simd: S, place: usize) -> RayPixels<S, F> {
        RayPixels {
            x: lanes(simd, &self.x, place % BLOCK_ROW),
            y: lanes::<S, F>(simd, &self.rows, place) + self.top,
            slopes: match &self.slopes {
                Some(slopes) => Some([lanes(simd, &slopes[0], place), lanes(simd, &slopes[1], place)]),
                None => None,
            },
        }
    }

    /// Returns the Gaussians that the vector of pixels at `place` may see, as indices in `near`.
    #[inline(always)]
    pub fn list(&self, place: usize) -> &[u32] {
        self.lists.list(place)
    }

    /// Returns a Gaussian of `near` with its columns of a lens.
    #[inline(always)]
    pub fn splat(&self, i: u32) -> (&RayFootprint<F>, Option<&LensFrame<F>>) {
        (&self.near[i as usize], self.frames.get(i as usize))
    }

    #[inline(always)]
    pub fn feature(&self, i: u32) -> &[F] {
        &self.features[i as usize * self.channels..][..self.channels]
    }
}

/// Number of channels that are summed at a time, in registers.
pub(super) const TOGETHER: usize = 4;

/// Layers of the forward pass: key, alpha, and the values of some channels.
pub(super) type ColourSlots<F> = LayerSlots<F, { 2 + TOGETHER }>;

/// Rasterizes a tile. Writes the sums `Σ w c`, of the features and then of depth if there is one, and the transmittance to
/// `planes`, `[channels + 1, 256]`. More than [`TOGETHER`] features take a pass for each part of them. Returns, by place in the
/// tile's list, a bit for each block that sees the Gaussian.
///
/// `EXACT` takes the maximum along the ray, and `SORTED` the order of each pixel.
#[inline(always)]
pub(super) fn rasterize_tile<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &mut RayTile<F>,
    rules: &RayRules<S, F>,
    planes: &mut [F],
    slots: &mut ColourSlots<F>,
) -> Vec<u16> {
    let mut seen = vec![0; tile.near.len()];
    let planes = planes.as_chunks_mut::<TILE_PIXELS>().0;
    let (sums, transmittance) = planes.split_at_mut(planes.len() - 1);
    let depth = sums.len() > tile.channels;
    // The depth of a Gaussian is a channel like others, unless it differs from pixel to pixel.
    let channels = if EXACT { tile.channels } else { sums.len() };
    for first in (0..channels).step_by(TOGETHER) {
        tile.fill_values(first);
        for place in (0..TILE_PIXELS).step_by(len::<S, F>()) {
            let sum_depth = EXACT && depth && first == 0;
            let (totals, left) = sum::<S, F, EXACT, SORTED>(simd, tile, rules, (place, sum_depth), (slots, &mut seen));
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
    if SORTED {
        let mut by_place = vec![0; seen.len()];
        tile.places.iter().zip(seen).for_each(|(&place, seen)| by_place[place as usize] = seen);
        return by_place;
    }
    seen
}

/// Returns the sums over the layers of the vector of pixels at `place`, of the tile's values and of the depths, and the
/// transmittances behind all layers. Sets the bit of its block in `seen` for each Gaussian of `near` with a layer in front of a
/// finish, or with `SORTED` anywhere.
#[inline(always)]
fn sum<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    (place, depth): (usize, bool),
    (slots, seen): (&mut ColourSlots<F>, &mut [u16]),
) -> ([F::Block<S>; TOGETHER + 1], F::Block<S>) {
    let pixels = tile.pixels(simd, place);
    let mut sums = [rules.zero; TOGETHER + 1];
    let mut open = Open::<S, F>::new(lanes(simd, &tile.open, place));
    slots.clear::<S>(if SORTED { tile.list(place).len() } else { 0 });
    // With `SORTED`: the transmittances, whatever the order, and once all pixels are finished the largest key that finishes one.
    let (mut left, mut last_key, mut checked) = (open.transmittance, F::MAX, 0);
    for &i in tile.list(place) {
        if SORTED && tile.near[i as usize].least_key > last_key {
            continue;
        }
        let layer = rules.layer::<EXACT, SORTED>(tile.splat(i), &pixels, None);
        let shows = if SORTED { layer.shows } else { layer.shows & open.transmittance.simd_ge(rules.zero) };
        seen[i as usize] |= u16::from(shows.any_true()) << (place / BLOCK);
        let mut slot = [layer.key; 2 + TOGETHER];
        slot[1] = layer.alpha;
        for (value, &of_gaussian) in slot[2..].iter_mut().zip(&tile.values[i as usize]) {
            *value = F::Block::<S>::splat(simd, of_gaussian);
        }
        if SORTED {
            slots.push::<S>(slot, layer.shows);
            left = (-layer.alpha).mul_add(left, left);
            if slots.count() >= checked + BETWEEN {
                slots.sort::<S>(simd);
                checked = slots.count();
                if !left.simd_gt(rules.transmittance_min).any_true() {
                    last_key = last_key.min_of(key_of_finish(open.transmittance, rules, slots));
                }
            }
        } else if open.add(slot, &mut sums, depth, rules) {
            break;
        }
    }
    if SORTED {
        slots.finish::<S>(simd);
        for slot in 0..slots.count() {
            if open.add(slots.get::<S>(simd, slot), &mut sums, depth, rules) {
                break;
            }
        }
    }
    (sums, open.transmittance.abs())
}

/// Number of slots that are sorted at a time, before a look for the key that finishes all pixels.
const BETWEEN: usize = 16;

/// Returns the largest of the keys that finish the pixels, or the largest number if some pixel is not finished. Layers that come later only
/// finish pixels earlier.
#[inline(always)]
fn key_of_finish<S: Simd, F: Real>(open: F::Block<S>, rules: &RayRules<S, F>, slots: &ColourSlots<F>) -> F {
    let simd = open.token();
    let (mut left, mut last) = (open, F::Block::<S>::splat(simd, -F::MAX));
    for slot in 0..slots.sorted() {
        let (key, alpha) = (slots.part::<S>(simd, slot, 0), slots.part::<S>(simd, slot, 1));
        let after = (-alpha).mul_add(left, left);
        let finishes = alpha.simd_gt(rules.zero) & left.simd_ge(rules.zero) & after.simd_le(rules.transmittance_min);
        last = finishes.select(key, last);
        left = finishes.select(-left, after);
    }
    if left.simd_ge(rules.zero).any_true() { F::MAX } else { last.reduce_max() }
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
