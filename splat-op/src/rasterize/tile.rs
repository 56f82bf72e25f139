//! Forward pass of the CPU twin over one tile, and the arithmetic of a layer. Both passes share that arithmetic, so
//! that the backward pass sees the very bits of the forward pass.

use fearless_simd::prelude::*;

use super::footprint::{Column, Footprint, FootprintSimd, ROWS, TileBlocks, TileWindow, WIDTH};
use crate::intersect::{TILE, TILE_PIXELS};
use crate::simd::real::{EXP2_CONSTANTS, Real};

/// Number of pixels in a block of a tile.
pub(crate) const BLOCK: usize = WIDTH * ROWS;

/// Number of pixels in a row of blocks.
pub(crate) const BLOCK_ROW: usize = ROWS * TILE;

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
    const LONG: usize = 2048;
    const LONG_FOR_FAINT: usize = 256;
    intersections > if alpha_min >= F::of(1e-3) { LONG } else { LONG_FOR_FAINT }
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

/// One value for each pixel of a tile: block by block, within a block row by row. The blocks run along x, then y.
pub(crate) type Plane<F> = [F; TILE_PIXELS];

/// Brings values in the order of a tile's rows into the order of its blocks.
#[inline(always)]
pub(crate) fn in_blocks<F: Real>(rows: &Plane<F>) -> Plane<F> {
    let mut plane = [F::ZERO; TILE_PIXELS];
    for (eight, values) in rows.as_chunks::<WIDTH>().0.iter().enumerate() {
        plane.as_chunks_mut::<WIDTH>().0[in_block_order(eight)] = *values;
    }
    plane
}

/// The inverse of [`in_blocks`].
#[inline(always)]
pub(crate) fn in_rows<F: Real>(plane: &Plane<F>) -> Plane<F> {
    let mut rows = [F::ZERO; TILE_PIXELS];
    for (eight, values) in rows.as_chunks_mut::<WIDTH>().0.iter_mut().enumerate() {
        *values = plane.as_chunks::<WIDTH>().0[in_block_order(eight)];
    }
    rows
}

/// Returns the place, in the order of blocks, of the eight pixels at place `eight` in the order of rows.
pub(crate) const fn in_block_order(eight: usize) -> usize {
    let (row, column) = (eight / (TILE / WIDTH), eight % (TILE / WIDTH));
    (row / ROWS * (TILE / WIDTH) + column) * ROWS + row % ROWS
}

/// Number of lanes of a vector of pixels.
#[inline(always)]
pub(crate) const fn len<S: Simd, F: Real>() -> usize {
    <F::Block<S> as SimdBase<S>>::LEN
}

/// Returns a vector of pixels from `place` on, a multiple of its length.
#[inline(always)]
pub(crate) fn lanes<S: Simd, F: Real>(simd: S, plane: &[F], place: usize) -> F::Block<S> {
    F::Block::<S>::from_slice(simd, &plane[place..place + len::<S, F>()])
}

#[inline(always)]
pub(crate) fn store<S: Simd, L: SimdFloat<S>>(lanes: L, plane: &mut [L::Element], place: usize) {
    lanes.store_slice(&mut plane[place..place + L::LEN]);
}

/// Thresholds of the render, one copy in each lane.
pub(super) struct Thresholds<S: Simd, F: Real> {
    alpha_min: F::Block<S>,
    pub alpha_max: F::Block<S>,
    transmittance_min: F::Block<S>,
    zero: F::Block<S>,
    /// The row of each pixel of a tile.
    rows: Plane<F>,
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
            rows: pixel_rows(),
            // The constants stay in memory, where instructions read them as operands; the compiler would rebuild them
            // each time.
            exp2: std::hint::black_box(exp2),
        }
    }

    /// Rows of a vector of pixels.
    #[inline(always)]
    pub fn rows(&self, place: usize) -> F::Block<S> {
        lanes(self.zero.token(), &self.rows, place)
    }

    /// Passes one Gaussian over the vector of pixels of a column at `place`. Returns their alphas (zero where it does not
    /// show) and their transmittances behind it, negated where a pixel is finished.
    #[inline(always)]
    pub fn layer<const LONG: bool>(
        &self,
        splat: &FootprintSimd<S, F>,
        column: &Column<S, F>,
        place: usize,
        before: [F::Block<S>; 2],
    ) -> LayerSimd<S, F> {
        let v = splat.v(column, self.rows(place));
        let q = v.mul_add(v, column.square);
        let near = q.simd_le(splat.extent) & before[0].simd_ge(self.zero);
        // A branch on whether the Gaussian reaches any of the pixels would be mispredicted too often.
        let power = F::exp2_lanes(q, &self.exp2);
        let value = (splat.opacity * power).min(self.alpha_max);
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
        LayerSimd { alpha, transmittance: after, near, finished }
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
    /// Number of pixels that the Gaussian finishes.
    pub finished: usize,
}

