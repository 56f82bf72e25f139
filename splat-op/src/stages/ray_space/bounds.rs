//! Bounds of a Gaussian in the picture, for the kernels and the CPU twin.

use super::lens_bounds::{Bounded, LensFrame, LensLimits};
use super::{DEPTH_SLOPE, EXTENT, LEAST_REMAINDER, ROUNDING, SLACK};
use crate::linalg::{Number, cross, dot, scale, sub};
use crate::project::Ellipse;
use crate::rasterize_rays::WHITENED_MAX;
use crate::simd::each;

/// What bounds need to know of a picture.
pub(super) struct BoundsRules<N> {
    /// Width and height, px.
    pub size: [N; 2],
    pub alpha_min: N,
    /// `None` for a pinhole.
    pub limits: Option<LensLimits<N>>,
}

#[inline(always)]
fn select<N: Number>(mask: N::Mask, then: &Ellipse<N>, or: &Ellipse<N>) -> Ellipse<N> {
    Ellipse::from_row(&N::select_all(mask, then.to_row(), or.to_row()))
}

impl<N: Number> BoundsRules<N> {
    /// Returns the bounds of a Gaussian from its packed ellipse and its row. The row of a Gaussian that shows nowhere in the
    /// picture has no opacity.
    #[inline(always)]
    pub fn bound(&self, given: &Ellipse<N>, row: &[N]) -> Ellipse<N> {
        let alpha_min = self.alpha_min;
        let (zero, one) = (alpha_min.constant(0.0), alpha_min.constant(1.0));
        let (e, [slope_u, slope_v, thickness]) = self.about_centre(given, [row[0], row[1], row[2]]);
        let slope = [slope_u, slope_v];
        let faintest = alpha_min.max(one.constant(f32::MIN_POSITIVE.into()));
        let tau = (given.opacity / faintest).ln() * (2.0 * (1.0 + SLACK[0])) + SLACK[1];
        let across = thickness * tau.sqrt();
        let (thin, least) = (one - across * across, one.constant(LEAST_REMAINDER));
        // Without a least alpha nothing has an end.
        let bounded = alpha_min.gt(zero);
        let ends = bounded & thin.gt(least) & thin.finite();
        let square = tau / thin.max(least);
        let whole = WhitenedEllipse::whole(slope, square);
        // The opacity with which the extent of a row is `EXTENT`.
        let reached = N::select(bounded, alpha_min * (0.5 * EXTENT * EXTENT).exp(), one);
        let Bounded { row: found, known, hidden } = match &self.limits {
            Some(limits) => {
                let frame = LensFrame::of(row).expect("rows of a lens have its columns");
                let bent = limits.bent(&whole.row(&e, reached), &e, &frame);
                Bounded { known: whole.known & bent.known, hidden: ends & whole.known & bent.hidden, ..bent }
            }
            None => {
                let seen = InPicture::new(&e, slope, each!(self.size, |px| px * 0.5));
                let disc = seen.disc(slope, square);
                let nowhere = seen.most.le(zero) | (ends & disc.known & disc.scale.lt(zero));
                let smaller = whole.or_smaller(&disc);
                Bounded { row: smaller.row(&e, reached), known: smaller.known, hidden: seen.known & nowhere }
            }
        };
        let mut known = ends & known;
        for value in [found.mean_px[0], found.mean_px[1], found.sigma_u, found.shear, found.sigma_v] {
            known = known & value.finite();
        }
        let sum = self.size[0] + self.size[1];
        let everywhere = Ellipse {
            mean_px: each!(self.size, |px| px * 0.5),
            sigma_u: sum,
            shear: zero,
            sigma_v: sum,
            depth: given.depth,
            opacity: reached,
        };
        let bounds = select(known, &found, &everywhere);
        let bounds = select(hidden, &Ellipse { opacity: zero, ..*given }, &bounds);
        let shows = given.opacity.finite() & given.opacity.gt(zero) & given.opacity.ge(alpha_min);
        select(shows, &bounds, given)
    }

    /// Returns the ellipse, the depth slope and the thickness in the ray-space coordinates of the centre, from those of the point of the
    /// picture next to it.
    #[inline(always)]
    fn about_centre(&self, e: &Ellipse<N>, z: [N; DEPTH_SLOPE]) -> (Ellipse<N>, [N; DEPTH_SLOPE]) {
        if self.limits.is_some() {
            return (*e, z);
        }
        let zero = e.depth.constant(0.0);
        let away = each!([0, 1], |axis| e.mean_px[axis] - e.mean_px[axis].max(zero).min(self.size[axis]));
        let inside = away[0].eq(zero) & away[1].eq(zero);
        if !N::any(!inside) {
            return (*e, z);
        }
        let x = sub([e.sigma_u, zero, zero], scale(z, away[0]));
        let y = sub([e.shear * e.sigma_u, e.sigma_v, zero], scale(z, away[1]));
        let sigma_u = N::length(x);
        let n = scale(x, zero.constant(1.0) / sigma_u);
        let across = cross(n, y);
        let sigma_v = N::length(across);
        let p = scale(cross(across, n), zero.constant(1.0) / sigma_v);
        let moved = Ellipse { sigma_u, shear: dot(n, y) / sigma_u, sigma_v, ..*e };
        let slope = [dot(n, z), dot(p, z), z[2] * (e.sigma_u / sigma_u) * (e.sigma_v / sigma_v)];
        (select(inside, e, &moved), N::select_all(inside, z, slope))
    }
}

