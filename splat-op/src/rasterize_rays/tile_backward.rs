//! Backward pass of the CPU twin over one tile. Each vector of pixels finds its layers as in the forward pass and goes through
//! them back to front. What it finds for each pair of a Gaussian and a vector of pixels is stored, and then summed Gaussian by
//! Gaussian.

use fearless_simd::prelude::*;

use super::footprint::{RayFootprint, RayLayerSimd, RayRules};
use super::tile::{Open, RayTile, TOGETHER};
use crate::intersect::TILE_PIXELS;
use crate::rasterize::cpu::{MOMENTS, TilePlanes};
use crate::rasterize::tile::{Plane, lanes, len, store};
use crate::ray_space::SLOPES;
use crate::simd::each;
use crate::simd::real::Real;

/// Number of values that are stored before they are summed, unless one vector of pixels has more: 16 MiB in f32.
const STORED: usize = 1 << 22;

/// The largest number of vectors of pixels in a tile, that of f64.
const VECTORS: usize = 32;

/// Number of values of a pair of a Gaussian and a vector of pixels that sees it, a vector each: `h = α ∂L/∂α` where alpha is below
/// its limit, the weight `α T`, and [`RayLayerSimd::inverse`].
const PARTS: usize = 3;

/// Buffers that one thread reuses from tile to tile.
#[derive(Default)]
pub(super) struct RayScratch<F> {
    /// Alpha and the layer's values along the gradient, a vector each.
    layers: Vec<F>,
    /// [`PARTS`] vectors for each pair.
    pairs: Vec<F>,
    /// Number of values in use of `pairs`.
    used: usize,
    /// A bit for each vector of pixels that stored a pair, by index in the tile's Gaussians.
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
    MOMENTS + channels + SLOPES + if absolute { 2 } else { 0 }
}

/// Adds each intersection's sums over the tile to its row. Returns the transmittances behind all layers, negated where a pixel is
/// finished. The tile has the Gaussians and blocks that the forward pass found.
#[inline(always)]
pub(super) fn rasterize_tile_backward<S: Simd, F: Real>(
    simd: S,
    tile: &mut RayTile<F>,
    rules: &RayRules<S, F>,
    grad: &RayTileGrad<F>,
    rows: &mut [F],
    scratch: &mut RayScratch<F>,
) -> Plane<F> {
    tile.fill_values(0);
    let mut transmittance = tile.open;
    // The first pair of each vector; it has as many as its list.
    let mut first = [0; VECTORS];
    scratch.seen_by.clear();
    scratch.seen_by.resize(tile.near.len(), 0);
    for place in (0..TILE_PIXELS).step_by(len::<S, F>()) {
        first[place / len::<S, F>()] = scratch.used;
        let behind = layers::<S, F>(simd, tile, rules, grad, place, scratch);
        store(behind, &mut transmittance, place);
        if scratch.used > STORED || place + len::<S, F>() == TILE_PIXELS {
            add_rows::<S, F>(simd, tile, rules, grad, rows, (scratch, &first));
            scratch.used = 0;
        }
    }
    transmittance
}

/// Appends the pairs of the vector of pixels at `place`. Returns the transmittances behind all layers.
#[inline(always)]
fn layers<S: Simd, F: Real>(
    simd: S,
    tile: &RayTile<F>,
    rules: &RayRules<S, F>,
    grad: &RayTileGrad<F>,
    place: usize,
    scratch: &mut RayScratch<F>,
) -> F::Block<S> {
    let along = Along::<S, F>::new(simd, tile, grad, place);
    let RayScratch { layers, pairs, used, seen_by } = scratch;
    let (pixels, list, vector) = (tile.pixels(simd, place), tile.list(place), len::<S, F>());
    let base = *used;
    *used += PARTS * list.len() * vector;
    if pairs.len() < *used {
        pairs.resize(2 * *used, F::ZERO);
    }
    let pairs = &mut pairs[base..*used];
    let mut open = Open::<S, F>::new(lanes(simd, &tile.open, place));
    let mut behind = Behind { rho: lanes::<S, F>(simd, &grad.planes.background_rho, place) };
    for &i in list {
        seen_by[i as usize] |= 1 << (place / vector);
    }
    if layers.len() < 2 * list.len() * vector {
        layers.resize(4 * list.len() * vector, F::ZERO);
    }
    let layers = &mut layers[..2 * list.len() * vector];
    let found = layers.chunks_exact_mut(2 * vector).zip(pairs.chunks_exact_mut(PARTS * vector));
    for (&i, (kept, values)) in list.iter().zip(found) {
        let layer = rules.layer(tile.splat(i), &pixels, None);
        let ([weight, alpha], _) = open.pass(layer.alpha, rules);
        store(alpha, kept, 0);
        store(along.of(tile, i, layer.depth), kept, vector);
        store(weight, values, vector);
        store(layer.inverse, values, 2 * vector);
    }
    for (kept, values) in layers.chunks_exact(2 * vector).zip(pairs.chunks_exact_mut(PARTS * vector)).rev() {
        let (alpha, along) = (lanes(simd, kept, 0), lanes(simd, kept, vector));
        let weight = lanes(simd, values, vector);
        store(behind.pass([alpha, along, weight], rules), values, 0);
    }
    open.transmittance
}