/// Position of a tile and the Gaussians that it lists.
#[derive(Clone, Copy)]
pub(super) struct TileView<'a, F> {
    /// First pixel of the tile.
    pub origin: [usize; 2],
    /// Number of the tile's pixels inside the picture along x and y.
    pub size: [usize; 2],
    /// Gaussians of the tile's intersections, front to back.
    pub gaussians: &'a [u32],
    /// Footprint of each Gaussian.
    pub footprints: &'a [Footprint<F>],
    /// `[N, channels]`: colours of each Gaussian.
    pub colours: &'a [F],
    pub channels: usize,
    /// Whether all colours of all Gaussians are finite.
    pub finite: bool,
}

impl<F: Real> TileView<'_, F> {
    #[inline(always)]
    pub fn corner(&self) -> [F; 2] {
        self.origin.map(|px| F::of(px as f64))
    }

    #[inline(always)]
    pub fn colour(&self, gaussian: u32) -> &[F] {
        let first = gaussian as usize * self.channels;
        &self.colours[first..first + self.channels]
    }

    #[inline(always)]
    pub fn open_transmittance(&self) -> [F; TILE_PIXELS] {
        open_transmittance(self.size)
    }
}

/// Returns the initial transmittances of a tile that has `size` pixels inside the picture: one inside, finished outside.
#[inline(always)]
pub(crate) fn open_transmittance<F: Real>(size: [usize; 2]) -> Plane<F> {
    let mut transmittance = [-F::ONE; TILE_PIXELS];
    for row in transmittance.chunks_exact_mut(TILE).take(size[1]) {
        row[..size[0]].fill(F::ONE);
    }
    in_blocks(&transmittance)
}

/// Returns the row of each pixel of a tile.
#[inline(always)]
pub(crate) fn pixel_rows<F: Real>() -> Plane<F> {
    let mut rows = [F::ZERO; TILE_PIXELS];
    for (number, row) in rows.as_chunks_mut::<TILE>().0.iter_mut().enumerate() {
        *row = [F::of(number as f64); TILE];
    }
    in_blocks(&rows)
}

/// Gaussians of a tile, copied side by side. They are scattered in memory; fetched together, their latencies overlap.
pub(super) struct Near<F, const C: usize> {
    pub footprints: [Footprint<F>; CHECKPOINT_EVERY],
    /// Colours, if the number of channels is known at compile time.
    pub colours: [[F; C]; CHECKPOINT_EVERY],
}

impl<F: Real, const C: usize> Default for Near<F, C> {
    #[inline(always)]
    fn default() -> Self {
        Self { footprints: [Footprint::default(); CHECKPOINT_EVERY], colours: [[F::ZERO; C]; CHECKPOINT_EVERY] }
    }
}

impl<F: Real, const C: usize> Near<F, C> {
    /// Copies the first [`CHECKPOINT_EVERY`] of `gaussians`.
    #[inline(always)]
    pub fn gather(&mut self, view: &TileView<F>, gaussians: &[u32]) {
        for ((footprint, colour), &gaussian) in self.footprints.iter_mut().zip(&mut self.colours).zip(gaussians) {
            *footprint = view.footprints[gaussian as usize];
            if C > 0 {
                colour.copy_from_slice(&view.colour(gaussian)[..C]);
            }
        }
    }
}

