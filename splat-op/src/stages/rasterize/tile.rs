//! Forward pass of the CPU twin over one tile.

use fearless_simd::prelude::*;

use super::layer_cpu::{Thresholds, Transmittances};
use super::pixels::{Plane, SIMD_BLOCK, SIMD_BLOCK_ROW, TilePixels, TileView, in_rows, lanes, len, store};
use super::splat_cpu::{Footprint, FootprintLanes};
use super::tile_blocks::{Blocks, TileBlocks};
use crate::intersect::TILE_PIXELS;
use crate::simd::real::Real;

/// Number of Gaussians between two checkpoints of a tile's transmittances.
pub(super) const CHECKPOINT_EVERY: usize = 64;

/// Number of Gaussians in a partial sum. A longer sum is a sum of partial sums: added one by one in f32, the last of 10,000 faint layers
/// would be too small to change it. Only Gaussians that reach a pixel count: a Gaussian that a tile lists in vain must change no bit.
const SUM_LENGTH: usize = 8 * CHECKPOINT_EVERY;

/// Gaussians of a tile, copied side by side. They are scattered in memory; fetched together, their latencies overlap.
pub(super) struct Near<F, P, const C: usize> {
    pub footprints: [P; CHECKPOINT_EVERY],
    /// Colours, if the number of channels is known at compile time.
    pub colours: [[F; C]; CHECKPOINT_EVERY],
}

impl<F: Real, P: Footprint<F>, const C: usize> Default for Near<F, P, C> {
    #[inline(always)]
    fn default() -> Self {
        Self { footprints: [P::default(); CHECKPOINT_EVERY], colours: [[F::ZERO; C]; CHECKPOINT_EVERY] }
    }
}

impl<F: Real, P: Footprint<F>, const C: usize> Near<F, P, C> {
    /// Copies the first [`CHECKPOINT_EVERY`] of `gaussians`.
    #[inline(always)]
    pub fn gather(&mut self, view: &TileView<F, P>, gaussians: &[u32]) {
        for ((footprint, colour), &gaussian) in self.footprints.iter_mut().zip(&mut self.colours).zip(gaussians) {
            *footprint = view.footprints[gaussian as usize];
            if C > 0 {
                colour.copy_from_slice(&view.colour(gaussian)[..C]);
            }
        }
    }
}

/// A Gaussian's channels, one copy in each lane, where their number is known at compile time.
#[inline(always)]
pub(super) fn colour_lanes<S: Simd, F: Real, const C: usize>(simd: S, colour: &[F]) -> [F::Block<S>; C] {
    let mut lanes = [F::Block::<S>::splat(simd, F::ZERO); C];
    for (lanes, &value) in lanes.iter_mut().zip(colour) {
        *lanes = F::Block::<S>::splat(simd, value);
    }
    lanes
}

/// Whether all channels are finite. Zero times any other value is undefined.
pub(super) fn is_finite<F: Real>(colours: &[F]) -> bool {
    let mut zeros = [F::ZERO; 16];
    let (chunks, rest) = colours.as_chunks::<16>();
    for chunk in chunks {
        zeros.iter_mut().zip(chunk).for_each(|(zero, value)| *zero += *value * F::ZERO);
    }
    zeros.iter_mut().zip(rest).for_each(|(zero, value)| *zero += *value * F::ZERO);
    zeros.iter().all(|zero| *zero == F::ZERO)
}

/// Adds `sums` to `totals`, each with what rounding took from it (Kahan 1965), and sets `sums` to zero.
fn move_into<F: Real>(sums: &mut [F], totals: &mut [[F; 2]]) {
    for ([total, lost], sum) in totals.iter_mut().zip(sums) {
        let (change, before) = (*sum + *lost, *total);
        *total = before + change;
        *lost = change - (*total - before);
        *sum = F::ZERO;
    }
}

/// What the forward pass over a tile keeps for its backward pass.
#[derive(Default)]
pub(super) struct TileTrace<F> {
    /// The blocks that each Gaussian reaches, a bit for each, front to back. It has as many entries as the forward pass
    /// evaluated Gaussians before all pixels were finished.
    pub reached: Vec<u16>,
    /// Transmittances before each [`CHECKPOINT_EVERY`]th Gaussian but the first, by [`Transmittances::keep`].
    pub checkpoints: Vec<F>,
}

/// What the Gaussians of a tile share.
struct TilePass<'a, S: Simd, F: Real> {
    thresholds: &'a Thresholds<S, F>,
    pixels: &'a TilePixels<F>,
    /// Upper border of the tile, px.
    top: F,
    /// Whether depth is the last channel.
    depth: bool,
}

/// What a Gaussian did to a tile.
struct TilePassed {
    /// A bit for each block that it reaches.
    reached: u16,
    /// Number of pixels that it finishes.
    finished: usize,
}