/// The contribution of everything behind a layer, as the gradient weighs it: g·R.
struct Behind<S: Simd, F: Real> {
    rho: F::Block<S>,
}

impl<S: Simd, F: Real> Behind<S, F> {
    /// Passes a layer with its alpha, its value along the gradient and its weight, from behind. Returns `h`.
    #[inline(always)]
    fn pass(&mut self, [alpha, along, weight]: [F::Block<S>; 3], rules: &RayRules<S, F>) -> F::Block<S> {
        // Where the layer does not show, its features may be infinite or undefined.
        let ahead = alpha.simd_gt(rules.zero).select(along - self.rho, rules.zero);
        self.rho = alpha.mul_add(ahead, self.rho);
        alpha.simd_lt(rules.alpha_max).select(weight * ahead, rules.zero)
    }
}

/// The gradients of the planes of a vector of pixels, by which the values of each layer are weighed.
struct Along<'a, S: Simd, F: Real> {
    simd: S,
    alpha: F::Block<S>,
    /// Those of the channels of [`RayTile::values`].
    first: [F::Block<S>; TOGETHER],
    /// That of depth, if there is one.
    depth: Option<F::Block<S>>,
    planes: &'a [Plane<F>],
    place: usize,
}

impl<'a, S: Simd, F: Real> Along<'a, S, F> {
    #[inline(always)]
    fn new(simd: S, tile: &RayTile<F>, grad: &RayTileGrad<'a, F>, place: usize) -> Self {
        let planes = &grad.planes.planes[..];
        let plane = |channel: usize| lanes::<S, F>(simd, &planes[channel], place);
        let mut first = [F::Block::<S>::splat(simd, F::ZERO); TOGETHER];
        first.iter_mut().enumerate().take(tile.channels).for_each(|(channel, first)| *first = plane(channel));
        let depth = grad.depth.then(|| plane(tile.channels));
        Self { simd, alpha: plane(tile.channels + usize::from(grad.depth)), first, depth, planes, place }
    }

    /// The sum of a layer's values along the gradient.
    #[inline(always)]
    fn of(&self, tile: &RayTile<F>, i: u32, depth: F::Block<S>) -> F::Block<S> {
        let splat = |value: F| F::Block::<S>::splat(self.simd, value);
        // Alpha acts as one more channel of colour one.
        let mut along = self.alpha;
        for (plane, &value) in self.first.iter().zip(&tile.values[i as usize]) {
            along = plane.mul_add(splat(value), along);
        }
        for (plane, &value) in self.planes.iter().zip(tile.feature(i)).skip(TOGETHER) {
            along = lanes::<S, F>(self.simd, plane, self.place).mul_add(splat(value), along);
        }
        match self.depth {
            Some(plane) => plane.mul_add(depth, along),
            None => along,
        }
    }
}

/// Sums of a Gaussian over the pixels of a tile that do not depend on the number of features.
struct RaySums<S: Simd, F: Real> {
    moments: [F::Block<S>; MOMENTS],
    /// The gradients of the depth slope, of the thickness over the thickness, and of `γ`.
    slopes: [F::Block<S>; SLOPES],
    absolute: [F::Block<S>; 2],
}

/// Sums the stored pairs, Gaussian by Gaussian, and adds the sums to the rows.
#[inline(always)]
fn add_rows<S: Simd, F: Real>(
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
    let vector = len::<S, F>();
    // Where the next pair of each vector of pixels begins: pairs are in the order of the Gaussians.
    let mut next = *first;
    for (i, (vectors, &in_list)) in seen_by.iter_mut().zip(&tile.places).enumerate() {
        if *vectors == 0 {
            continue;
        }
        let row = &mut rows[in_list as usize * columns..][..columns];
        let splat = tile.splat(i as u32);
        let mut fixed = RaySums { moments: [zero; MOMENTS], slopes: [zero; SLOPES], absolute: [zero; 2] };
        let mut features = [zero; TOGETHER];
        let (mut places, mut count) = ([(0, 0); VECTORS], 0);
        let mut left = *vectors;
        while left != 0 {
            let number = left.trailing_zeros() as usize;
            left &= left - 1;
            let (place, at) = (number * vector, next[number]);
            next[number] += PARTS * vector;
            places[count] = (place, at);
            count += 1;
            let values = &pairs[at..][..PARTS * vector];
            let (h, weight) = (lanes::<S, F>(simd, values, 0), lanes::<S, F>(simd, values, vector));
            let inverse = lanes::<S, F>(simd, values, 2 * vector);
            let layer = rules.layer(splat, &tile.pixels(simd, place), Some(inverse));
            let plane = |channel: usize| lanes::<S, F>(simd, &grad.planes.planes[channel], place);
            let seen = if grad.depth { Some(weight * plane(tile.channels)) } else { None };
            fixed.add(splat.0, &layer, (h, seen), grad.absolute);
            for channel in 0..TOGETHER.min(tile.channels) {
                features[channel] = plane(channel).mul_add(weight, features[channel]);
            }
        }
        *vectors = 0;
        fixed.write(splat.0, row, channels, grad.absolute);
        for channel in 0..TOGETHER.min(tile.channels) {
            row[MOMENTS + channel] += features[channel].reduce_sum();
        }
        for channel in TOGETHER..tile.channels {
            let mut sum = zero;
            for &(place, at) in &places[..count] {
                let weight = lanes::<S, F>(simd, pairs, at + vector);
                sum = lanes::<S, F>(simd, &grad.planes.planes[channel], place).mul_add(weight, sum);
            }
            row[MOMENTS + channel] += sum.reduce_sum();
        }
    }
}

