//! The CPU twin of the bounds, for eight Gaussians at a time, one per SIMD lane.

use fearless_simd::prelude::*;

use super::lens_bounds::{LensFrameSimd, LensLimitsSimd};
use super::{DEPTH_SLOPE, EXTENT, LEAST_REMAINDER, LENS_COLUMNS, RAY_SPACE, ROUNDING, SLACK};
use crate::camera::{CameraModel, Intrinsics, PictureRays};
use crate::intersect::extent::whitened_limit;
use crate::linalg::{cross, dot, scale};
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::rasterize_rays::WHITENED_MAX;
use crate::simd::lanes::{Columns, Lanes, MaskOf, ROW_BLOCK, norm, width};
use crate::simd::real::{LANES, Real};
use crate::simd::{dispatch, each};
use crate::tasks;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Returns rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and rows `[N, 9]`, with a lens `[N, 15]`. Culled
/// Gaussians stay culled.
pub(crate) fn bounds_cpu<F: Real>(packed: &[F], ray_rows: &[F], spec: &RasterizeSpec) -> Vec<F> {
    match PictureRays::of(&spec.intrinsics) {
        None => by_chunks::<F, RAY_SPACE>(packed, ray_rows, spec, None),
        Some(rays) => {
            let limits = LensLimitsSimd::new(&spec.intrinsics, &rays);
            by_chunks::<F, LENS_COLUMNS>(packed, ray_rows, spec, Some(&limits))
        }
    }
}

fn by_chunks<F: Real, const C: usize>(
    packed: &[F],
    ray_rows: &[F],
    spec: &RasterizeSpec,
    limits: Option<&LensLimitsSimd<F>>,
) -> Vec<F> {
    let mut bounds = vec![F::ZERO; packed.len()];
    let chunks = packed.chunks(CHUNK * COLUMNS).zip(ray_rows.chunks(CHUNK * C));
    tasks::for_each(bounds.chunks_mut(CHUNK * COLUMNS).zip(chunks), |_, (out, (rows, slopes))| {
        dispatch!(F, simd => chunk::<_, F, C>(simd, out, rows, slopes, spec, limits));
    });
    bounds
}

/// Writes the bounds of consecutive Gaussians, whose rows have `C` columns.
#[inline(always)]
fn chunk<S: Simd, F: Real, const C: usize>(
    simd: S,
    out: &mut [F],
    packed: &[F],
    ray_rows: &[F],
    spec: &RasterizeSpec,
    limits: Option<&LensLimitsSimd<F>>,
) {
    let (mut ellipses, mut slopes, mut found) =
        (Columns::<F, COLUMNS>::new(), Columns::<F, C>::new(), Columns::<F, COLUMNS>::new());
    let rules = BoundsRules::<S, F>::new(simd, spec, limits);
    let blocks = out.chunks_mut(ROW_BLOCK * COLUMNS).zip(packed.chunks(ROW_BLOCK * COLUMNS));
    for ((out, rows), of_slopes) in blocks.zip(ray_rows.chunks(ROW_BLOCK * C)) {
        ellipses.read(rows);
        slopes.read(of_slopes);
        for at in (0..rows.len() / COLUMNS).step_by(width::<S, F>()) {
            let ellipse = Ellipse::from_row(&ellipses.all_lanes(simd, at));
            let bounds = rules.bound(&ellipse, &slopes.all_lanes::<S>(simd, at));
            for (column, value) in bounds.to_row().into_iter().enumerate() {
                found.store(column, at, value);
            }
        }
        found.write(out);
    }
}

/// Returns the point of the picture next to a centre, and the distance of the centre from there, px. With a lens it is the centre.
pub(crate) fn beyond<F: Real>(mean_px: [F; 2], camera: &Intrinsics) -> ([F; 2], [F; 2]) {
    if camera.model != CameraModel::Pinhole {
        return (mean_px, [F::ZERO; 2]);
    }
    let size = [camera.width, camera.height].map(|px| F::of(px as f64));
    let base = [0, 1].map(|axis| mean_px[axis].within(F::ZERO, size[axis]));
    (base, [0, 1].map(|axis| mean_px[axis] - base[axis]))
}

/// An ellipse and its depth slope in the ray-space coordinates of one point.
type Seen<L> = (Ellipse<L>, [L; DEPTH_SLOPE]);

/// Returns the lanes of `a` where `mask` is set, else those of `b`.
#[inline(always)]
fn select<S: Simd, F: Real>(
    mask: MaskOf<S, F>,
    a: &Ellipse<Lanes<S, F>>,
    b: &Ellipse<Lanes<S, F>>,
) -> Ellipse<Lanes<S, F>> {
    let (a, b) = (a.to_row(), b.to_row());
    Ellipse::from_row(&each!([0, 1, 2, 3, 4, 5, 6], |k| mask.select(a[k], b[k])))
}