/// An ellipse in whitened coordinates: the disc of the radius `EXTENT`, scaled, with an additional column of its factor.
struct WhitenedEllipse<N: Number> {
    middle: [N; 2],
    column: [N; 2],
    scale: N,
    /// Whether there is such an ellipse.
    known: N::Mask,
}

impl<N: Number> WhitenedEllipse<N> {
    /// Returns the visible region where it is an ellipse. `square` is `c²`.
    #[inline(always)]
    fn whole(slope: [N; 2], square: N) -> Self {
        let one = square.constant(1.0);
        let c = square.sqrt();
        let eccentricity = c * slope[0].hypotenuse(slope[1]);
        let rest = (one - eccentricity) * (one + eccentricity);
        let least = one.constant(LEAST_REMAINDER);
        let known = rest.gt(least) & rest.finite();
        let rest = rest.max(least);
        let root = rest.sqrt();
        Self {
            middle: each!(slope, |slope| -(c * slope) * (c / rest)),
            column: each!(slope, |slope| c * slope / root),
            scale: c / (root * EXTENT),
            known,
        }
    }

    /// Returns a number that grows with the area.
    #[inline(always)]
    fn area(&self) -> N {
        N::length([self.scale.constant(1.0), self.column[0], self.column[1]]) * self.scale * self.scale
    }

    /// Returns the smaller one of this ellipse and a disc, or the one that there is.
    #[inline(always)]
    fn or_smaller(&self, disc: &Self) -> Self {
        let takes_disc = disc.known & (!self.known | disc.area().lt(self.area()));
        Self {
            middle: N::select_all(takes_disc, disc.middle, self.middle),
            column: N::select_all(takes_disc, disc.column, self.column),
            scale: N::select(takes_disc, disc.scale, self.scale),
            known: self.known | disc.known,
        }
    }

    /// Returns the row of the Gaussian `e` whose extent is this ellipse.
    #[inline(always)]
    fn row(&self, e: &Ellipse<N>, opacity: N) -> Ellipse<N> {
        let (shift, [g_u, g_v]) = (self.middle, self.column);
        let wide = g_u * g_u + 1.0;
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

/// What the picture contains of a Gaussian's whitened plane.
struct InPicture<N: Number> {
    /// Bounds of `s`, widened for rounding.
    least: N,
    most: N,
    /// Bound of `|u| + |v|`, and of the terms of which `v` is the difference.
    spread: N,
    /// Whether these are bounds.
    known: N::Mask,
}

impl<N: Number> InPicture<N> {
    /// Evaluates the linear `s` at the middle of the picture and at its farthest corners. `half` is half the picture's size, px.
    #[inline(always)]
    fn new(e: &Ellipse<N>, [slope_u, slope_v]: [N; 2], half: [N; 2]) -> Self {
        let (zero, one) = (e.depth.constant(0.0), e.depth.constant(1.0));
        let [dx, dy] = [half[0] - e.mean_px[0], half[1] - e.mean_px[1]];
        let [far_x, far_y] = [dx.abs() + half[0], dy.abs() + half[1]];
        let [far_u, far_v] = [far_x / e.sigma_u, (far_y + e.shear.abs() * far_x) / e.sigma_v];
        let [by_u, by_v] = [slope_u / e.sigma_u, slope_v / e.sigma_v];
        let by_x = by_u - by_v * e.shear;
        let middle = one - by_u * dx - by_v * (dy - e.shear * dx);
        let terms = slope_u.abs() * far_u + slope_v.abs() * far_v + 1.0;
        let span = by_x.abs() * half[0] + by_v.abs() * half[1] + terms * ROUNDING;
        let spread = far_u + far_v;
        // Beyond these limits `rasterize_rays` clamps.
        let unclamped = spread.lt(one.constant(WHITENED_MAX)) & terms.lt(one.constant(WHITENED_MAX * WHITENED_MAX));
        let finite = spread.finite() & terms.finite() & middle.finite() & span.finite();
        Self { least: (middle - span).max(zero), most: middle + span, spread, known: finite & unclamped }
    }

    /// Returns a disc that holds the part of the visible region in the picture, with a negative scale if there is none.
    #[inline(always)]
    fn disc(&self, slope: [N; 2], square: N) -> WhitenedEllipse<N> {
        let zero = square.constant(0.0);
        let (sum, product) = (self.least + self.most, self.least * self.most);
        let toward = square * sum * -0.5;
        let middle = each!(slope, |slope| toward * slope);
        let away = middle[0] * middle[0] + middle[1] * middle[1];
        let slack = (away + square * (sum + product)) * ROUNDING;
        let radius = away + square * (sum - product) + slack;
        let scale = (radius.max(zero).sqrt() + self.spread * ROUNDING) * (1.0 / EXTENT);
        WhitenedEllipse {
            middle,
            column: [zero; 2],
            scale: N::select(radius.lt(zero), zero.constant(-1.0), scale),
            known: self.known & radius.finite(),
        }
    }
}