impl<S: Simd, F: Real> TilePass<'_, S, F> {
    /// Adds the colours of a Gaussian to `sums` in the blocks that it meets, and updates the transmittances. Without `FINITE` only the
    /// pixels that see it are added to: zero times a colour that is not finite is undefined.
    #[inline(always)]
    fn add<P: Footprint<F>, const C: usize, const LONG: bool, const FINITE: bool>(
        &self,
        footprint: &P,
        colour: &[F],
        met: Blocks,
        transmittance: &mut Transmittances<F>,
        sums: &mut [Plane<F>],
    ) -> TilePassed {
        let Self { thresholds, pixels, .. } = self;
        let (simd, channels) = (thresholds.zero.token(), if C == 0 { colour.len() } else { C });
        let splat = footprint.lanes(simd, self.top);
        let colour_lanes = colour_lanes::<S, F, C>(simd, colour);
        let mut passed = TilePassed { reached: 0, finished: 0 };
        for block in met {
            for place in (block * SIMD_BLOCK..(block + 1) * SIMD_BLOCK).step_by(len::<S, F>()) {
                let column = splat.column(pixels.x(simd, place % SIMD_BLOCK_ROW));
                let before = transmittance.load::<S, LONG>(simd, place);
                let layer = thresholds.layer::<_, LONG>(&splat, &column, pixels, place, before);
                passed.reached |= u16::from(layer.near.any_true()) << block;
                transmittance.store::<S, LONG>(layer.transmittance, place);
                let weight = layer.alpha * before[0];
                for (channel, sum) in sums.iter_mut().enumerate() {
                    let mut colour =
                        if C == 0 { F::Block::<S>::splat(simd, colour[channel]) } else { colour_lanes[channel] };
                    if P::ALONG_RAYS && self.depth && channel + 1 == channels {
                        colour *= layer.depth_factor;
                    }
                    let sum_before = lanes(simd, sum, place);
                    let mut sum_behind = weight.mul_add(colour, sum_before);
                    if !FINITE {
                        sum_behind = layer.alpha.simd_gt(thresholds.zero).select(sum_behind, sum_before);
                    }
                    store(sum_behind, sum, place);
                }
                passed.finished += layer.finished;
            }
        }
        passed
    }
}

/// Rasterizes a tile. Writes the sums `Σ w c` and the transmittance (positive) to `planes`, `[channels + 1, 256]`. Fills `trace`, if given.
///
/// `C` is the number of channels if it is known at compile time, else zero.
#[inline(always)]
pub(super) fn rasterize_tile<S: Simd, F: Real, P: Footprint<F>, const C: usize, const LONG: bool>(
    view: &TileView<F, P>,
    thresholds: &Thresholds<S, F>,
    planes: &mut [F],
    mut trace: Option<&mut TileTrace<F>>,
) {
    let channels = if C == 0 { view.channels } else { C };
    let corner = view.corner();
    let (pixels, blocks) = (&TilePixels::new(view), &TileBlocks::new(corner));
    let tile = TilePass { thresholds, pixels, top: corner[1], depth: view.depth };
    let mut transmittance = Transmittances::new(pixels.open);
    let mut open = view.open(&pixels.open);
    let (sums, final_transmittance) = planes.as_chunks_mut::<TILE_PIXELS>().0.split_at_mut(channels);
    sums.as_flattened_mut().fill(F::ZERO);
    let mut finished_sums = Vec::new();
    let (mut near, mut met) = (Near::<F, P, C>::default(), [0; CHECKPOINT_EVERY]);
    let mut summed = 0;
    for (i, &gaussian) in view.gaussians.iter().enumerate() {
        if i % CHECKPOINT_EVERY == 0 {
            near.gather(view, &view.gaussians[i..]);
            // Before the loops over the blocks, so that the processor knows early where each of them ends.
            for (met, footprint) in met.iter_mut().zip(&near.footprints).take(view.gaussians.len() - i) {
                *met = footprint.met(thresholds.zero.token(), blocks);
            }
            if let Some(trace) = trace.as_deref_mut().filter(|_| i > 0) {
                transmittance.keep::<LONG>(&mut trace.checkpoints);
            }
        }
        if summed == if LONG { CHECKPOINT_EVERY } else { SUM_LENGTH } {
            finished_sums.resize(channels * TILE_PIXELS, [F::ZERO; 2]);
            move_into(sums.as_flattened_mut(), &mut finished_sums);
            summed = 0;
        }
        let (footprint, met) = (&near.footprints[i % CHECKPOINT_EVERY], Blocks(met[i % CHECKPOINT_EVERY]));
        let colour = if C == 0 { view.colour(gaussian) } else { &near.colours[i % CHECKPOINT_EVERY] };
        let TilePassed { reached, finished } = if view.finite || is_finite(colour) {
            tile.add::<P, C, LONG, true>(footprint, colour, met, &mut transmittance, sums)
        } else {
            tile.add::<P, C, LONG, false>(footprint, colour, met, &mut transmittance, sums)
        };
        summed += usize::from(reached != 0);
        if let Some(trace) = trace.as_deref_mut() {
            trace.reached.push(reached);
        }
        open -= finished;
        if open == 0 {
            break;
        }
    }
    if !finished_sums.is_empty() {
        let sums = sums.as_flattened_mut();
        move_into(sums, &mut finished_sums);
        sums.iter_mut().zip(&finished_sums).for_each(|(sum, [total, _])| *sum = *total);
    }
    final_transmittance[0] = transmittance.kept.map(F::abs);
    for plane in planes.as_chunks_mut::<TILE_PIXELS>().0 {
        *plane = in_rows(plane);
    }
}
