//! Tiles that a Gaussian reaches, for a vector of Gaussians at a time.

use std::ops::Range;

use fearless_simd::prelude::*;

use super::{Cut, PixelBox, TILE_SIZE, tile_grid};
use crate::camera::Intrinsics;
use crate::project::{COLUMNS, Ellipse};
use crate::simd::{Columns, LANES, ROW_BLOCK, Real, each, width};

/// Returns the largest `u² + v²` at which a Gaussian's alpha reaches `alpha_min`; negative if there is none.
#[inline(always)]
pub(crate) fn whitened_limit<F: Real>(opacity: F, alpha_min: F) -> F {
    if alpha_min > F::ZERO { F::of(2.0) * (opacity / alpha_min).ln() } else { F::MAX }
}

/// Returns the [`whitened_limit`], widened so that no rounding of `rasterize` shows a Gaussian beyond it: a relative
/// margin for the logarithm, an absolute one for the exponential.
#[inline(always)]
pub(crate) fn widened_limit<F: Real>(opacity: F, alpha_min: F) -> F {
    whitened_limit(opacity, alpha_min) * F::of(1.0 + 1e-5) + F::of(1e-4)
}

/// Returns half the width and height of the box around `u² + v² <= limit`, px.
#[inline(always)]
pub(crate) fn half_extent<F: Real>(ellipse: &Ellipse<F>, limit: F) -> [F; 2] {
    let extent = limit.sqrt();
    let across = ellipse.shear * ellipse.sigma_u;
    let vertical = crate::linalg::norm([ellipse.sigma_v, across, F::ZERO]);
    [extent * ellipse.sigma_u, extent * vertical]
}

/// Parameters of a Gaussian's extent.
#[derive(Clone, Copy)]
pub(super) struct ExtentRules<'a, F> {
    grid: [usize; 2],
    /// Size of the picture, px.
    size: [F; 2],
    alpha_min: F,
    boxes: bool,
    mask: Option<&'a [i32]>,
}

impl<'a, F: Real> ExtentRules<'a, F> {
    pub fn new(camera: &Intrinsics, cut: Cut<&'a [i32]>) -> Self {
        Self {
            grid: tile_grid(camera.width, camera.height),
            size: [camera.width, camera.height].map(|px| F::of(px as f64)),
            alpha_min: F::of(cut.alpha_min),
            boxes: cut.boxes,
            mask: cut.mask,
        }
    }

    /// Appends to `tiles` the tiles of up to [`ROW_BLOCK`] Gaussians, one Gaussian after another: the tiles of the mask whose rectangle of
    /// pixel centres its ellipse meets. Returns each Gaussian's number of tiles. Appends their boxes to `boxes` if they are asked for.
    #[inline(always)]
    pub fn emit<S: Simd>(
        &self,
        simd: S,
        rows: &[F],
        scratch: &mut ExtentScratch<F>,
        tiles: &mut Vec<u32>,
        boxes: &mut Vec<PixelBox>,
    ) -> [u32; ROW_BLOCK] {
        let count = rows.len() / COLUMNS;
        scratch.ellipses.read(rows);
        let opacities = scratch.ellipses.column(6);
        for (limit, opacity) in scratch.limits.iter_mut().zip(opacities).take(count) {
            *limit = widened_limit(*opacity, self.alpha_min);
        }
        let mut counts = [0; ROW_BLOCK];
        let width = width::<S, F>();
        for first in (0..count).step_by(width) {
            let eight = ExtentsSimd::read(simd, self, scratch, first);
            let [mut top, mut end] = [[F::ZERO; LANES]; 2];
            eight.rows.0.store_slice(&mut top[..width]);
            eight.rows.1.store_slice(&mut end[..width]);
            if self.boxes {
                boxes.extend_from_slice(&eight.boxes()[..width.min(count - first)]);
            }
            let rows: [Range<usize>; LANES] = std::array::from_fn(|lane| top[lane].index()..end[lane].index());
            scratch.spans.clear();
            for row in 0..rows.iter().map(Range::len).max().unwrap_or(0) {
                let mut span = [[F::ZERO; LANES]; 2];
                let (from, to) = eight.span(self, F::of(row as f64));
                from.store_slice(&mut span[0][..width]);
                to.store_slice(&mut span[1][..width]);
                scratch.spans.push(span);
            }
            for (lane, rows) in rows.into_iter().enumerate().take(width.min(count - first)) {
                let before = tiles.len();
                for (y, [from, to]) in rows.zip(&scratch.spans) {
                    let row = (y * self.grid[0]) as u32;
                    let met = row + from[lane].index() as u32..row + to[lane].index() as u32;
                    match self.mask {
                        None => tiles.extend(met),
                        Some(mask) => tiles.extend(met.filter(|&tile| mask[tile as usize] != 0)),
                    }
                }
                counts[first + lane] = (tiles.len() - before) as u32;
            }
        }
        counts
    }
}