/// Whether all fields are finite.
#[inline(always)]
fn finite<S: Simd, F: Real>(simd: S, e: &Ellipse<Lanes<S, F>>) -> MaskOf<S, F> {
    let largest = F::Lanes::<S>::splat(simd, F::MAX);
    let mut finite = e.depth.abs().simd_le(largest);
    for value in e.to_row() {
        finite &= value.abs().simd_le(largest);
    }
    finite
}

/// Returns the ellipse and the depth slope in the ray-space coordinates of the centre, from those of the point that lies `away` px
/// before the centre.
#[inline(always)]
fn about_centre<S: Simd, F: Real>(
    simd: S,
    e: &Ellipse<Lanes<S, F>>,
    [slope_u, slope_v, thickness]: [Lanes<S, F>; DEPTH_SLOPE],
    away: [Lanes<S, F>; 2],
) -> Seen<Lanes<S, F>> {
    let one = F::Lanes::<S>::splat(simd, F::ONE);
    let z = [slope_u, slope_v, thickness];
    let x = [e.sigma_u - away[0] * slope_u, -away[0] * slope_v, -away[0] * thickness];
    let y = [e.shear * e.sigma_u - away[1] * slope_u, e.sigma_v - away[1] * slope_v, -away[1] * thickness];
    let sigma_u = norm::<S, F>(simd, x);
    let n = scale(x, one / sigma_u);
    let across = cross(n, y);
    let sigma_v = norm::<S, F>(simd, across);
    let p = scale(cross(across, n), one / sigma_v);
    let thickness = thickness * (e.sigma_u / sigma_u) * (e.sigma_v / sigma_v);
    (Ellipse { sigma_u, shear: dot(n, y) / sigma_u, sigma_v, ..*e }, [dot(n, z), dot(p, z), thickness])
}

/// What bounds need to know of a picture, one copy in each lane.
struct BoundsRules<S: Simd, F: Real> {
    simd: S,
    alpha_min: F,
    size: [Lanes<S, F>; 2],
    half: [Lanes<S, F>; 2],
    /// The opacity with which the extent of a row is [`EXTENT`].
    reached: Lanes<S, F>,
    limits: Option<LensLimitsSimd<Lanes<S, F>>>,
}

impl<S: Simd, F: Real> BoundsRules<S, F> {
    #[inline(always)]
    fn new(simd: S, spec: &RasterizeSpec, limits: Option<&LensLimitsSimd<F>>) -> Self {
        let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
        let size = [spec.intrinsics.width as f64, spec.intrinsics.height as f64];
        let alpha_min = F::of(spec.options.alpha_min);
        let reached = alpha_min * F::of((0.5 * EXTENT * EXTENT).exp());
        #[allow(clippy::manual_map, reason = "a closure may be left out of line, without vector instructions")]
        let limits = match limits {
            Some(limits) => Some(limits.lanes(simd)),
            None => None,
        };
        Self {
            simd,
            alpha_min,
            size: each!(size, |px| lanes(px)),
            half: each!(size, |px| lanes(0.5 * px)),
            reached: F::Lanes::<S>::splat(simd, if alpha_min > F::ZERO { reached } else { F::ONE }),
            limits,
        }
    }

    #[inline(always)]
    fn lanes(&self, value: f64) -> Lanes<S, F> {
        F::Lanes::<S>::splat(self.simd, F::of(value))
    }

