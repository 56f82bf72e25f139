//! One tile of the picture, forwards: the arithmetic of a layer, shared by both passes of the CPU twin so that the
//! backward pass sees the very bits of the forward pass.

use fearless_simd::prelude::*;

use crate::project::Ellipse;
use crate::real::{LANES, Real};
use crate::tile::cpu::{half_extent, whitened_limit};
use crate::tile::{TILE, TILE_PIXELS};

/// Vectors along a row of a tile.
pub(super) const ROW_VECTORS: usize = TILE / LANES;

/// The transmittance of a tile is kept each time this many Gaussians have been passed.
pub(super) const CHECKPOINT_EVERY: usize = 64;

/// Sums over more Gaussians than this are sums of such sums: one by one in f32, the last of 10,000 faint layers would be
/// too small to change the sum.
const SUM_LENGTH: usize = 8 * CHECKPOINT_EVERY;

/// Whether a list of hits is blended with [`Transmittances::lost`] and shorter sums. That takes a fifth longer. Where it is
/// not, roundings do not add up to what an f32 picture can show: lists are short enough, or if they are not very short, no
/// layer is so faint that it alone would change no digit. Nothing but rounding depends on it.
pub(super) fn is_long<F: Real>(hits: usize, alpha_min: F) -> bool {
    const LONG: usize = 2048;
    const LONG_FOR_FAINT: usize = 256;
    hits > if alpha_min >= F::of(1e-3) { LONG } else { LONG_FOR_FAINT }
}

/// The transmittances of a tile's pixels, in two parts: `lost` is what rounding took from `kept`, less than half an ulp of it.
/// Without it the roundings of many layers add up.
///
/// Functions with the parameter `LONG`, see [`is_long`], leave it zero where that is false.
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

    /// Appends what [`Self::resume`] needs.
    pub fn keep<const LONG: bool>(&self, checkpoints: &mut Vec<F>) {
        checkpoints.extend_from_slice(&self.kept);
        if LONG {
            checkpoints.extend_from_slice(&self.lost);
        }
    }

    /// As they were at a checkpoint, by its number.
    pub fn resume<const LONG: bool>(checkpoints: &[F], number: usize) -> Self {
        let parts = if LONG { 2 } else { 1 };
        let part = |part: usize| {
            let first = (parts * number + part) * TILE_PIXELS;
            std::array::from_fn(|pixel| checkpoints[first + pixel])
        };
        Self { kept: part(0), lost: if LONG { part(1) } else { [F::ZERO; TILE_PIXELS] } }
    }

    /// Both parts of eight pixels.
    #[inline(always)]
    pub fn load<S: Simd, const LONG: bool>(&self, simd: S, first: usize) -> [F::Lanes<S>; 2] {
        let part = |part: &[F]| F::Lanes::<S>::from_slice(simd, &part[first..first + LANES]);
        [part(&self.kept), if LONG { part(&self.lost) } else { F::Lanes::<S>::splat(simd, F::ZERO) }]
    }

    #[inline(always)]
    pub fn store<S: Simd, const LONG: bool>(&mut self, [kept, lost]: [F::Lanes<S>; 2], first: usize) {
        kept.store_slice(&mut self.kept[first..first + LANES]);
        if LONG {
            lost.store_slice(&mut self.lost[first..first + LANES]);
        }
    }
}

/// An ellipse as `blend` reads it, in what its pixels' loop multiplies by.
#[derive(Clone, Copy, Default)]
pub(super) struct Footprint<F> {
    pub mean_px: [F; 2],
    pub inverse_u: F,
    pub inverse_v: F,
    pub shear: F,
    pub opacity: F,
    /// Exponents below this give an alpha below `alpha_min` for certain.
    pub exponent_min: F,
    /// Half the bounding box, px.
    pub half: [F; 2],
}

impl<F: Real> Footprint<F> {
    pub fn new(ellipse: &Ellipse<F>, alpha_min: F) -> Self {
        let limit = whitened_limit(ellipse.opacity, alpha_min) * F::of(1.0 + 1e-5) + F::of(1e-4);
        Self {
            mean_px: ellipse.mean_px,
            inverse_u: F::ONE / ellipse.sigma_u,
            inverse_v: F::ONE / ellipse.sigma_v,
            shear: ellipse.shear,
            opacity: ellipse.opacity,
            exponent_min: -limit * F::of(0.5),
            half: half_extent(ellipse, limit),
        }
    }