/// Buffers that one thread reuses.
pub(super) struct ExtentScratch<F> {
    ellipses: Columns<F, COLUMNS>,
    limits: [F; ROW_BLOCK],
    /// For each row of tiles: the first tile and the tile after the last.
    spans: Vec<[[F; LANES]; 2]>,
}

impl<F: Real> Default for ExtentScratch<F> {
    fn default() -> Self {
        Self { ellipses: Columns::new(), limits: [F::ZERO; ROW_BLOCK], spans: Vec::new() }
    }
}

/// The extents of a vector of Gaussians.
///
/// The part of the ellipse `u² + v² <= r²` on a row of tiles spans an interval of `x`. With `V` its standard deviation along `y` and
/// `c = dy / V`, the ends of its chord at `dy` are `sigma_u (c k ± h √(r² − c²))`, where `k = shear sigma_u / V` and `h = sigma_v / V`. The
/// farthest ends lie at `c = ± r k`, or, if that is outside the row, at the row's nearer edge.
struct ExtentsSimd<S: Simd, F: Real> {
    mean: [F::Lanes<S>; 2],
    sigma_u: F::Lanes<S>,
    r: F::Lanes<S>,
    /// Half the size of the box, px.
    half: [F::Lanes<S>; 2],
    k: F::Lanes<S>,
    h: F::Lanes<S>,
    /// `1 / V`
    inverse: F::Lanes<S>,
    /// Bound of the rounding error of a pixel's position along y in `rasterize`, px.
    slip: F::Lanes<S>,
    /// Margin, px, by which ends along `x` are widened for their rounding.
    margin: F::Lanes<S>,
    /// The first row of tiles and the row after the last; equal for a Gaussian that cannot show.
    rows: (F::Lanes<S>, F::Lanes<S>),
}

impl<S: Simd, F: Real> ExtentsSimd<S, F> {
    #[inline(always)]
    fn read(simd: S, extent: &ExtentRules<F>, scratch: &ExtentScratch<F>, first: usize) -> Self {
        let lanes = |value: F| F::Lanes::<S>::splat(simd, value);
        let columns = each!([0, 1, 2, 3, 4, 5, 6], |column| scratch.ellipses.lanes(simd, column, first));
        let [x, y, sigma_u, shear, sigma_v, depth, opacity] = columns;
        let largest = lanes(F::MAX);
        let mut shows =
            depth.simd_gt(lanes(F::ZERO)) & opacity.simd_gt(lanes(F::ZERO)) & opacity.simd_ge(lanes(extent.alpha_min));
        for value in [x, y, sigma_u, shear, sigma_v, depth, opacity] {
            shows &= value.abs().simd_le(largest);
        }

        let across = shear * sigma_u;
        // The length of `(sigma_v, across)`, scaled so that nothing overflows.
        let larger = sigma_v.max(across.abs());
        let (a, b) = (sigma_v / larger, across / larger);
        let unit = a.mul_add(a, b * b).sqrt();
        let (h, k, vertical) = (a / unit, b / unit, larger * unit);
        // If `alpha_min` is zero the limit is unbounded, but nothing shows where a float can no longer hold the square.
        let limit = F::Lanes::<S>::from_slice(simd, &scratch.limits[first..first + width::<S, F>()]);
        let r = limit.min(lanes(F::MAX.sqrt())).sqrt();
        // `dy − shear dx` loses digits when both terms are large: where it shows, neither exceeds `(|across| + sigma_v) r`.
        let slip = (across.abs() + sigma_v) * r * lanes(F::of(16.0) * F::EPSILON);
        let (half_width, half_height) = (r * sigma_u, r * vertical);
        let half = half_height + slip;
        let [margin_x, margin_y] = each!([(x, half_width), (y, half)], |(mean, half)| (mean.abs() + half)
            * lanes(F::of(8.0) * F::EPSILON)
            + lanes(F::of(1e-3)));
        let (top, end) = tiles(y - half, y + half, margin_y, extent.size[1]);
        Self {
            mean: [x, y],
            sigma_u,
            r,
            half: [half_width, half_height],
            k,
            h,
            inverse: lanes(F::ONE) / vertical,
            slip,
            margin: margin_x,
            rows: (shows.select(top, lanes(F::ZERO)), shows.select(end, lanes(F::ZERO))),
        }
    }

