//! Backward pass of the CPU twin over one tile. Each vector of pixels finds its layers as in the forward pass and goes through
//! them back to front. What it finds for each pair of a Gaussian and a vector of pixels is stored, and then summed Gaussian by
//! Gaussian, whatever the order of each pixel was.

use fearless_simd::prelude::*;

use super::footprint::{RayFootprint, RayLayerSimd, RayRules};
use super::order::{Ids, LayerSlots};
use super::tile::{Open, RayTile, TOGETHER};
use crate::depth_slope::DEPTH_SLOPE;
use crate::intersect::TILE_PIXELS;
use crate::rasterize::cpu::{MOMENTS, TilePlanes};
use crate::rasterize::tile::{Plane, lanes, len, store};
use crate::simd::real::Real;

/// Number of values that are stored before they are summed, unless one vector of pixels has more: 16 MiB in f32.
const STORED: usize = 1 << 22;

/// The largest number of vectors of pixels in a tile, that of f64.
const VECTORS: usize = 32;

/// Buffers that one thread reuses from tile to tile.
#[derive(Default)]
pub(super) struct RayScratch<F> {
    /// Key, then the transmittance before the layer; alpha; the layer's values along the gradient; the pair, by
    /// [`Real::from_index`].
    slots: LayerSlots<F, 4>,
    /// `h = α ∂L/∂α` where alpha is below its limit, and the weight `α T`, for each pair of a Gaussian and a vector of pixels that
    /// sees it.
    pairs: Vec<F>,
    /// Number of values in use of `pairs`.
    used: usize,
    /// A bit for each vector of pixels that stored a pair, by place in the list.
    seen_by: Vec<u32>,
}

/// What a tile's backward pass reads and writes.
pub(super) struct RayTileGrad<'a, F> {
    pub planes: &'a TilePlanes<F>,
    /// Whether depth is accumulated.
    pub depth: bool,
    /// Whether the sums of absolute values are wanted.
    pub absolute: bool,
}

/// Number of columns of a row: the moments, the channels, the depth slope and perhaps the absolute values.
pub(super) fn columns(channels: usize, absolute: bool) -> usize {
    MOMENTS + channels + DEPTH_SLOPE + if absolute { 2 } else { 0 }
}

/// Adds each intersection's sums over the tile to its row. Returns the transmittances behind all layers, negated where a pixel is
/// finished.
#[inline(always)]
pub(super) fn rasterize_tile_backward<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    grad: &RayTileGrad<F>,
    rows: &mut [F],
    scratch: &mut RayScratch<F>,
) -> Plane<F> {
    let mut transmittance = tile.open;
    // The first pair of each vector; it has as many as its list.
    let mut first = [0; VECTORS];
    scratch.seen_by.clear();
    scratch.seen_by.resize(tile.near.len(), 0);
    for place in (0..TILE_PIXELS).step_by(len::<S, F>()) {
        first[place / len::<S, F>()] = scratch.used;
        let behind = layers::<S, F, EXACT, SORTED>(simd, tile, rules, grad, place, scratch);
        store(behind, &mut transmittance, place);
        if scratch.used > STORED || place + len::<S, F>() == TILE_PIXELS {
            add_rows::<S, F, EXACT>(simd, tile, rules, grad, rows, (scratch, &first));
            scratch.used = 0;
        }
    }
    transmittance
}

