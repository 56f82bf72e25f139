//! Backward pass of the CPU twin over one tile. It takes chunks of Gaussians from the last to the first. Each chunk
//! runs forwards again from its checkpoint, then back to front.
//!
//! The gradient of the picture's planes at a pixel, `g`, is the same for every layer, so the recursion needs one number
//! per pixel instead of one per plane: `ρᵢ = g·Rᵢ = αᵢ (g·cᵢ) + (1 − αᵢ) ρᵢ₊₁`, and `∂L/∂αᵢ = Tᵢ (g·cᵢ − ρᵢ₊₁)`.

use fearless_simd::prelude::*;

use super::MOMENTS;
use super::layer_cpu::{Thresholds, Transmittances};
use super::pixels::{Plane, SIMD_BLOCK, SIMD_BLOCK_ROW, TilePixels, TileView, lanes, len, store};
use super::splat_cpu::{Footprint, FootprintLanes, PairSums};
use super::tile::{CHECKPOINT_EVERY, Near, TileTrace, colour_lanes};
use super::tile_blocks::Blocks;
use crate::intersect::TILE_PIXELS;
use crate::simd::real::Real;

/// Inputs of a tile's backward pass besides its [`TileView`].
pub(super) struct TileGrad<'a, F> {
    /// `[channels + 1, 256]`: gradients of the sums `Σ w c` and of alpha; zero outside the picture.
    pub planes: &'a [Plane<F>],
    /// `[256]`: `g · background`, the start of the recursion.
    pub background_rho: &'a [F],
    pub trace: &'a TileTrace<F>,
    /// Whether the sums of absolute values are wanted.
    pub absolute: bool,
    /// Whether all colours of all Gaussians are finite, and whether depth is the last channel.
    pub finite: bool,
    pub depth: bool,
}

/// Buffers that one thread reuses from tile to tile, sized for a chunk whose Gaussians show in every pixel.
pub(super) struct TileScratch<F> {
    /// Transmittances before a Gaussian, then its alphas, for each vector of pixels of each block that it reaches. The last pass over the
    /// Gaussian replaces the transmittances by its weights.
    layers: Vec<F>,
    /// Index in `layers` of the first value of each Gaussian of the chunk.
    starts: [usize; CHECKPOINT_EVERY],
}

impl<F: Real> Default for TileScratch<F> {
    fn default() -> Self {
        Self { layers: vec![F::ZERO; 2 * CHECKPOINT_EVERY * TILE_PIXELS], starts: [0; CHECKPOINT_EVERY] }
    }
}

/// What the Gaussians of a tile share.
pub(super) struct BackwardPass<'a, S: Simd, F: Real> {
    grad: &'a TileGrad<'a, F>,
    thresholds: &'a Thresholds<S, F>,
    pixels: TilePixels<F>,
    /// Upper border of the tile, px.
    top: F,
}

impl<'a, S: Simd, F: Real> BackwardPass<'a, S, F> {
    #[inline(always)]
    pub fn new<P>(view: &TileView<F, P>, grad: &'a TileGrad<F>, thresholds: &'a Thresholds<S, F>) -> Self {
        Self { grad, thresholds, pixels: TilePixels::new(view), top: view.corner()[1] }
    }

    /// Fills `intersections`, `[layers, MOMENTS + channels (+ 4) (+ 2)]`, with each intersection's sums over the tile. Sets
    /// `final_transmittance` to the transmittances behind all layers (negated where finished).
    #[inline(always)]
    pub fn run<P: Footprint<F>, const C: usize, const LONG: bool>(
        &self,
        view: &TileView<F, P>,
        intersections: &mut [F],
        final_transmittance: &mut [F; TILE_PIXELS],
        scratch: &mut TileScratch<F>,
    ) {
        let Self { grad, pixels, .. } = self;
        let simd = self.thresholds.alpha_max.token();
        let channels = if C == 0 { view.channels } else { C };
        let columns = MOMENTS + channels + P::EXTRA_COLUMNS + if grad.absolute { 2 } else { 0 };
        // `ρ` has two parts, like the transmittances.
        let mut rho = Transmittances::new([F::ZERO; TILE_PIXELS]);
        rho.kept.copy_from_slice(grad.background_rho);
        let TileTrace { reached, checkpoints } = grad.trace;
        let chunks = reached.len().div_ceil(CHECKPOINT_EVERY);
        *final_transmittance = pixels.open;
        for chunk in (0..chunks).rev() {
            let first = chunk * CHECKPOINT_EVERY;
            let reached = &reached[first..reached.len().min(first + CHECKPOINT_EVERY)];
            let gaussians = &view.gaussians[first..first + reached.len()];
            let mut transmittance = match chunk {
                0 => Transmittances::new(pixels.open),
                _ => Transmittances::resume::<LONG>(checkpoints, chunk - 1),
            };
            let mut near = Near::<F, P, C>::default();
            near.gather(view, gaussians);
            self.forwards::<P, LONG>(&near.footprints, reached, &mut transmittance, scratch);
            if chunk + 1 == chunks {
                *final_transmittance = transmittance.kept;
            }
            for (i, &gaussian) in gaussians.iter().enumerate().rev() {
                if reached[i] == 0 {
                    continue;
                }
                let row = &mut intersections[(first + i) * columns..(first + i + 1) * columns];
                let splat = near.footprints[i].lanes(simd, self.top);
                let colour = if C == 0 { view.colour(gaussian) } else { &near.colours[i] };
                let layers = &mut scratch.layers[scratch.starts[i]..];
                self.backwards::<P, C, LONG>(&splat, colour, Blocks(reached[i]), layers, &mut rho, row);
            }
        }
    }

