//! Forward pass of the CPU twin over one tile, and the arithmetic of a layer. Both passes share that arithmetic, so
//! that the backward pass sees the very bits of the forward pass.

use fearless_simd::prelude::*;

use super::pixels::{Plane, SIMD_BLOCK, TilePixels, in_rows, lanes, len, store};
use super::splat_cpu::{Footprint, FootprintLanes};
use super::tile_blocks::{SIMD_ROWS, TileBlocks, TileWindow};
use crate::intersect::{TILE_PIXELS, TILE_SIZE};
use crate::simd::real::{EXP2_CONSTANTS, Real};

/// Number of Gaussians between two checkpoints of a tile's transmittances.
pub(super) const CHECKPOINT_EVERY: usize = 64;

/// Number of Gaussians in a partial sum. A longer sum is a sum of partial sums: added one by one in f32, the last of
/// 10,000 faint layers would be too small to change it. Only Gaussians that reach a pixel count: a Gaussian that a tile
/// lists in vain must change no bit.
const SUM_LENGTH: usize = 8 * CHECKPOINT_EVERY;

/// Whether a list of intersections is rasterized with [`Transmittances::lost`] and shorter partial sums, which takes a
/// fifth longer. Otherwise roundings do not add up to a difference that an f32 picture can show: the list is short
/// enough, and if it is not very short, no layer is so faint that it alone would change no digit. Only rounding depends
/// on this choice.
pub(super) fn is_long<F: Real>(intersections: usize, alpha_min: F) -> bool {
    const LONG_LIST: usize = 2048;
    const LONG_FOR_FAINT: usize = 256;
    intersections > if alpha_min >= F::of(1e-3) { LONG_LIST } else { LONG_FOR_FAINT }
}

/// Transmittances of a tile's pixels, in two parts: `lost` is what rounding took from `kept`, less than half an ulp of
/// it. Without `lost` the roundings of many layers add up.
///
/// Functions with the parameter `LONG` (see [`is_long`]) leave `lost` zero if it is false.
#[derive(Clone, Copy)]
pub(super) struct Transmittances<F> {
    /// Negated where a pixel is finished.
    pub kept: [F; TILE_PIXELS],
    pub lost: [F; TILE_PIXELS],
}

impl<F: Real> Transmittances<F> {
    pub fn new(kept: [F; TILE_PIXELS]) -> Self {
        Self { kept, lost: [F::ZERO; TILE_PIXELS] }
    }

    /// Appends the values that [`Self::resume`] reads.
    pub fn keep<const LONG: bool>(&self, checkpoints: &mut Vec<F>) {
        checkpoints.extend_from_slice(&self.kept);
        if LONG {
            checkpoints.extend_from_slice(&self.lost);
        }
    }

    /// Returns the transmittances at the checkpoint with this number.
    pub fn resume<const LONG: bool>(checkpoints: &[F], number: usize) -> Self {
        let parts = if LONG { 2 } else { 1 };
        let part = |part: usize| {
            let first = (parts * number + part) * TILE_PIXELS;
            std::array::from_fn(|pixel| checkpoints[first + pixel])
        };
        Self { kept: part(0), lost: if LONG { part(1) } else { [F::ZERO; TILE_PIXELS] } }
    }

    /// Loads both parts of a vector of pixels.
    #[inline(always)]
    pub fn load<S: Simd, const LONG: bool>(&self, simd: S, place: usize) -> [F::Block<S>; 2] {
        let lost = if LONG { lanes(simd, &self.lost, place) } else { F::Block::<S>::splat(simd, F::ZERO) };
        [lanes(simd, &self.kept, place), lost]
    }

    #[inline(always)]
    pub fn store<S: Simd, const LONG: bool>(&mut self, [kept, lost]: [F::Block<S>; 2], place: usize) {
        store(kept, &mut self.kept, place);
        if LONG {
            store(lost, &mut self.lost, place);
        }
    }
}

/// Thresholds of the render, one copy in each lane.
pub(super) struct Thresholds<S: Simd, F: Real> {
    alpha_min: F::Block<S>,
    pub alpha_max: F::Block<S>,
    transmittance_min: F::Block<S>,
    zero: F::Block<S>,
    exp2: [F::Block<S>; EXP2_CONSTANTS],
}

impl<S: Simd, F: Real> Thresholds<S, F> {
    #[inline(always)]
    pub fn new(simd: S, [alpha_min, alpha_max, transmittance_min]: [F; 3]) -> Self {
        let lanes = |value| F::Block::<S>::splat(simd, value);
        // A threshold of zero leaves out nothing, not even layers behind an alpha of one.
        let never = if transmittance_min > F::ZERO { transmittance_min } else { -F::ONE };
        let mut exp2 = [lanes(F::ZERO); EXP2_CONSTANTS];
        for (constant, value) in exp2.iter_mut().zip(F::EXP2) {
            *constant = lanes(value);
        }
        Self {
            alpha_min: lanes(alpha_min),
            alpha_max: lanes(alpha_max),
            transmittance_min: lanes(never),
            zero: lanes(F::ZERO),
            // The constants stay in memory, where instructions read them as operands; the compiler would rebuild them
            // each time.
            exp2: std::hint::black_box(exp2),
        }
    }

