//! Forward pass of the CPU twin over one tile, a vector of pixels at a time, and what both passes share.

use fearless_simd::prelude::*;

use super::footprint::{RayFootprint, RayPixels, RayRules};
use super::reach::{BlockLists, Reach};
use crate::camera::LEAST_NO_RAY;
use crate::intersect::{PixelBox, TILE, TILE_PIXELS};
use crate::rasterize::footprint::{TileBlocks, WIDTH};
use crate::rasterize::tile::{
    BLOCK, BLOCK_ROW, Plane, centres, in_block_order, in_rows, lanes, len, open_transmittance, pixel_rows, store,
};
use crate::ray_space::{LENS_COLUMNS, LensFrame};
use crate::simd::real::Real;

/// A tile with Gaussians of its list, copied side by side, and the planes of its pixels' places.
pub(super) struct RayTile<F: Real> {
    /// Gaussians, front to back.
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
    #[inline(always)]
    pub fn read<S: Simd>(&mut self, simd: S, view: &RayTileView<F>, reach: Reach) {
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

    /// Fills `values` with the features from `first` on, and with zeros behind the last.
    pub fn fill_values(&mut self, first: usize) {
        self.values.resize(self.near.len(), [F::ZERO; TOGETHER]);
        for (i, values) in self.values.iter_mut().enumerate() {
            let features = &self.features[i * self.channels..][..self.channels];
            for (channel, value) in (first..).zip(values) {
                *value = features.get(channel).copied().unwrap_or(F::ZERO);
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

/// Rasterizes a tile. Writes the sums `Σ w c`, of the features and then of depth if there is one, and the transmittance to
/// `planes`, `[channels + 1, 256]`. More than [`TOGETHER`] features take a pass for each part of them. Returns, by place in the
/// tile's list, a bit for each block that sees the Gaussian in front of a finish.
#[inline(always)]
pub(super) fn rasterize_tile<S: Simd, F: Real>(
    simd: S,
    tile: &mut RayTile<F>,
    rules: &RayRules<S, F>,
    planes: &mut [F],
) -> Vec<u16> {
    let mut seen = vec![0; tile.near.len()];
    let planes = planes.as_chunks_mut::<TILE_PIXELS>().0;
    let (sums, transmittance) = planes.split_at_mut(planes.len() - 1);
    let channels = tile.channels;
    for first in (0..channels).step_by(TOGETHER) {
        tile.fill_values(first);
        for place in (0..TILE_PIXELS).step_by(len::<S, F>()) {
            let sum_depth = sums.len() > channels && first == 0;
            let (totals, left) = sum::<S, F>(simd, tile, rules, (place, sum_depth), &mut seen);
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
    seen
}

/// Returns the sums over the layers of the vector of pixels at `place`, of the tile's values and of the depths, and the
/// transmittances behind all layers. Sets the bit of its block in `seen` for each Gaussian of `near` with a layer in front of a
/// finish.
#[inline(always)]
fn sum<S: Simd, F: Real>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    (place, depth): (usize, bool),
    seen: &mut [u16],
) -> ([F::Block<S>; TOGETHER + 1], F::Block<S>) {
    let pixels = tile.pixels(simd, place);
    let mut sums = [rules.zero; TOGETHER + 1];
    let mut open = Open::<S, F>::new(lanes(simd, &tile.open, place));
    for &i in tile.list(place) {
        let layer = rules.layer(tile.splat(i), &pixels, None);
        let shows = layer.shows & open.transmittance.simd_ge(rules.zero);
        seen[i as usize] |= u16::from(shows.any_true()) << (place / BLOCK);
        let ([weight, _], finished) = open.pass(layer.alpha, rules);
        // A feature may be infinite or undefined, and zero times it would be undefined.
        let shows = weight.simd_gt(rules.zero);
        for (sum, &value) in sums.iter_mut().zip(&tile.values[i as usize]) {
            *sum = shows.select(weight.mul_add(F::Block::<S>::splat(simd, value), *sum), *sum);
        }
        if depth {
            sums[TOGETHER] = weight.mul_add(layer.depth, sums[TOGETHER]);
        }
        if finished {
            break;
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
}
