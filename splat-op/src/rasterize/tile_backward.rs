//! Backward pass of the CPU twin over one tile. It takes chunks of Gaussians from the last to the first. Each chunk
//! runs forwards again from its checkpoint, then back to front.
//!
//! The gradient of the picture's planes at a pixel, `g`, is the same for every layer, so the recursion needs one number
//! per pixel instead of one per plane: `ρᵢ = g·Rᵢ = αᵢ (g·cᵢ) + (1 − αᵢ) ρᵢ₊₁`, and `∂L/∂αᵢ = Tᵢ (g·cᵢ − ρᵢ₊₁)`.

use fearless_simd::prelude::*;

use super::footprint::{Footprint, FootprintSimd};
use super::tile::{
    BLOCK, BLOCK_ROW, CHECKPOINT_EVERY, Near, Plane, Thresholds, TileTrace, TileView, Transmittances, centres,
    colour_lanes, is_finite, lanes, len, store,
};
use crate::intersect::TILE_PIXELS;
use crate::simd::real::Real;

/// Number of values per intersection that do not depend on the channels: the sums of `h, h u, h v, h u², h u v, h v²`
/// with `h = α ∂L/∂α` where alpha is not at its limit.
pub(crate) const MOMENTS: usize = 6;

/// Inputs of a tile's backward pass besides its [`TileView`].
pub(super) struct TileGrad<'a, F> {
    /// `[channels + 1, 256]`: gradients of the sums `Σ w c` and of alpha; zero outside the picture.
    pub planes: &'a [Plane<F>],
    /// `[256]`: `g · background`, the start of the recursion.
    pub background_rho: &'a [F],
    pub trace: &'a TileTrace<F>,
    /// Whether the sums of absolute values are wanted.
    pub absolute: bool,
    /// Whether all colours of all Gaussians are finite.
    pub finite: bool,
}

/// Buffers that one thread reuses from tile to tile, sized for a chunk whose Gaussians show in every pixel.
pub(super) struct TileScratch<F> {
    /// Transmittances before a Gaussian, then its alphas, for each pair of a Gaussian of the chunk and a vector of pixels that
    /// it reaches. The last pass over the Gaussian replaces the transmittances by its weights.
    layers: Vec<F>,
    /// Place in the tile of each pair's pixels.
    places: Vec<u16>,
    /// First pair of each Gaussian of the chunk.
    starts: [usize; CHECKPOINT_EVERY + 1],
}

/// The least number of lanes of a vector, that of f64.
const LEAST: usize = 8;

/// The blocks of a tile's first column, a bit for each.
const FIRST_COLUMN: u16 = 0x5555;

impl<F: Real> Default for TileScratch<F> {
    fn default() -> Self {
        const VALUES: usize = CHECKPOINT_EVERY * TILE_PIXELS;
        Self { layers: vec![F::ZERO; 2 * VALUES], places: vec![0; VALUES / LEAST], starts: [0; CHECKPOINT_EVERY + 1] }
    }
}

/// Fills `intersections`, `[layers, MOMENTS + channels (+ 2)]`, with each intersection's sums over the tile. Sets
/// `final_transmittance` to the transmittances behind all layers (negated where finished).
#[inline(always)]
pub(super) fn rasterize_tile_backward<S: Simd, F: Real, const C: usize, const LONG: bool>(
    simd: S,
    view: &TileView<F>,
    grad: &TileGrad<F>,
    thresholds: &Thresholds<S, F>,
    (intersections, final_transmittance): (&mut [F], &mut [F; TILE_PIXELS]),
    scratch: &mut TileScratch<F>,
) {
    let channels = if C == 0 { view.channels } else { C };
    let columns = MOMENTS + channels + if grad.absolute { 2 } else { 0 };
    // `ρ` has two parts, like the transmittances.
    let mut rho = Transmittances::new([F::ZERO; TILE_PIXELS]);
    rho.kept.copy_from_slice(grad.background_rho);
    let TileTrace { reached, checkpoints } = grad.trace;
    let chunks = reached.len().div_ceil(CHECKPOINT_EVERY);
    let x = centres(view.corner()[0]);
    *final_transmittance = view.open_transmittance();
    for chunk in (0..chunks).rev() {
        let first = chunk * CHECKPOINT_EVERY;
        let reached = &reached[first..reached.len().min(first + CHECKPOINT_EVERY)];
        let gaussians = &view.gaussians[first..first + reached.len()];
        let mut transmittance = match chunk {
            0 => Transmittances::new(view.open_transmittance()),
            _ => Transmittances::resume::<LONG>(checkpoints, chunk - 1),
        };
        let mut near = Near::<F, C>::default();
        near.gather(view, gaussians);
        forwards::<S, F, LONG>(thresholds, view.corner(), (&near.footprints, reached), &mut transmittance, scratch);
        if chunk + 1 == chunks {
            *final_transmittance = transmittance.kept;
        }
        for (i, &gaussian) in gaussians.iter().enumerate().rev() {
            let layers = scratch.starts[i]..scratch.starts[i + 1];
            if layers.is_empty() {
                continue;
            }
            let row = &mut intersections[(first + i) * columns..(first + i + 1) * columns];
            let pair = 2 * len::<S, F>();
            let layers = (&mut scratch.layers[layers.start * pair..layers.end * pair], &scratch.places[layers]);
            let splat = FootprintSimd::new(simd, near.footprints[i], view.corner()[1]);
            let colour = if C == 0 { view.colour(gaussian) } else { &near.colours[i] };
            backwards::<S, F, C, LONG>(grad, (&splat, colour, thresholds), &x, layers, (&mut rho, row));
        }
    }
}