    /// Passes one Gaussian over the vector of pixels of a column at `place`. Returns their alphas (zero where it does not
    /// show) and their transmittances behind it, negated where a pixel is finished.
    #[inline(always)]
    pub fn layer<P: FootprintLanes<S, F>, const LONG: bool>(
        &self,
        splat: &P,
        (column, pixels, place): (&P::Column, &TilePixels<F>, usize),
        before: [F::Block<S>; 2],
    ) -> LayerSimd<S, F> {
        let at = splat.at(column, pixels, place);
        let near = at.near & before[0].simd_ge(self.zero);
        // A branch on whether the Gaussian reaches any of the pixels would be mispredicted too often.
        let power = F::exp2_lanes(at.exponent, &self.exp2);
        let value = (splat.opacity() * power).min(self.alpha_max);
        let shows = near & value.simd_ge(self.alpha_min);
        let mut alpha = shows.select(value, self.zero);
        let mut after = pass::<S, F, LONG>(alpha, before);
        let finishes = shows & after[0].simd_le(self.transmittance_min);
        let mut finished = 0;
        // A pixel finishes at most once.
        if finishes.any_true() {
            finished = finishes.to_bitmask().count_ones() as usize;
            alpha = finishes.select(self.zero, alpha);
            let [kept, lost] = pass::<S, F, LONG>(alpha, before);
            after = [finishes.select(-kept, kept), lost];
        }
        LayerSimd { alpha, transmittance: after, near, depth_factor: at.depth_factor, finished }
    }
}

/// `T (1 − α)`, in two parts. `1 − α` is not computed: its rounding would be the same for all layers of one faint
/// alpha.
#[inline(always)]
fn pass<S: Simd, F: Real, const LONG: bool>(
    alpha: F::Block<S>,
    [transmittance, lost]: [F::Block<S>; 2],
) -> [F::Block<S>; 2] {
    if !LONG {
        return [(-alpha).mul_add(transmittance, transmittance), lost];
    }
    // (T + lost)(1 − α) by the compensated addition of Kahan (1965).
    let change = (-alpha).mul_add(transmittance, (-alpha).mul_add(lost, lost));
    let after = transmittance + change;
    [after, change - (after - transmittance)]
}

/// A bit for each pixel of a vector.
type Mask<S, F> = <<F as Real>::Block<S> as SimdBase<S>>::Mask;

/// Result of passing a Gaussian over a vector of pixels.
pub(super) struct LayerSimd<S: Simd, F: Real> {
    pub alpha: F::Block<S>,
    /// Both parts of the transmittances after the Gaussian.
    pub transmittance: [F::Block<S>; 2],
    /// The pixels that the Gaussian reaches; its other alphas are zero.
    pub near: Mask<S, F>,
    /// The factor of its depth; not read unless it is seen along rays.
    pub depth_factor: F::Block<S>,
    /// Number of pixels that the Gaussian finishes.
    pub finished: usize,
}

/// Position of a tile and the Gaussians that it lists.
#[derive(Clone, Copy)]
pub(crate) struct TileView<'a, F, P> {
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Number of the tile's pixels inside the picture along x and y.
    pub size: [usize; 2],
    /// Gaussians of the tile's intersections, front to back.
    pub gaussians: &'a [u32],
    /// Width of the picture, px, and the slopes of its rays, if Gaussians are seen along rays through a lens.
    pub slopes: Option<(usize, &'a [[f64; 2]])>,
    /// Footprint of each Gaussian.
    pub footprints: &'a [P],
    /// `[N, channels]`: colours of each Gaussian.
    pub colours: &'a [F],
    pub channels: usize,
    /// Whether depth is the last channel.
    pub depth: bool,
    /// Whether all colours of all Gaussians are finite.
    pub finite: bool,
}

impl<F: Real, P> TileView<'_, F, P> {
    #[inline(always)]
    pub fn corner(&self) -> [F; 2] {
        self.origin.map(|px| F::of(px as f64))
    }

    /// Number of pixels with this transmittance that are not finished.
    #[inline(always)]
    pub fn open(&self, transmittance: &Plane<F>) -> usize {
        match self.slopes {
            None => self.size[0] * self.size[1],
            Some(_) => transmittance.iter().filter(|t| **t > F::ZERO).count(),
        }
    }

    #[inline(always)]
    pub fn colour(&self, gaussian: u32) -> &[F] {
        let first = gaussian as usize * self.channels;
        &self.colours[first..first + self.channels]
    }
}

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