    /// Runs the forward pass over one chunk, in the blocks that each Gaussian is known to reach, and stores the layers.
    #[inline(always)]
    fn forwards<P: Footprint<F>, const LONG: bool>(
        &self,
        near: &[P],
        reached: &[u16],
        transmittance: &mut Transmittances<F>,
        scratch: &mut TileScratch<F>,
    ) {
        let Self { thresholds, pixels, .. } = self;
        let simd = thresholds.alpha_max.token();
        let TileScratch { layers, starts } = scratch;
        let mut at = 0;
        for ((footprint, &reached), start) in near.iter().zip(reached).zip(starts) {
            *start = at;
            let splat = footprint.lanes(simd, self.top);
            for block in Blocks(reached) {
                for place in (block * SIMD_BLOCK..(block + 1) * SIMD_BLOCK).step_by(len::<S, F>()) {
                    let column = splat.column(pixels.x(simd, place % SIMD_BLOCK_ROW));
                    let before = transmittance.load::<S, LONG>(simd, place);
                    let layer = thresholds.layer::<_, LONG>(&splat, &column, pixels, place, before);
                    transmittance.store::<S, LONG>(layer.transmittance, place);
                    store(before[0], layers, at);
                    store(layer.alpha, layers, at + len::<S, F>());
                    at += 2 * len::<S, F>();
                }
            }
        }
    }

    /// Passes one Gaussian back to front: writes its sums over the pixels that it shows in to `row`, and updates `rho` to
    /// its value in front of the Gaussian. `layers` begin with its own of [`TileScratch`].
    #[inline(always)]
    fn backwards<P: Footprint<F>, const C: usize, const LONG: bool>(
        &self,
        splat: &P::Broadcast<S>,
        colour: &[F],
        blocks: Blocks,
        layers: &mut [F],
        rho: &mut Transmittances<F>,
        row: &mut [F],
    ) {
        let Self { grad, pixels, .. } = self;
        let alpha_max = self.thresholds.alpha_max;
        let simd = alpha_max.token();
        let channels = if C == 0 { colour.len() } else { C };
        let zero = F::Block::<S>::splat(simd, F::ZERO);
        let planes = &grad.planes[..=channels];
        let plane = |channel: usize, place: usize| lanes::<S, F>(simd, &planes[channel], place);
        let mut sums = PairSums::new(zero);
        let mut features = [zero; C];
        let colour_lanes = colour_lanes::<S, F, C>(simd, colour);
        // Along rays depth has a factor at each pixel.
        let bends = |channel: usize| P::ALONG_RAYS && grad.depth && channel + 1 == channels;
        let layer_len = 2 * len::<S, F>();
        let mut first = 0;
        for block in blocks {
            for place in (block * SIMD_BLOCK..(block + 1) * SIMD_BLOCK).step_by(len::<S, F>()) {
                let layer = &mut layers[first..first + layer_len];
                first += layer_len;
                let [behind, lost] = rho.load::<S, LONG>(simd, place);
                let before = lanes::<S, F>(simd, layer, 0);
                let alpha = lanes::<S, F>(simd, layer, len::<S, F>());
                let column = splat.column(pixels.x(simd, place % SIMD_BLOCK_ROW));
                let at = splat.at(&column, pixels, place);
                let mut along = plane(channels, place);
                for channel in 0..channels {
                    let mut colour =
                        if C == 0 { F::Block::<S>::splat(simd, colour[channel]) } else { colour_lanes[channel] };
                    if bends(channel) {
                        colour *= at.depth_factor;
                    }
                    along = plane(channel, place).mul_add(colour, along);
                }
                let weight = alpha * before;
                let mut ahead = along - behind;
                // What is not finite may lie behind any Gaussian.
                if !grad.finite {
                    ahead = alpha.simd_gt(zero).select(ahead, zero);
                }
                let change = if LONG { alpha.mul_add(ahead, (-alpha).mul_add(lost, lost)) } else { alpha * ahead };
                let stepped = if LONG { behind + change } else { alpha.mul_add(ahead, behind) };
                rho.store::<S, LONG>([stepped, change - (stepped - behind)], place);
                let free = alpha.simd_lt(alpha_max);
                let h = free.select(weight * ahead, zero);

                let of_depth = if bends(channels - 1) { Some(weight * plane(channels - 1, place)) } else { None };
                splat.add(&mut sums, &at.point, h, of_depth, grad.absolute);
                if C == 0 {
                    store(weight, layer, 0);
                } else {
                    for channel in 0..C {
                        features[channel] = plane(channel, place).mul_add(weight, features[channel]);
                    }
                }
            }
        }
        sums.store(&features, row, channels, P::EXTRA_COLUMNS);
        for channel in C..channels {
            let mut sum = zero;
            let mut first = 0;
            for block in blocks {
                for place in (block * SIMD_BLOCK..(block + 1) * SIMD_BLOCK).step_by(len::<S, F>()) {
                    sum = plane(channel, place).mul_add(lanes::<S, F>(simd, layers, first), sum);
                    first += layer_len;
                }
            }
            row[MOMENTS + channel] = sum.reduce_sum();
        }
    }
}
