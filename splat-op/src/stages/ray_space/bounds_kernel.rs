//! Kernel of the bounds: one unit per Gaussian.

use cubecl::prelude::*;

use super::lens_bounds_kernel::{BentRow, LensFrame, LensLimits};
use super::{EXTENT, LEAST_REMAINDER, LENS_FRAME, RAY_SPACE, ROUNDING, SLACK};
use crate::gpu::math::{Vec2, Vec3, finite, within};
use crate::project::forward::PackedEllipse;
use crate::rasterize_rays::WHITENED_MAX;

/// Returns a row that covers the whole picture.
#[cube]
fn everywhere(e: &PackedEllipse, width: f32, height: f32, reached: f32, alpha_min: f32) -> PackedEllipse {
    PackedEllipse {
        x: width * 0.5,
        y: height * 0.5,
        sigma_u: width + height,
        shear: 0.0f32.runtime(),
        sigma_v: width + height,
        depth: e.depth,
        opacity: select(alpha_min > 0.0, reached, 1.0),
    }
}

/// Returns the row of a Gaussian that does not show.
#[cube]
fn invisible(e: &PackedEllipse) -> PackedEllipse {
    PackedEllipse {
        x: e.x,
        y: e.y,
        sigma_u: e.sigma_u,
        shear: e.shear,
        sigma_v: e.sigma_v,
        depth: e.depth,
        opacity: 0.0f32.runtime(),
    }
}

/// An ellipse in whitened coordinates, as in the twin.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct WhitenedEllipse {
    middle_u: f32,
    middle_v: f32,
    column_u: f32,
    column_v: f32,
    scale: f32,
    /// Whether there is such an ellipse.
    known: bool,
}

#[cube]
impl WhitenedEllipse {
    fn area(&self) -> f32 {
        Vec3::new(1.0, self.column_u, self.column_v).length() * self.scale * self.scale
    }

    fn row(&self, e: &PackedEllipse, opacity: f32) -> PackedEllipse {
        let wide = 1.0 + self.column_u * self.column_u;
        PackedEllipse {
            x: e.x + e.sigma_u * self.middle_u,
            y: e.y + e.shear * e.sigma_u * self.middle_u + e.sigma_v * self.middle_v,
            sigma_u: self.scale * e.sigma_u * wide.sqrt(),
            shear: e.shear + e.sigma_v / e.sigma_u * (self.column_u * self.column_v / wide),
            sigma_v: self.scale * e.sigma_v * ((wide + self.column_v * self.column_v) / wide).sqrt(),
            depth: e.depth,
            opacity,
        }
    }
}

/// Returns the visible region if it is an ellipse.
#[cube]
fn whole_ellipse(slope_u: f32, slope_v: f32, square: f32) -> WhitenedEllipse {
    let least = comptime!(LEAST_REMAINDER as f32);
    let c = square.sqrt();
    // The eccentricity is `c` times the length of the depth slope.
    let eccentricity = c * Vec3::new(slope_u, slope_v, 0.0).length();
    let rest = (1.0 - eccentricity) * (1.0 + eccentricity);
    let known = rest > least && finite(rest);
    let rest = max(rest, least);
    let root = rest.sqrt();
    WhitenedEllipse {
        middle_u: -(c * slope_u) * (c / rest),
        middle_v: -(c * slope_v) * (c / rest),
        column_u: c * slope_u / root,
        column_v: c * slope_v / root,
        scale: c / (root * comptime!(EXTENT as f32)),
        known,
    }
}

/// What the picture contains of a Gaussian's whitened plane, as in the twin.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct InPicture {
    least: f32,
    most: f32,
    spread: f32,
    known: bool,
}