    /// The rows and the vectors along a row of the tile at `origin` px that the bounding box meets.
    #[inline(always)]
    pub fn window(&self, origin: [F; 2]) -> Window {
        // Pixel `i` has its centre at `origin + i + 0.5`; the margin covers rounding.
        let span = |axis: usize| {
            let margin = F::of(0.01) + F::of(8.0) * F::EPSILON * (self.mean_px[axis].abs() + self.half[axis]);
            let centre = self.mean_px[axis] - origin[axis] - F::of(0.5);
            let last = F::of((TILE - 1) as f64);
            let low = (centre - self.half[axis] - margin).within(F::ZERO, last + F::ONE);
            let high = (centre + self.half[axis] + margin).within(-F::ONE, last);
            // Truncation only lowers `low`; `high + 1` is positive or zero.
            (low.f64() as usize, (high + F::ONE).f64() as usize)
        };
        let ((first_pixel, end_pixel), (first_row, end_row)) = (span(0), span(1));
        Window {
            first_row,
            end_row,
            first_vector: first_pixel / LANES,
            end_vector: end_pixel.div_ceil(LANES).min(ROW_VECTORS),
        }
    }
}

/// Part of a tile.
#[derive(Clone, Copy)]
pub(super) struct Window {
    pub first_row: usize,
    pub end_row: usize,
    pub first_vector: usize,
    pub end_vector: usize,
}

/// A Gaussian's constants, one copy in each lane.
#[derive(Clone, Copy)]
pub(super) struct Splat<S: Simd, F: Real> {
    simd: S,
    pub footprint: Footprint<F>,
    mean_x: F::Lanes<S>,
    pub inverse_u: F::Lanes<S>,
    pub inverse_v: F::Lanes<S>,
    shear: F::Lanes<S>,
    opacity: F::Lanes<S>,
    exponent_min: F::Lanes<S>,
}

impl<S: Simd, F: Real> Splat<S, F> {
    #[inline(always)]
    pub fn new(simd: S, footprint: Footprint<F>) -> Self {
        let lanes = |value| F::Lanes::<S>::splat(simd, value);
        Self {
            simd,
            footprint,
            mean_x: lanes(footprint.mean_px[0]),
            inverse_u: lanes(footprint.inverse_u),
            inverse_v: lanes(footprint.inverse_v),
            shear: lanes(footprint.shear),
            opacity: lanes(footprint.opacity),
            exponent_min: lanes(footprint.exponent_min),
        }
    }

    /// `u, v` of the pixels with centres `x` on the row with centre `y`, px.
    #[inline(always)]
    pub fn whiten(&self, x: F::Lanes<S>, y: F) -> (F::Lanes<S>, F::Lanes<S>) {
        let dx = x - self.mean_x;
        let dy = F::Lanes::<S>::splat(self.simd, y - self.footprint.mean_px[1]);
        (dx * self.inverse_u, (-self.shear).mul_add(dx, dy) * self.inverse_v)
    }
}

/// Thresholds of the render, one copy in each lane.
#[derive(Clone, Copy)]
pub(super) struct Thresholds<S: Simd, F: Real> {
    alpha_min: F::Lanes<S>,
    pub alpha_max: F::Lanes<S>,
    transmittance_min: F::Lanes<S>,
    zero: F::Lanes<S>,
}

impl<S: Simd, F: Real> Thresholds<S, F> {
    #[inline(always)]
    pub fn new(simd: S, alpha_min: F, alpha_max: F, transmittance_min: F) -> Self {
        let lanes = |value| F::Lanes::<S>::splat(simd, value);
        // A threshold of zero leaves out nothing, not even what is behind an alpha of one.
        let never = if transmittance_min > F::ZERO { transmittance_min } else { -F::ONE };
        Self {
            alpha_min: lanes(alpha_min),
            alpha_max: lanes(alpha_max),
            transmittance_min: lanes(never),
            zero: lanes(F::ZERO),
        }
    }