/// Appends the pairs of the vector of pixels at `place`. Returns the transmittances behind all layers.
#[inline(always)]
fn layers<S: Simd, F: Real, const EXACT: bool, const SORTED: bool>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    grad: &RayTileGrad<F>,
    place: usize,
    scratch: &mut RayScratch<F>,
) -> F::Block<S> {
    let zero = F::Block::<S>::splat(simd, F::ZERO);
    let plane = |channel: usize| lanes::<S, F>(simd, &grad.planes.planes[channel], place);
    let alpha_plane = tile.channels + usize::from(grad.depth);
    let RayScratch { slots, pairs, used, seen_by } = scratch;
    let (pixels, list) = (tile.pixels(simd, place), tile.list(place));
    let mut seen = Open::<S, F>::new(lanes(simd, &tile.open, place));
    let mut ended = seen;
    let base = *used;
    *used += 2 * list.len() * len::<S, F>();
    if pairs.len() < *used {
        pairs.resize(2 * *used, F::ZERO);
    }
    let pairs = &mut pairs[base..*used];
    slots.clear();
    for (pair, &i) in list.iter().enumerate() {
        let splat = &tile.near[i as usize];
        let layer = rules.layer::<EXACT, SORTED>(splat, &pixels);
        // Alpha acts as one more channel of colour one.
        let mut along = plane(alpha_plane);
        for (channel, &value) in tile.feature(i as usize).iter().enumerate() {
            along = plane(channel).mul_add(F::Block::<S>::splat(simd, value), along);
        }
        if grad.depth {
            let depth = if EXACT { layer.key } else { F::Block::<S>::splat(simd, splat.depth) };
            along = plane(tile.channels).mul_add(depth, along);
        }
        let id = F::Block::<S>::splat(simd, F::from_index(pair));
        seen_by[i as usize] |= u32::from(layer.shows.any_true()) << (place / len::<S, F>());
        if SORTED {
            let values = &mut pairs[2 * pair * len::<S, F>()..][..2 * len::<S, F>()];
            store(zero, values, 0);
            store(zero, values, len::<S, F>());
            slots.insert::<S>([layer.key, layer.alpha, along, id], layer.shows);
        } else {
            let before = seen.transmittance;
            let ([_, alpha], finished) = seen.pass(layer.alpha, rules);
            slots.push::<S>([before, alpha, along, id], layer.shows);
            if finished {
                break;
            }
        }
    }
    if SORTED {
        slots.finish::<S>();
        for place in 0..slots.count() {
            let [_, alpha, along, id] = slots.get::<S>(simd, place);
            let before = ended.transmittance;
            let ([_, alpha], _) = ended.pass(alpha, rules);
            slots.put::<S>(place, [before, alpha, along, id]);
        }
        seen = ended;
    }
    // Contribution of everything behind the layer, as the gradient weighs it: g·R.
    let mut behind = lanes::<S, F>(simd, &grad.planes.background_rho, place);
    for place in (0..slots.count()).rev() {
        let [before, alpha, along, id] = slots.get::<S>(simd, place);
        let (weight, ahead) = (alpha * before, along - behind);
        let shows = alpha.simd_gt(zero);
        let h = (shows & alpha.simd_lt(rules.alpha_max)).select(weight * ahead, zero);
        behind = alpha.mul_add(ahead, behind);
        if SORTED {
            let mut ids = Ids::<S, F>::new(id, shows);
            while let Some((pair, same)) = ids.next() {
                let values = &mut pairs[2 * pair * len::<S, F>()..][..2 * len::<S, F>()];
                let same = same & shows;
                store(same.select(h, lanes(simd, values, 0)), values, 0);
                store(same.select(weight, lanes(simd, values, len::<S, F>())), values, len::<S, F>());
            }
        } else {
            let values = &mut pairs[2 * id[0].to_index() * len::<S, F>()..][..2 * len::<S, F>()];
            store(h, values, 0);
            store(weight, values, len::<S, F>());
        }
    }
    seen.transmittance
}

/// Sums of a Gaussian over the pixels of a tile that do not depend on the number of features.
struct RaySums<S: Simd, F: Real> {
    moments: [F::Block<S>; MOMENTS],
    depth: F::Block<S>,
    slopes: [F::Block<S>; DEPTH_SLOPE],
    /// The gradients of `α`, `β` and `γ`.
    centre: [F::Block<S>; 3],
    absolute: [F::Block<S>; 2],
}