    /// Returns the boxes. No pixel of the picture is as far away as their limit.
    #[inline(always)]
    fn boxes(&self) -> [PixelBox; LANES] {
        let limit = F::Lanes::<S>::splat(self.r.token(), F::of(PixelBox::EVERYWHERE.half[0].into()));
        let mut found = [PixelBox::default(); LANES];
        let [x, y, half_x, half_y] =
            each!([self.mean[0], self.mean[1], self.half[0], self.half[1]], |value| value.max(-limit).min(limit));
        for (lane, found) in found.iter_mut().enumerate().take(width::<S, F>()) {
            found.middle = [x[lane].f64() as f32, y[lane].f64() as f32];
            found.half = [half_x[lane].f64() as f32, half_y[lane].f64() as f32];
        }
        found
    }

    /// Returns the first tile, and the tile after the last, on the row of tiles `row` rows after each Gaussian's first.
    #[inline(always)]
    fn span(&self, extent: &ExtentRules<F>, row: F) -> (F::Lanes<S>, F::Lanes<S>) {
        let lanes = |value: F| F::Lanes::<S>::splat(self.r.token(), value);
        let first = (self.rows.0 + row) * F::of(TILE_SIZE as f64);
        let last = (first + F::of((TILE_SIZE - 1) as f64)).min(lanes(extent.size[1] - F::ONE));
        let top = (first + F::of(0.5) - self.mean[1] - self.slip) * self.inverse;
        let bottom = (last + F::of(0.5) - self.mean[1] + self.slip) * self.inverse;
        let tip = self.r * self.k;
        let [low, high] = each!([-tip, tip], |tip| {
            let c = tip.max(top).min(bottom);
            let half = (self.r * self.r - c * c).max(lanes(F::ZERO)).sqrt() * self.h;
            (c * self.k, half)
        });
        let low = self.mean[0] + self.sigma_u * (low.0 - low.1);
        let high = self.mean[0] + self.sigma_u * (high.0 + high.1);
        tiles(low, high, self.margin, extent.size[0])
    }
}

/// Returns the first tile, and the tile after the last, whose range of pixel centres meets an interval, px, widened by
/// a margin. `pixels` is the picture's size along the axis.
#[inline(always)]
fn tiles<S: Simd, L: SimdFloat<S, Element = F>, F: Real<Lanes<S> = L>>(
    low: L,
    high: L,
    margin: L,
    pixels: F,
) -> (L, L) {
    let lanes = |value: F| L::splat(margin.token(), value);
    let (zero, pixels, tile) = (lanes(F::ZERO), lanes(pixels), F::of(1.0 / TILE_SIZE as f64));
    // Pixel `i` has its centre at `i + 0.5`. The comparisons are written so that NaN widens the interval.
    let low = low - margin - F::of(0.5);
    let low = low.simd_gt(zero).select(low, zero).ceil();
    let high = high + margin + F::of(0.5);
    let high = high.simd_lt(pixels).select(high, pixels).max(zero).floor();
    // The last tile may reach beyond the picture; an interval that begins there begins after all tiles.
    (low.simd_lt(pixels).select((low * tile).floor(), pixels), (high * tile).ceil())
}