    /// Passes one Gaussian over eight pixels: their alphas (zero where it does not show) and their transmittances
    /// behind it. A pixel that is finished has its transmittance negated; `None` if the Gaussian shows in no pixel and
    /// finishes none.
    #[inline(always)]
    pub fn layer<const LONG: bool>(
        &self,
        splat: &Splat<S, F>,
        (u, v): (F::Lanes<S>, F::Lanes<S>),
        [transmittance, lost]: [F::Lanes<S>; 2],
    ) -> Option<Layer<S, F>> {
        let half = F::Lanes::<S>::splat(splat.simd, F::of(-0.5));
        let exponent = u.mul_add(u, v * v) * half;
        let near = exponent.simd_ge(splat.exponent_min) & transmittance.simd_ge(self.zero);
        if !near.any_true() {
            return None;
        }
        let alpha = (splat.opacity * F::exp_lanes(exponent)).min(self.alpha_max);
        let shows = near & alpha.simd_ge(self.alpha_min);
        if !shows.any_true() {
            return None;
        }
        // `1 − α` would be rounded before it is used, for all layers of one faint alpha the same way.
        let [behind, lost_behind] = if LONG {
            // (T + lost)(1 − α) as Kahan (1965) adds.
            let change = (-alpha).mul_add(transmittance, (-alpha).mul_add(lost, lost));
            let behind = transmittance + change;
            [behind, change - (behind - transmittance)]
        } else {
            [(-alpha).mul_add(transmittance, transmittance), lost]
        };
        let finishes = shows & behind.simd_le(self.transmittance_min);
        let contributes = shows & !finishes;
        let alpha = contributes.select(alpha, self.zero);
        let kept = finishes.select(-transmittance, transmittance);
        let behind = [contributes.select(behind, kept), contributes.select(lost_behind, lost)];
        Some(Layer { alpha, behind, finishes })
    }
}

/// What a Gaussian did to eight pixels.
pub(super) struct Layer<S: Simd, F: Real> {
    pub alpha: F::Lanes<S>,
    /// Both parts of the transmittances behind it.
    pub behind: [F::Lanes<S>; 2],
    pub finishes: <F::Lanes<S> as SimdBase<S>>::Mask,
}

/// Where a tile lies, and which Gaussians it sees.
#[derive(Clone, Copy)]
pub(super) struct TileView<'a, F> {
    /// Its first pixel.
    pub origin: [usize; 2],
    /// Pixels of it inside the picture along x and y.
    pub size: [usize; 2],
    /// Gaussians of its hits, front to back.
    pub gaussians: &'a [u32],
    /// By Gaussian.
    pub footprints: &'a [Footprint<F>],
    /// `[N, channels]`, by Gaussian.
    pub colours: &'a [F],
    pub channels: usize,
}

impl<F: Real> TileView<'_, F> {
    #[inline(always)]
    pub fn corner(&self) -> [F; 2] {
        self.origin.map(|px| F::of(px as f64))
    }

    /// Copies the footprints of the next Gaussians side by side. They lie all over memory; fetched together, one wait
    /// serves them all.
    #[inline(always)]
    pub fn gather(&self, gaussians: &[u32], to: &mut [Footprint<F>; CHECKPOINT_EVERY]) {
        to.iter_mut().zip(gaussians).for_each(|(out, &gaussian)| *out = self.footprints[gaussian as usize]);
    }

    #[inline(always)]
    pub fn colour(&self, gaussian: u32) -> &[F] {
        let first = gaussian as usize * self.channels;
        &self.colours[first..first + self.channels]
    }

    /// One inside the picture, finished outside it.
    #[inline(always)]
    pub fn open_transmittance(&self) -> [F; TILE_PIXELS] {
        let mut transmittance = [-F::ONE; TILE_PIXELS];
        for row in transmittance.chunks_exact_mut(TILE).take(self.size[1]) {
            row[..self.size[0]].fill(F::ONE);
        }
        transmittance
    }
}