#[cube]
fn in_picture(e: &PackedEllipse, slope_u: f32, slope_v: f32, half_x: f32, half_y: f32) -> InPicture {
    let rounding = comptime!(ROUNDING as f32);
    let (dx, dy) = (half_x - e.x, half_y - e.y);
    let (far_x, far_y) = (dx.abs() + half_x, dy.abs() + half_y);
    let (far_u, far_v) = (far_x / e.sigma_u, (far_y + e.shear.abs() * far_x) / e.sigma_v);
    let (by_u, by_v) = (slope_u / e.sigma_u, slope_v / e.sigma_v);
    let by_x = by_u - by_v * e.shear;
    let middle = 1.0 - by_u * dx - by_v * (dy - e.shear * dx);
    let terms = 1.0 + slope_u.abs() * far_u + slope_v.abs() * far_v;
    let span = by_x.abs() * half_x + by_v.abs() * half_y + rounding * terms;
    let spread = far_u + far_v;
    let widest = comptime!(WHITENED_MAX as f32);
    InPicture {
        least: max(middle - span, 0.0),
        most: middle + span,
        spread,
        known: finite(spread)
            && finite(terms)
            && finite(middle)
            && finite(span)
            && spread < widest
            && terms < comptime!((WHITENED_MAX * WHITENED_MAX) as f32),
    }
}

/// Returns a disc that holds the part of the visible region in the picture; with a negative scale if there is none.
#[cube]
fn disc(seen: &InPicture, slope_u: f32, slope_v: f32, square: f32) -> WhitenedEllipse {
    let rounding = comptime!(ROUNDING as f32);
    let (sum, product) = (seen.least + seen.most, seen.least * seen.most);
    let toward = 0.5 * square * sum;
    let (middle_u, middle_v) = (-(toward * slope_u), -(toward * slope_v));
    let away = middle_u * middle_u + middle_v * middle_v;
    let slack = rounding * (away + square * (sum + product));
    let radius = away + square * (sum - product) + slack;
    let scale = (max(radius, 0.0).sqrt() + rounding * seen.spread) / comptime!(EXTENT as f32);
    WhitenedEllipse {
        middle_u,
        middle_v,
        column_u: 0.0f32.runtime(),
        column_v: 0.0f32.runtime(),
        scale: select(radius < 0.0, -1.0, scale),
        known: seen.known && finite(radius),
    }
}

/// Returns the smaller of two ellipses, or the one that there is.
#[cube]
fn smaller(ellipse: &WhitenedEllipse, disc: &WhitenedEllipse) -> WhitenedEllipse {
    let takes_disc = disc.known && (!ellipse.known || disc.area() < ellipse.area());
    WhitenedEllipse {
        middle_u: select(takes_disc, disc.middle_u, ellipse.middle_u),
        middle_v: select(takes_disc, disc.middle_v, ellipse.middle_v),
        column_u: select(takes_disc, disc.column_u, ellipse.column_u),
        column_v: select(takes_disc, disc.column_v, ellipse.column_v),
        scale: select(takes_disc, disc.scale, ellipse.scale),
        known: ellipse.known || disc.known,
    }
}

/// Returns the ellipse and the depth slope in the ray-space coordinates of the centre, as the twin.
#[cube]
fn about_centre(e: &PackedEllipse, z: Vec3, away_x: f32, away_y: f32) -> (PackedEllipse, Vec3) {
    let x = Vec3::new(e.sigma_u, 0.0, 0.0).minus(z.times(away_x));
    let y = Vec3::new(e.shear * e.sigma_u, e.sigma_v, 0.0).minus(z.times(away_y));
    let sigma_u = x.length();
    let n = x.times(1.0 / sigma_u);
    let across = n.cross(y);
    let sigma_v = across.length();
    let p = across.cross(n).times(1.0 / sigma_v);
    let moved = PackedEllipse {
        x: e.x,
        y: e.y,
        sigma_u,
        shear: n.dot(y) / sigma_u,
        sigma_v,
        depth: e.depth,
        opacity: e.opacity,
    };
    let there = away_x == 0.0 && away_y == 0.0;
    let slope = Vec3::new(
        select(there, z.x, n.dot(z)),
        select(there, z.y, p.dot(z)),
        select(there, z.z, z.z * (e.sigma_u / sigma_u) * (e.sigma_v / sigma_v)),
    );
    (moved, slope)
}