/// Rasterizes a tile. Writes the sums `Σ w c` and the transmittance (positive) to `planes`, `[channels + 1, 256]`.
/// Fills `trace`, if given.
///
/// `C` is the number of channels if it is known at compile time, else zero.
#[inline(always)]
pub(super) fn rasterize_tile<S: Simd, F: Real, P: Footprint<F>, const C: usize, const LONG: bool>(
    simd: S,
    view: &TileView<F, P>,
    thresholds: &Thresholds<S, F>,
    planes: &mut [F],
    mut trace: Option<&mut TileTrace<F>>,
) {
    let channels = if C == 0 { view.channels } else { C };
    let corner = view.corner();
    let (pixels, blocks) = (TilePixels::new(view), TileBlocks::new(corner));
    let mut transmittance = Transmittances::new(pixels.open);
    let mut open = view.open(&pixels.open);
    let (sums, final_transmittance) = planes.as_chunks_mut::<TILE_PIXELS>().0.split_at_mut(channels);
    sums.as_flattened_mut().fill(F::ZERO);
    let mut finished_sums = Vec::new();
    let mut near = Near::<F, P, C>::default();
    let mut summed = 0;
    for (i, &gaussian) in view.gaussians.iter().enumerate() {
        if i % CHECKPOINT_EVERY == 0 {
            near.gather(view, &view.gaussians[i..]);
            if let Some(trace) = trace.as_deref_mut().filter(|_| i > 0) {
                transmittance.keep::<LONG>(&mut trace.checkpoints);
            }
        }
        if summed == if LONG { CHECKPOINT_EVERY } else { SUM_LENGTH } {
            finished_sums.resize(channels * TILE_PIXELS, [F::ZERO; 2]);
            move_into(sums.as_flattened_mut(), &mut finished_sums);
            summed = 0;
        }
        let footprint = &near.footprints[i % CHECKPOINT_EVERY];
        let splat = footprint.lanes(simd, corner[1]);
        let colour = if C == 0 { view.colour(gaussian) } else { &near.colours[i % CHECKPOINT_EVERY] };
        let mut reached = 0;
        let [middle, half] = footprint.bounds();
        let window = TileWindow::around(blocks.met(simd, middle, half));
        let mut colour_lanes = colour_lanes::<S, F, C>(simd, colour);
        let hidden;
        let mut colour = colour;
        if !(view.finite || is_finite(colour)) {
            add_visible::<S, F, P, LONG>(
                thresholds,
                (&splat, &window, &pixels),
                (colour, view.depth),
                &transmittance,
                sums,
            );
            // They are added.
            colour_lanes = [thresholds.zero; C];
            hidden = vec![F::ZERO; channels];
            colour = &hidden;
        }
        for part in (window.first_column * SIMD_BLOCK..window.end_column * SIMD_BLOCK).step_by(len::<S, F>()) {
            let column = splat.column(pixels.x(simd, part));
            for row in (window.first_row..window.end_row).step_by(SIMD_ROWS) {
                let place = row * TILE_SIZE + part;
                let before = transmittance.load::<S, LONG>(simd, place);
                let layer = thresholds.layer::<_, LONG>(&splat, (&column, &pixels, place), before);
                reached |= if layer.near.any_true() { 1 << (place / SIMD_BLOCK) } else { 0 };
                transmittance.store::<S, LONG>(layer.transmittance, place);
                let weight = layer.alpha * before[0];
                for (channel, sum) in sums.iter_mut().enumerate() {
                    let mut colour =
                        if C == 0 { F::Block::<S>::splat(simd, colour[channel]) } else { colour_lanes[channel] };
                    if P::ALONG_RAYS && view.depth && channel + 1 == channels {
                        colour *= layer.depth_factor;
                    }
                    store(weight.mul_add(colour, lanes(simd, sum, place)), sum, place);
                }
                open -= layer.finished;
            }
        }
        summed += usize::from(reached != 0);
        if let Some(trace) = trace.as_deref_mut() {
            trace.reached.push(reached);
        }
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

/// Adds the colours of a Gaussian, not all of which are finite, to the `sums` of the pixels that see it.
#[inline(always)]
fn add_visible<S: Simd, F: Real, P: Footprint<F>, const LONG: bool>(
    thresholds: &Thresholds<S, F>,
    (splat, window, pixels): (&P::Broadcast<S>, &TileWindow, &TilePixels<F>),
    (colour, depth): (&[F], bool),
    transmittance: &Transmittances<F>,
    sums: &mut [Plane<F>],
) {
    let (simd, channels) = (thresholds.zero.token(), colour.len());
    for part in (window.first_column * SIMD_BLOCK..window.end_column * SIMD_BLOCK).step_by(len::<S, F>()) {
        let column = splat.column(pixels.x(simd, part));
        for row in (window.first_row..window.end_row).step_by(SIMD_ROWS) {
            let place = row * TILE_SIZE + part;
            let before = transmittance.load::<S, LONG>(simd, place);
            let layer = thresholds.layer::<_, LONG>(splat, (&column, pixels, place), before);
            let shows = layer.alpha.simd_gt(thresholds.zero);
            for (channel, (sum, &colour)) in sums.iter_mut().zip(colour).enumerate() {
                let mut colour = F::Block::<S>::splat(simd, colour);
                if P::ALONG_RAYS && depth && channel + 1 == channels {
                    colour *= layer.depth_factor;
                }
                let sum_before = lanes(simd, sum, place);
                let sum_behind = (layer.alpha * before[0]).mul_add(colour, sum_before);
                store(shows.select(sum_behind, sum_before), sum, place);
            }
        }
    }
}