/// Sums the stored pairs, Gaussian by Gaussian, and adds the sums to the rows.
#[inline(always)]
fn add_rows<S: Simd, F: Real, const EXACT: bool>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    grad: &RayTileGrad<F>,
    rows: &mut [F],
    (scratch, first): (&mut RayScratch<F>, &[usize; VECTORS]),
) {
    let RayScratch { pairs, seen_by, .. } = scratch;
    let zero = F::Block::<S>::splat(simd, F::ZERO);
    let channels = tile.channels + usize::from(grad.depth);
    let columns = columns(channels, grad.absolute);
    let mut next = [0; VECTORS];
    for (i, (row, vectors)) in rows.chunks_exact_mut(columns).zip(seen_by).enumerate() {
        if *vectors == 0 {
            continue;
        }
        let splat = &tile.near[i];
        let mut fixed = RaySums {
            moments: [zero; MOMENTS],
            depth: zero,
            slopes: [zero; DEPTH_SLOPE],
            centre: [zero; 3],
            absolute: [zero; 2],
        };
        let mut features = [zero; TOGETHER];
        let (mut left, mut places) = (*vectors, [(0, 0); VECTORS]);
        let mut count = 0;
        while left != 0 {
            let number = left.trailing_zeros() as usize;
            left &= left - 1;
            let place = number * len::<S, F>();
            let list = tile.list(place);
            while list[next[number]] != i as u32 {
                next[number] += 1;
            }
            let at = first[number] + 2 * next[number] * len::<S, F>();
            places[count] = (place, at);
            count += 1;
            let values = &pairs[at..][..2 * len::<S, F>()];
            let (h, weight) = (lanes::<S, F>(simd, values, 0), lanes::<S, F>(simd, values, len::<S, F>()));
            let layer = rules.layer::<EXACT, false>(splat, &tile.pixels(simd, place));
            let plane = |channel: usize| lanes::<S, F>(simd, &grad.planes.planes[channel], place);
            let seen = if grad.depth { weight * plane(tile.channels) } else { zero };
            fixed.add::<EXACT>(splat, &layer, [h, seen], grad.absolute);
            for channel in 0..TOGETHER.min(tile.channels) {
                features[channel] = plane(channel).mul_add(weight, features[channel]);
            }
        }
        *vectors = 0;
        fixed.write::<EXACT>(splat, row, [tile.channels, channels], grad.absolute);
        for channel in 0..TOGETHER.min(tile.channels) {
            row[MOMENTS + channel] += features[channel].reduce_sum();
        }
        for channel in TOGETHER..tile.channels {
            let mut sum = zero;
            for &(place, at) in &places[..count] {
                let weight = lanes::<S, F>(simd, pairs, at + len::<S, F>());
                sum = lanes::<S, F>(simd, &grad.planes.planes[channel], place).mul_add(weight, sum);
            }
            row[MOMENTS + channel] += sum.reduce_sum();
        }
    }
}

impl<S: Simd, F: Real> RaySums<S, F> {
    /// Adds the sums over the lanes to a row with this number of features and of channels.
    #[inline(always)]
    fn write<const EXACT: bool>(
        &self,
        splat: &RayFootprint<F>,
        row: &mut [F],
        [features, channels]: [usize; 2],
        absolute: bool,
    ) {
        let mut moments = self.moments.map(|sum| sum.reduce_sum());
        let [slope_u, slope_v, thickness] = self.slopes.map(|sum| sum.reduce_sum());
        let mut slopes = [-slope_u, -slope_v, thickness * splat.thick.sqrt()];
        if EXACT && splat.is_beyond() {
            let [of_alpha, of_beta, of_gamma] = self.centre.map(|sum| sum.reduce_sum());
            let [alpha, beta] = splat.centre;
            let moved = [of_alpha - splat.depth_slope[0] * of_gamma, of_beta - splat.depth_slope[1] * of_gamma];
            // Along an axis on which the centre lies beyond the picture, the origin stays and the centre moves relative to it.
            let (of_origin, of_centre) = (splat.per_px([moments[1], moments[2]]), splat.per_px(moved));
            let of_mean = [0, 1].map(|axis| if splat.beyond[axis] { of_centre[axis] } else { of_origin[axis] });
            [moments[1], moments[2]] = splat.per_whitened(of_mean);
            moments[3] -= moved[0] * alpha;
            moments[4] -= moved[1] * alpha;
            moments[5] -= moved[1] * beta;
            slopes[0] -= alpha * of_gamma;
            slopes[1] -= beta * of_gamma;
        }
        row.iter_mut().zip(moments).for_each(|(out, sum)| *out += sum);
        if channels > features {
            row[MOMENTS + features] += self.depth.reduce_sum();
        }
        let rest = &mut row[MOMENTS + channels..];
        if EXACT {
            rest.iter_mut().zip(slopes).for_each(|(out, sum)| *out += sum);
        }
        if absolute {
            rest[DEPTH_SLOPE] += self.absolute[0].reduce_sum();
            rest[DEPTH_SLOPE + 1] += self.absolute[1].reduce_sum();
        }
    }