/// Pixel centres of a row of a tile, px.
#[inline(always)]
pub(super) fn centres<S: Simd, F: Real>(simd: S, left: F) -> [F::Lanes<S>; ROW_VECTORS] {
    std::array::from_fn(|vector| {
        F::Lanes::<S>::from_fn(simd, |lane| left + F::of((vector * LANES + lane) as f64 + 0.5))
    })
}

/// Adds to totals, each with what rounding took from it (Kahan 1965), and leaves zeros.
fn move_into<F: Real>(sums: &mut [F], totals: &mut [[F; 2]]) {
    for ([total, lost], sum) in totals.iter_mut().zip(sums) {
        let (change, before) = (*sum + *lost, *total);
        *total = before + change;
        *lost = change - (*total - before);
        *sum = F::ZERO;
    }
}

/// Blends a tile: `planes` gets `[channels + 1, 256]`, the sums `Σ w c` and the transmittance (positive). Returns how
/// many Gaussians were passed before all pixels were finished; `checkpoints`, if given, gets the transmittances before
/// each [`CHECKPOINT_EVERY`]th Gaussian but the first.
///
/// `C` is the number of channels where it is known at compile time, else zero.
#[inline(always)]
pub(super) fn blend_tile<S: Simd, F: Real, const C: usize, const LONG: bool>(
    simd: S,
    view: &TileView<F>,
    thresholds: &Thresholds<S, F>,
    planes: &mut [F],
    mut checkpoints: Option<&mut Vec<F>>,
) -> usize {
    let channels = if C == 0 { view.channels } else { C };
    let corner = view.corner();
    let x = centres::<S, F>(simd, corner[0]);
    let mut transmittance = Transmittances::new(view.open_transmittance());
    let mut open = view.size[0] * view.size[1];
    let sums = &mut planes[..channels * TILE_PIXELS];
    sums.fill(F::ZERO);
    let mut finished_sums = Vec::new();
    let mut passed = view.gaussians.len();
    let mut near = [Footprint::default(); CHECKPOINT_EVERY];
    for (i, &gaussian) in view.gaussians.iter().enumerate() {
        if i % CHECKPOINT_EVERY == 0 {
            view.gather(&view.gaussians[i..], &mut near);
            if i > 0 {
                if LONG || i % SUM_LENGTH == 0 {
                    finished_sums.resize(sums.len(), [F::ZERO; 2]);
                    move_into(sums, &mut finished_sums);
                }
                if let Some(checkpoints) = checkpoints.as_deref_mut() {
                    transmittance.keep::<LONG>(checkpoints);
                }
            }
        }
        let splat = Splat::new(simd, near[i % CHECKPOINT_EVERY]);
        let colour = view.colour(gaussian);
        let window = splat.footprint.window(corner);
        for row in window.first_row..window.end_row {
            let y = corner[1] + F::of(row as f64 + 0.5);
            for vector in window.first_vector..window.end_vector {
                let first = row * TILE + vector * LANES;
                let before = transmittance.load::<S, LONG>(simd, first);
                let Some(layer) = thresholds.layer::<LONG>(&splat, splat.whiten(x[vector], y), before) else {
                    continue;
                };
                transmittance.store::<S, LONG>(layer.behind, first);
                let weight = layer.alpha * before[0];
                for channel in 0..channels {
                    let at = channel * TILE_PIXELS + first;
                    let sum = F::Lanes::<S>::from_slice(simd, &sums[at..at + LANES]);
                    let colour = F::Lanes::<S>::splat(simd, colour[channel]);
                    weight.mul_add(colour, sum).store_slice(&mut sums[at..at + LANES]);
                }
                if layer.finishes.any_true() {
                    open -= layer.finishes.to_bitmask().count_ones() as usize;
                }
            }
        }
        if open == 0 {
            passed = i + 1;
            break;
        }
    }
    if !finished_sums.is_empty() {
        move_into(sums, &mut finished_sums);
        sums.iter_mut().zip(&finished_sums).for_each(|(sum, [total, _])| *sum = *total);
    }
    for (out, t) in planes[channels * TILE_PIXELS..].iter_mut().zip(transmittance.kept) {
        *out = t.abs();
    }
    passed
}