    /// Returns the bounds of Gaussians from their packed ellipses and their rows. The row of a Gaussian that shows
    /// nowhere in the picture has no opacity.
    #[inline(always)]
    fn bound(&self, given: &Ellipse<Lanes<S, F>>, row: &[Lanes<S, F>]) -> Ellipse<Lanes<S, F>> {
        let (simd, zero, one) = (self.simd, self.lanes(0.0), self.lanes(1.0));
        let least = F::Lanes::<S>::splat(simd, self.alpha_min);
        let shows = given.opacity.simd_gt(zero) & given.opacity.simd_ge(least);
        let (e, [slope_u, slope_v, thickness]) = self.own(given, [row[0], row[1], row[2]]);
        let width_and_height = (self.half[0] + self.half[1]) * F::of(2.0);
        let everywhere = Ellipse {
            mean_px: self.half,
            sigma_u: width_and_height,
            shear: zero,
            sigma_v: width_and_height,
            depth: e.depth,
            opacity: self.reached,
        };
        let mut limit = [F::ZERO; LANES];
        let limit = &mut limit[..width::<S, F>()];
        given.opacity.store_slice(limit);
        for limit in &mut *limit {
            *limit = whitened_limit(*limit, self.alpha_min);
        }
        let tau = F::Lanes::<S>::from_slice(simd, limit) * F::of(1.0 + SLACK[0]) + F::of(SLACK[1]);
        let across = thickness * tau.sqrt();
        let thin = one - across * across;
        // Without a least alpha nothing has an end.
        let bounded = thin.simd_gt(self.lanes(LEAST_REMAINDER)) & least.simd_gt(zero);
        let square = tau / thin;
        let (whole, is_whole) = whole_ellipse::<S, F>(simd, [slope_u, slope_v], square);
        let (found, known, hidden) = match &self.limits {
            Some(limits) => {
                let frame = LensFrameSimd::of(row).expect("rows of a lens have its columns");
                let bent = limits.bent(simd, &whole.row(simd, &e, self.reached), &e, &frame);
                let known = bounded & is_whole & bent.known;
                (bent.row, known & finite::<S, F>(simd, &bent.row), known & bent.missed)
            }
            None => {
                let seen = InPictureSimd::<S, F>::new(simd, &e, [slope_u, slope_v], self.half);
                let (disc, is_known): (WhitenedEllipseSimd<Lanes<S, F>>, _) = seen.disc([slope_u, slope_v], square);
                let hidden = seen.most.simd_le(zero) | (bounded & is_known & disc.scale.simd_lt(zero));
                let smaller = is_known & (!is_whole | disc.area(simd).simd_lt(whole.area(simd)));
                let found =
                    select::<S, F>(smaller, &disc.row(simd, &e, self.reached), &whole.row(simd, &e, self.reached));
                (found, bounded & (is_whole | is_known) & finite::<S, F>(simd, &found), hidden)
            }
        };
        let bounds = select::<S, F>(known, &found, &everywhere);
        let bounds = select::<S, F>(hidden, &Ellipse { opacity: zero, ..*given }, &bounds);
        select::<S, F>(shows, &bounds, given)
    }

    /// Returns ellipses and depth slopes about their centres.
    #[inline(always)]
    fn own(&self, e: &Ellipse<Lanes<S, F>>, slopes: [Lanes<S, F>; DEPTH_SLOPE]) -> Seen<Lanes<S, F>> {
        if self.limits.is_some() {
            return (*e, slopes);
        }
        let zero = self.lanes(0.0);
        let away = each!([0, 1], |axis| e.mean_px[axis] - e.mean_px[axis].max(zero).min(self.size[axis]));
        let beyond = !(away[0].simd_eq(zero) & away[1].simd_eq(zero));
        if !beyond.any_true() {
            return (*e, slopes);
        }
        let (moved, moved_slopes) = about_centre::<S, F>(self.simd, e, slopes, away);
        (select::<S, F>(beyond, &moved, e), each!([0, 1, 2], |k| beyond.select(moved_slopes[k], slopes[k])))
    }
}

/// Ellipses in whitened coordinates: the disc of the radius `EXTENT`, scaled, with an additional column of its factor.
struct WhitenedEllipseSimd<L> {
    middle: [L; 2],
    column: [L; 2],
    scale: L,
}

impl<L: Copy> WhitenedEllipseSimd<L> {
    /// Returns a number that grows with the area.
    #[inline(always)]
    fn area<S: Simd, F: Real<Lanes<S> = L>>(&self, simd: S) -> L
    where
        L: SimdFloat<S, Element = F>,
    {
        norm::<S, F>(simd, [L::splat(simd, F::ONE), self.column[0], self.column[1]]) * self.scale * self.scale
    }

    /// Returns the rows of the Gaussians `e` whose extents are these ellipses.
    #[inline(always)]
    fn row<S: Simd, F: Real<Lanes<S> = L>>(&self, simd: S, e: &Ellipse<L>, opacity: L) -> Ellipse<L>
    where
        L: SimdFloat<S, Element = F>,
    {
        let (shift, [g_u, g_v]) = (self.middle, self.column);
        let wide = L::splat(simd, F::ONE) + g_u * g_u;
        Ellipse {
            mean_px: [
                e.mean_px[0] + e.sigma_u * shift[0],
                e.mean_px[1] + e.shear * e.sigma_u * shift[0] + e.sigma_v * shift[1],
            ],
            sigma_u: self.scale * e.sigma_u * wide.sqrt(),
            shear: e.shear + e.sigma_v / e.sigma_u * (g_u * g_v / wide),
            sigma_v: self.scale * e.sigma_v * ((wide + g_v * g_v) / wide).sqrt(),
            depth: e.depth,
            opacity,
        }
    }
}