/// Centres along x, px, of the pixels of a row of blocks.
#[inline(always)]
pub(crate) fn centres<F: Real>(left: F) -> [F; BLOCK_ROW] {
    std::array::from_fn(|place| left + F::of((place / BLOCK * WIDTH + place % WIDTH) as f64 + 0.5))
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
    // Within a chunk without branches, in vectors.
    colours.chunks(256).all(|chunk| chunk.iter().fold(true, |all, value| all & value.finite()))
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
pub(super) fn rasterize_tile<S: Simd, F: Real, const C: usize, const LONG: bool>(
    simd: S,
    view: &TileView<F>,
    thresholds: &Thresholds<S, F>,
    planes: &mut [F],
    mut trace: Option<&mut TileTrace<F>>,
) {
    let channels = if C == 0 { view.channels } else { C };
    let corner = view.corner();
    let (x, blocks) = (centres(corner[0]), TileBlocks::new(corner));
    let mut transmittance = Transmittances::new(view.open_transmittance());
    let mut open = view.size[0] * view.size[1];
    let (sums, final_transmittance) = planes.as_chunks_mut::<TILE_PIXELS>().0.split_at_mut(channels);
    sums.as_flattened_mut().fill(F::ZERO);
    let mut finished_sums = Vec::new();
    let mut near = Near::<F, C>::default();
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
        let splat = FootprintSimd::new(simd, near.footprints[i % CHECKPOINT_EVERY], corner[1]);
        let colour = if C == 0 { view.colour(gaussian) } else { &near.colours[i % CHECKPOINT_EVERY] };
        let mut reached = 0;
        let footprint = &splat.footprint;
        let window = TileWindow::around(blocks.met(simd, footprint.mean_px, footprint.half));
        let hidden;
        let colour = if view.finite || is_finite(colour) {
            colour
        } else {
            add_visible::<S, F, LONG>(thresholds, (&splat, &window, &x), colour, &transmittance, sums);
            hidden = vec![F::ZERO; channels];
            &hidden[..]
        };
        let colour_lanes = colour_lanes::<S, F, C>(simd, colour);
        for part in (window.first_column * BLOCK..window.end_column * BLOCK).step_by(len::<S, F>()) {
            let column = splat.column(lanes(simd, &x, part));
            for row in (window.first_row..window.end_row).step_by(ROWS) {
                let place = row * TILE + part;
                let before = transmittance.load::<S, LONG>(simd, place);
                let layer = thresholds.layer::<LONG>(&splat, &column, place, before);
                reached |= if layer.near.any_true() { 1 << (place / BLOCK) } else { 0 };
                transmittance.store::<S, LONG>(layer.transmittance, place);
                let weight = layer.alpha * before[0];
                for (channel, sum) in sums.iter_mut().enumerate() {
                    let colour =
                        if C == 0 { F::Block::<S>::splat(simd, colour[channel]) } else { colour_lanes[channel] };
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
fn add_visible<S: Simd, F: Real, const LONG: bool>(
    thresholds: &Thresholds<S, F>,
    (splat, window, x): (&FootprintSimd<S, F>, &TileWindow, &[F; BLOCK_ROW]),
    colour: &[F],
    transmittance: &Transmittances<F>,
    sums: &mut [Plane<F>],
) {
    let simd = thresholds.zero.token();
    for part in (window.first_column * BLOCK..window.end_column * BLOCK).step_by(len::<S, F>()) {
        let column = splat.column(lanes(simd, x, part));
        for row in (window.first_row..window.end_row).step_by(ROWS) {
            let place = row * TILE + part;
            let before = transmittance.load::<S, LONG>(simd, place);
            let layer = thresholds.layer::<LONG>(splat, &column, place, before);
            let shows = layer.alpha.simd_gt(thresholds.zero);
            for (sum, &colour) in sums.iter_mut().zip(colour) {
                let colour = F::Block::<S>::splat(simd, colour);
                let sum_before = lanes(simd, sum, place);
                let sum_behind = (layer.alpha * before[0]).mul_add(colour, sum_before);
                store(shows.select(sum_behind, sum_before), sum, place);
            }
        }
    }
}