impl<S: Simd, F: Real> RaySums<S, F> {
    /// Adds the sums over the lanes to a row with this number of channels.
    #[inline(always)]
    fn write(&self, splat: &RayFootprint<F>, row: &mut [F], channels: usize, absolute: bool) {
        let moments = each!(self.moments, |sum| sum.reduce_sum());
        let [slope_u, slope_v, thickness, centre_depth] = each!(self.slopes, |sum| sum.reduce_sum());
        let slopes = [slope_u, slope_v, thickness * splat.thick.sqrt(), centre_depth];
        row.iter_mut().zip(moments).for_each(|(out, sum)| *out += sum);
        let rest = &mut row[MOMENTS + channels..];
        rest.iter_mut().zip(slopes).for_each(|(out, sum)| *out += sum);
        if absolute {
            rest[SLOPES] += self.absolute[0].reduce_sum();
            rest[SLOPES + 1] += self.absolute[1].reduce_sum();
        }
    }

    /// Adds the gradients of a Gaussian at a vector of pixels, from `h` and from the gradient of the layer's depth, if there is one. The
    /// module's documentation has the formulas.
    #[inline(always)]
    fn add(
        &mut self,
        splat: &RayFootprint<F>,
        layer: &RayLayerSimd<S, F>,
        (h, seen): (F::Block<S>, Option<F::Block<S>>),
        absolute: bool,
    ) {
        let lanes = |value: F| F::Block::<S>::splat(h.token(), value);
        let RayLayerSimd { u, v, inverse, along, apart: [a, b, c], .. } = *layer;
        let [slope_u, slope_v] = each!(splat.depth_slope, |value| lanes(value));
        // `r` of the module's documentation.
        let reach = [c.mul_add(slope_u, a), c.mul_add(slope_v, b)];
        let of_depth = h * c;
        let (mut of_gamma, mut of_thickness) = (-of_depth, c * of_depth);
        // The negative gradients of `α` and `β`.
        let mut of_centre = each!(reach, |reach| h * reach);
        if let Some(seen) = seen {
            let of_lambda = seen * lanes(splat.depth);
            let (far, along_s) = (of_lambda * lanes(splat.thick) * inverse, of_lambda * along);
            of_gamma += along_s;
            of_thickness -= c * (along_s + along_s);
            of_centre[0] += far.mul_add(u, -(along_s * slope_u));
            of_centre[1] += far.mul_add(v, -(along_s * slope_v));
            let (of_ray, of_s) = (each!(reach, |reach| far * reach), far * c);
            self.moments[3] = of_ray[0].mul_add(u, self.moments[3]);
            self.moments[4] = of_ray[1].mul_add(u, self.moments[4]);
            self.moments[5] = of_ray[1].mul_add(v, self.moments[5]);
            self.slopes[0] -= of_s * u;
            self.slopes[1] -= of_s * v;
        }
        self.slopes[0] = of_gamma.mul_add(a, self.slopes[0]);
        self.slopes[1] = of_gamma.mul_add(b, self.slopes[1]);
        self.slopes[2] += of_thickness;
        self.slopes[3] += of_gamma;
        self.moments[0] += h;
        self.moments[1] += of_centre[0];
        self.moments[2] += of_centre[1];
        self.moments[3] = of_centre[0].mul_add(a, self.moments[3]);
        self.moments[4] = of_centre[1].mul_add(a, self.moments[4]);
        self.moments[5] = of_centre[1].mul_add(b, self.moments[5]);
        if absolute {
            let [of_u, of_v] = of_centre;
            let per_v = of_v * lanes(splat.inverse_v);
            self.absolute[0] += (of_u * lanes(splat.inverse_u) - per_v * lanes(splat.shear)).abs();
            self.absolute[1] += per_v.abs();
        }
    }
}