/// Returns the visible regions, and whether each is an ellipse. `square` is `c²`.
#[inline(always)]
fn whole_ellipse<S: Simd, F: Real>(
    simd: S,
    slope: [Lanes<S, F>; 2],
    square: Lanes<S, F>,
) -> (WhitenedEllipseSimd<Lanes<S, F>>, MaskOf<S, F>) {
    let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
    let (zero, one) = (lanes(0.0), lanes(1.0));
    let c = square.sqrt();
    let length = norm::<S, F>(simd, [slope[0], slope[1], zero]);
    let eccentricity = c * length;
    let rest = (one - eccentricity) * (one + eccentricity);
    let along = length.simd_gt(zero).select(eccentricity / length, zero);
    let root = rest.sqrt();
    let whole = WhitenedEllipseSimd {
        middle: each!(slope, |slope| -(along * slope) * (c / rest)),
        column: each!(slope, |slope| along * slope / root),
        scale: c / (root * F::of(EXTENT)),
    };
    (whole, rest.simd_gt(lanes(LEAST_REMAINDER)))
}

/// What the picture contains of Gaussians' whitened planes.
struct InPictureSimd<S: Simd, F: Real> {
    /// Bounds of `s`, widened for rounding.
    least: Lanes<S, F>,
    most: Lanes<S, F>,
    /// Bound of `|u| + |v|`, and of the terms of which `v` is the difference.
    spread: Lanes<S, F>,
}

impl<S: Simd, F: Real> InPictureSimd<S, F> {
    /// Evaluates the linear `s` at the middle of the picture and at its farthest corners. `half` is half the picture's size, px.
    #[inline(always)]
    fn new(simd: S, e: &Ellipse<Lanes<S, F>>, [slope_u, slope_v]: [Lanes<S, F>; 2], half: [Lanes<S, F>; 2]) -> Self {
        let lanes = |value: f64| F::Lanes::<S>::splat(simd, F::of(value));
        let (zero, one) = (lanes(0.0), lanes(1.0));
        let [dx, dy] = [half[0] - e.mean_px[0], half[1] - e.mean_px[1]];
        let [far_x, far_y] = [dx.abs() + half[0], dy.abs() + half[1]];
        let [far_u, far_v] = [far_x / e.sigma_u, (far_y + e.shear.abs() * far_x) / e.sigma_v];
        let [by_u, by_v] = [slope_u / e.sigma_u, slope_v / e.sigma_v];
        let by_x = by_u - by_v * e.shear;
        let middle = one - by_u * dx - by_v * (dy - e.shear * dx);
        let terms = one + slope_u.abs() * far_u + slope_v.abs() * far_v;
        let span = by_x.abs() * half[0] + by_v.abs() * half[1] + terms * F::of(ROUNDING);
        let spread = far_u + far_v;
        // Beyond these limits `rasterize_rays` clamps.
        let known = spread.simd_lt(lanes(WHITENED_MAX)) & terms.simd_lt(lanes(WHITENED_MAX * WHITENED_MAX));
        let least = known.select((middle - span).max(zero), zero);
        Self { least, most: known.select(middle + span, F::Lanes::<S>::splat(simd, F::MAX)), spread }
    }

    /// Returns discs that hold the part of the visible region in the picture, with a negative scale if there is none, and whether each
    /// is known.
    #[inline(always)]
    fn disc(&self, slope: [Lanes<S, F>; 2], square: Lanes<S, F>) -> (WhitenedEllipseSimd<Lanes<S, F>>, MaskOf<S, F>) {
        let lanes = |value: F| F::Lanes::<S>::splat(self.most.token(), value);
        let zero = lanes(F::ZERO);
        let (sum, product) = (self.least + self.most, self.least * self.most);
        let middle = each!(slope, |slope| square * sum * slope * F::of(-0.5));
        let away = middle[0] * middle[0] + middle[1] * middle[1];
        let slack = (away + square * (sum + product)) * F::of(ROUNDING);
        let radius = away + square * (sum - product) + slack;
        let scale = (radius.sqrt() + self.spread * F::of(ROUNDING)) * F::of(1.0 / EXTENT);
        let scale = radius.simd_lt(zero).select(lanes(-F::ONE), scale);
        (WhitenedEllipseSimd { middle, column: [zero; 2], scale }, self.most.simd_lt(lanes(F::MAX)))
    }
}