/// Returns the bounds of a Gaussian from `visible`: it is visible where `u² + v² <= square s²`, a row's opacity is `reached`, and
/// `square` is known if `ends` is set.
#[cube]
fn bounded(
    e: &PackedEllipse,
    slope: Vec2,
    visible: (f32, f32, bool),
    size: (f32, f32),
    ray_rows: &[f32],
    lens: &ComptimeOption<LensLimits>,
) -> BentRow {
    let (slope_u, slope_v) = (slope.x, slope.y);
    let (square, reached, ends) = visible;
    let (width, height) = size;
    let whole = whole_ellipse(slope_u, slope_v, square);
    #[comptime]
    match lens {
        ComptimeOption::Some(lens) => {
            let found = lens.bent(&whole.row(e, reached), e, &LensFrame::load(ray_rows, ABSOLUTE_POS));
            BentRow { row: found.row, known: whole.known && found.known, hidden: ends && whole.known && found.hidden }
        }
        ComptimeOption::None => {
            let seen = in_picture(e, slope_u, slope_v, width * 0.5, height * 0.5);
            let disc = disc(&seen, slope_u, slope_v, square);
            let found = smaller(&whole, &disc);
            let hidden = seen.known && (seen.most <= 0.0 || (ends && disc.known && disc.scale < 0.0));
            BentRow { row: found.row(e, reached), known: found.known, hidden }
        }
    }
}

/// Writes the bounds, `[N, 7]`.
#[cube(launch_unchecked)]
pub(super) fn bounds_kernel(
    projected: &[f32],
    ray_rows: &[f32],
    bounds: &mut [f32],
    width: f32,
    height: f32,
    alpha_min: f32,
    lens: ComptimeOption<LensLimits>,
    count: u32,
) {
    if ABSOLUTE_POS < count as usize {
        let e = PackedEllipse::load(projected, ABSOLUTE_POS);
        let at = ABSOLUTE_POS * comptime!(RAY_SPACE + if lens.is_some() { LENS_FRAME } else { 0 });
        let mut away_x = 0.0f32.runtime();
        let mut away_y = 0.0f32.runtime();
        if comptime!(lens.is_none()) {
            away_x = e.x - within(e.x, 0.0, width);
            away_y = e.y - within(e.y, 0.0, height);
        }
        let (moved, slope) = about_centre(&e, Vec3::load(ray_rows, at), away_x, away_y);
        let (slope_u, slope_v, thickness) = (slope.x, slope.y, slope.z);
        let least = comptime!(LEAST_REMAINDER as f32);
        let reached = alpha_min * comptime!((0.5 * EXTENT * EXTENT).exp() as f32);
        let faintest = max(alpha_min, f32::MIN_POSITIVE);
        let tau = 2.0 * (e.opacity / faintest).ln() * comptime!(1.0 + SLACK[0] as f32) + comptime!(SLACK[1] as f32);
        let across = thickness * tau.sqrt();
        let thin = 1.0 - across * across;
        let ends = alpha_min > 0.0 && thin > least && finite(thin);
        let square = tau / max(thin, least);
        let found =
            bounded(&moved, Vec2::new(slope_u, slope_v), (square, reached, ends), (width, height), ray_rows, &lens);
        let (row, hidden) = (found.row, found.hidden);
        let sound = finite(row.x) && finite(row.y) && finite(row.sigma_u) && finite(row.shear) && finite(row.sigma_v);
        if !(finite(e.opacity) && e.opacity > 0.0 && e.opacity >= alpha_min) {
            e.store(bounds, ABSOLUTE_POS);
        } else if hidden {
            invisible(&e).store(bounds, ABSOLUTE_POS);
        } else if ends && found.known && sound {
            row.store(bounds, ABSOLUTE_POS);
        } else {
            everywhere(&e, width, height, reached, alpha_min).store(bounds, ABSOLUTE_POS);
        }
    }
}