/// Runs the forward pass over one chunk, in the blocks that each Gaussian is known to reach, and stores the layers.
#[inline(always)]
fn forwards<S: Simd, F: Real, const LONG: bool>(
    thresholds: &Thresholds<S, F>,
    corner: [F; 2],
    (near, reached): (&[Footprint<F>], &[u16]),
    transmittance: &mut Transmittances<F>,
    scratch: &mut TileScratch<F>,
) {
    let simd = thresholds.alpha_max.token();
    let mut met = 0;
    let x = centres(corner[0]);
    for (i, (&footprint, &reached)) in near.iter().zip(reached).enumerate() {
        scratch.starts[i] = met;
        let splat = FootprintSimd::new(simd, footprint, corner[1]);
        for first in (0..BLOCK_ROW).step_by(BLOCK) {
            let in_column = reached & FIRST_COLUMN << (first / BLOCK);
            if in_column == 0 {
                continue;
            }
            for part in (0..BLOCK).step_by(len::<S, F>()) {
                let column = splat.column(lanes(simd, &x, first + part));
                let mut blocks = in_column;
                while blocks != 0 {
                    let place = blocks.trailing_zeros() as usize * BLOCK + part;
                    blocks &= blocks - 1;
                    let before = transmittance.load::<S, LONG>(simd, place);
                    let layer = thresholds.layer::<LONG>(&splat, &column, place, before);
                    transmittance.store::<S, LONG>(layer.transmittance, place);
                    store(before[0], &mut scratch.layers, met * 2 * len::<S, F>());
                    store(layer.alpha, &mut scratch.layers, (met * 2 + 1) * len::<S, F>());
                    scratch.places[met] = place as u16;
                    met += 1;
                }
            }
        }
    }
    scratch.starts[reached.len()] = met;
}

/// Passes one Gaussian back to front: writes its sums over the pixels that it shows in to `row`, and updates `rho` to
/// its value in front of the Gaussian.
#[inline(always)]
fn backwards<S: Simd, F: Real, const C: usize, const LONG: bool>(
    grad: &TileGrad<F>,
    (splat, colour, thresholds): (&FootprintSimd<S, F>, &[F], &Thresholds<S, F>),
    x: &[F; BLOCK_ROW],
    (layers, places): (&mut [F], &[u16]),
    (rho, row): (&mut Transmittances<F>, &mut [F]),
) {
    let alpha_max = thresholds.alpha_max;
    let simd = alpha_max.token();
    let channels = if C == 0 { colour.len() } else { C };
    let zero = F::Block::<S>::splat(simd, F::ZERO);
    let planes = &grad.planes[..=channels];
    let plane = |channel: usize, place: usize| lanes::<S, F>(simd, &planes[channel], place);
    let mut moments = [zero; MOMENTS];
    let mut absolute = [zero; 2];
    let mut features = [zero; C];
    let colour_lanes = colour_lanes::<S, F, C>(simd, colour);
    let finite = grad.finite || is_finite(colour);
    let slope = splat.inverse_v * splat.footprint.shear;
    let layer_len = 2 * len::<S, F>();
    for (i, &place) in places.iter().enumerate() {
        let (layer, place) = (&mut layers[i * layer_len..][..layer_len], place as usize);
        let [behind, lost] = rho.load::<S, LONG>(simd, place);
        let before = lanes::<S, F>(simd, layer, 0);
        let alpha = lanes::<S, F>(simd, layer, len::<S, F>());
        let mut along = plane(channels, place);
        for channel in 0..channels {
            let colour = if C == 0 { F::Block::<S>::splat(simd, colour[channel]) } else { colour_lanes[channel] };
            along = plane(channel, place).mul_add(colour, along);
        }
        let weight = alpha * before;
        let mut ahead = along - behind;
        if !finite {
            ahead = alpha.simd_gt(zero).select(ahead, zero);
        }
        let change = if LONG { alpha.mul_add(ahead, (-alpha).mul_add(lost, lost)) } else { alpha * ahead };
        let stepped = if LONG { behind + change } else { alpha.mul_add(ahead, behind) };
        rho.store::<S, LONG>([stepped, change - (stepped - behind)], place);
        let free = alpha.simd_lt(alpha_max);
        let h = free.select(weight * ahead, zero);

        let column = splat.column(lanes(simd, x, place % BLOCK_ROW));
        let (u, v) = (column.u, splat.v(&column, thresholds.rows(place)));
        let (hu, hv) = (h * u, h * v);
        moments[0] += h;
        moments[1] += hu;
        moments[2] += hv;
        moments[3] = hu.mul_add(u, moments[3]);
        moments[4] = hu.mul_add(v, moments[4]);
        moments[5] = hv.mul_add(v, moments[5]);
        if grad.absolute {
            absolute[0] += (hu * splat.inverse_u - hv * slope).abs();
            absolute[1] += (hv * splat.inverse_v).abs();
        }
        if C == 0 {
            store(weight, layer, 0);
        } else {
            for channel in 0..C {
                features[channel] = plane(channel, place).mul_add(weight, features[channel]);
            }
        }
    }
    for (out, sum) in row.iter_mut().zip(moments) {
        *out = sum.reduce_sum();
    }
    for channel in 0..channels {
        let sum = if C == 0 {
            let mut sum = zero;
            for (i, &place) in places.iter().enumerate() {
                sum = plane(channel, place as usize).mul_add(lanes::<S, F>(simd, &layers[i * layer_len..], 0), sum);
            }
            sum
        } else {
            features[channel]
        };
        row[MOMENTS + channel] = sum.reduce_sum();
    }
    if grad.absolute {
        row[MOMENTS + channels] = absolute[0].reduce_sum();
        row[MOMENTS + channels + 1] = absolute[1].reduce_sum();
    }
}
