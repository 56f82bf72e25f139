//! The arithmetic of a layer in the CPU twin. Both passes share it, so that the backward pass sees the very bits of the forward pass.

use fearless_simd::prelude::*;

use super::pixels::{TilePixels, lanes, store};
use super::splat_cpu::FootprintLanes;
use crate::intersect::TILE_PIXELS;
use crate::simd::real::{EXP2_CONSTANTS, Real};

/// Whether a list of intersections is rasterized with [`Transmittances::lost`] and shorter partial sums, which takes a fifth longer.
/// Otherwise roundings do not add up to a difference that an f32 picture can show: the list is short enough, and if it is not very short,
/// no layer is so faint that it alone would change no digit. Only rounding depends on this choice.
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
    pub zero: F::Block<S>,
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
            // The constants stay in memory, where instructions read them as operands; the compiler would rebuild them each time.
            exp2: std::hint::black_box(exp2),
        }
    }

    /// Passes one Gaussian over the vector of pixels of a column at `place`. Returns their alphas (zero where it does not
    /// show) and their transmittances behind it, negated where a pixel is finished.
    #[inline(always)]
    pub fn layer<P: FootprintLanes<S, F>, const LONG: bool>(
        &self,
        splat: &P,
        column: &P::Column,
        pixels: &TilePixels<F>,
        place: usize,
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

/// `T (1 − α)`, in two parts. `1 − α` is not computed: its rounding would be the same for all layers of one faint alpha.
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