    /// Adds the gradients of a Gaussian at a vector of pixels, from `h` and from the gradient of the layer's depth. The module's
    /// documentation has the formulas.
    #[inline(always)]
    fn add<const EXACT: bool>(
        &mut self,
        splat: &RayFootprint<F>,
        layer: &RayLayerSimd<S, F>,
        [h, seen]: [F::Block<S>; 2],
        absolute: bool,
    ) {
        let lanes = |value: F| F::Block::<S>::splat(h.token(), value);
        let RayLayerSimd { u, v, exponent, lambda, inverse, along, apart, .. } = *layer;
        // Negative gradients of `u` and `v`; gradients of `α`, `β` and `γ`.
        let (mut p, mut q, mut centre) = (h * u, h * v, [lanes(F::ZERO); 3]);
        if EXACT {
            let of_lambda = seen * lanes(splat.depth);
            let phi = lanes(splat.thick) * inverse;
            let [slope_u, slope_v] = splat.depth_slope.map(lanes);
            let across;
            if splat.is_beyond() {
                let [apart_u, apart_v, apart_s] = apart;
                let (near, far) = (h * lambda, of_lambda * phi);
                let along_s = of_lambda * along;
                across = near.mul_add(apart_s, far * apart_s - lambda * along_s);
                p = across * slope_u - near.mul_add(apart_u, far * (-lambda).mul_add(u, apart_u));
                q = across * slope_v - near.mul_add(apart_v, far * (-lambda).mul_add(v, apart_v));
                self.slopes[2] += apart_s * (h * apart_s - (along_s + along_s));
                centre = [far * u - h * apart_u, far * v - h * apart_v, along_s - h * apart_s];
            } else {
                let twice = exponent * lanes(F::of(2.0 * std::f64::consts::LN_2));
                let kappa = twice * phi - lambda * lambda;
                let radial = (h * lambda + (of_lambda + of_lambda) * phi) * lambda;
                across = h * twice * lambda + of_lambda * kappa;
                p = radial.mul_add(u, across * slope_u);
                q = radial.mul_add(v, across * slope_v);
                self.slopes[2] += twice * (h * twice - (of_lambda + of_lambda) * lambda);
            }
            self.slopes[0] = across.mul_add(u, self.slopes[0]);
            self.slopes[1] = across.mul_add(v, self.slopes[1]);
            self.depth = seen.mul_add(lambda, self.depth);
        } else {
            self.depth += seen;
        }
        self.moments[0] += h;
        self.moments[1] += p;
        self.moments[2] += q;
        self.moments[3] = p.mul_add(u, self.moments[3]);
        self.moments[4] = q.mul_add(u, self.moments[4]);
        self.moments[5] = q.mul_add(v, self.moments[5]);
        if splat.is_beyond() {
            self.centre.iter_mut().zip(centre).for_each(|(sum, value)| *sum += value);
        }
        if absolute {
            let per_px = |[p, q]: [F::Block<S>; 2]| {
                let per_v = q * lanes(splat.inverse_v);
                [p * lanes(splat.inverse_u) - per_v * lanes(splat.shear), per_v]
            };
            let [slope_u, slope_v] = splat.depth_slope.map(lanes);
            let (of_origin, of_centre) =
                (per_px([p, q]), per_px([centre[0] - slope_u * centre[2], centre[1] - slope_v * centre[2]]));
            for axis in 0..2 {
                self.absolute[axis] += if splat.beyond[axis] { of_centre[axis] } else { of_origin[axis] }.abs();
            }
        }
    }
}
