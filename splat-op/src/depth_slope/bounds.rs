//! The CPU twin of the bounds.

use rayon::prelude::*;

use super::{DEPTH_SLOPE, EXTENT, LEAST, LensFrame, LensLimits, ROUNDING, SLACK, columns};
use crate::camera::{CameraModel, Intrinsics, PictureRays};
use crate::intersect::extent::whitened_limit;
use crate::linalg::{cross, dot, norm, scale};
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::rasterize_rays::WHITENED_MAX;
use crate::simd::real::Real;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Returns rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and depth slopes `[N, 3]`. Culled Gaussians stay culled.
pub(crate) fn bounds_cpu<F: Real>(packed: &[F], depth_slopes: &[F], spec: &RasterizeSpec) -> Vec<F> {
    let mut bounds = vec![F::ZERO; packed.len()];
    let slopes = depth_slopes.par_chunks(columns(&spec.intrinsics));
    let lens = PictureRays::of(&spec.intrinsics).map(|rays| LensLimits::new(&spec.intrinsics, &rays));
    let rows = (bounds.par_chunks_mut(COLUMNS), packed.par_chunks(COLUMNS), slopes);
    rows.into_par_iter().with_min_len(CHUNK).for_each(|(out, row, depth_slope)| {
        out.copy_from_slice(&bounding_ellipse(&Ellipse::from_row(row), depth_slope, (spec, lens.as_ref())).to_row());
    });
    bounds
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

/// Returns the ellipse and the depth slope in the ray-space coordinates of the centre, from those of the point that lies `away` px
/// before the centre.
fn about_centre<F: Real>(
    e: &Ellipse<F>,
    [slope_u, slope_v, thickness]: [F; DEPTH_SLOPE],
    away: [F; 2],
) -> (Ellipse<F>, [F; DEPTH_SLOPE]) {
    let z = [slope_u, slope_v, thickness];
    let x = [e.sigma_u - away[0] * slope_u, -away[0] * slope_v, -away[0] * thickness];
    let y = [e.shear * e.sigma_u - away[1] * slope_u, e.sigma_v - away[1] * slope_v, -away[1] * thickness];
    let sigma_u = norm(x);
    let n = scale(x, F::ONE / sigma_u);
    let across = cross(n, y);
    let sigma_v = norm(across);
    let p = scale(cross(across, n), F::ONE / sigma_v);
    let thickness = thickness * (e.sigma_u / sigma_u) * (e.sigma_v / sigma_v);
    (Ellipse { sigma_u, shear: dot(n, y) / sigma_u, sigma_v, ..*e }, [dot(n, z), dot(p, z), thickness])
}

/// Returns the bounds of a Gaussian from its packed ellipse and its row of depth slopes, with the limits of the lens if the camera
/// is no pinhole. The row of a Gaussian that shows nowhere in the picture has no opacity.
pub(crate) fn bounding_ellipse<F: Real>(
    e: &Ellipse<F>,
    depth_slope: &[F],
    (spec, lens): (&RasterizeSpec, Option<&LensLimits<F>>),
) -> Ellipse<F> {
    let alpha_min = F::of(spec.options.alpha_min);
    if !(e.opacity > F::ZERO && e.opacity >= alpha_min) {
        return *e;
    }
    let hidden = Ellipse { opacity: F::ZERO, ..*e };
    let camera = &spec.intrinsics;
    let away = beyond(e.mean_px, camera).1;
    let lens = lens.zip(LensFrame::of(depth_slope));
    let own = [depth_slope[0], depth_slope[1], depth_slope[2]];
    let (e, [slope_u, slope_v, thickness]) = match away == [F::ZERO; 2] {
        true => (*e, own),
        false => about_centre(e, own, away),
    };
    let e = &e;
    let reached = alpha_min * F::of((0.5 * EXTENT * EXTENT).exp());
    let half = [camera.width, camera.height].map(|px| F::of(0.5 * px as f64));
    let width_and_height = F::of(2.0) * (half[0] + half[1]);
    let everywhere = Ellipse {
        mean_px: half,
        sigma_u: width_and_height,
        shear: F::ZERO,
        sigma_v: width_and_height,
        depth: e.depth,
        opacity: if alpha_min > F::ZERO { reached } else { F::ONE },
    };
    let slope = [slope_u, slope_v];
    let seen = InPicture::new(e, slope, half);
    if lens.is_none() && seen.most <= F::ZERO {
        return hidden;
    }
    let [relative, absolute] = SLACK.map(F::of);
    let tau = whitened_limit(e.opacity, alpha_min) * (F::ONE + relative) + absolute;
    let across = thickness * tau.sqrt();
    let thin = F::ONE - across * across;
    if !(alpha_min > F::ZERO && thin > F::of(LEAST)) {
        return everywhere;
    }
    let square = tau / thin;
    if let Some((limits, frame)) = lens {
        let row = whole_ellipse(slope, square).and_then(|whole| limits.bent(&whole.row(e, reached), e, &frame));
        return row.filter(|row| row.to_row().iter().all(|value| value.finite())).unwrap_or(everywhere);
    }
    let disc = match seen.disc(slope, square) {
        Some(disc) if disc.scale < F::ZERO => return hidden,
        disc => disc,
    };
    let ellipse = whole_ellipse(slope, square);
    let smaller = match (ellipse, disc) {
        (Some(ellipse), Some(disc)) if disc.area() < ellipse.area() => disc,
        (Some(ellipse), _) => ellipse,
        (None, Some(disc)) => disc,
        (None, None) => return everywhere,
    };
    let row = smaller.row(e, reached);
    if row.to_row().iter().all(|value| value.finite()) { row } else { everywhere }
}

/// An ellipse in whitened coordinates: the disc of the radius `EXTENT`, scaled, with an additional column of its factor.
struct Whitened<F> {
    middle: [F; 2],
    column: [F; 2],
    scale: F,
}

impl<F: Real> Whitened<F> {
    /// Returns a number that grows with the area.
    fn area(&self) -> F {
        norm([F::ONE, self.column[0], self.column[1]]) * self.scale * self.scale
    }

    /// Returns the row of the Gaussian `e` whose extent is this ellipse.
    fn row(&self, e: &Ellipse<F>, opacity: F) -> Ellipse<F> {
        let (shift, [g_u, g_v]) = (self.middle, self.column);
        let wide = F::ONE + g_u * g_u;
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

/// Returns the visible region if it is an ellipse. `square` is `c²`.
fn whole_ellipse<F: Real>(slope: [F; 2], square: F) -> Option<Whitened<F>> {
    let c = square.sqrt();
    let length = norm([slope[0], slope[1], F::ZERO]);
    let eccentricity = c * length;
    let rest = (F::ONE - eccentricity) * (F::ONE + eccentricity);
    if !(rest > F::of(LEAST)) {
        return None;
    }
    let along = if length > F::ZERO { eccentricity / length } else { F::ZERO };
    Some(Whitened {
        middle: slope.map(|slope| -(along * slope) * (c / rest)),
        column: slope.map(|slope| along * slope / rest.sqrt()),
        scale: c / (rest.sqrt() * F::of(EXTENT)),
    })
}

/// What the picture contains of a Gaussian's whitened plane.
struct InPicture<F> {
    /// Bounds of `s`, widened for rounding.
    least: F,
    most: F,
    /// Bound of `|u| + |v|`, and of the terms of which `v` is the difference.
    spread: F,
}

impl<F: Real> InPicture<F> {
    /// Evaluates the linear `s` at the middle of the picture and at its farthest corners. `half` is half the picture's size, px.
    fn new(e: &Ellipse<F>, [slope_u, slope_v]: [F; 2], half: [F; 2]) -> Self {
        let [dx, dy] = [half[0] - e.mean_px[0], half[1] - e.mean_px[1]];
        let [far_x, far_y] = [dx.abs() + half[0], dy.abs() + half[1]];
        let [far_u, far_v] = [far_x / e.sigma_u, (far_y + e.shear.abs() * far_x) / e.sigma_v];
        let [by_u, by_v] = [slope_u / e.sigma_u, slope_v / e.sigma_v];
        let by_x = by_u - by_v * e.shear;
        let middle = F::ONE - by_u * dx - by_v * (dy - e.shear * dx);
        let terms = F::ONE + slope_u.abs() * far_u + slope_v.abs() * far_v;
        let span = by_x.abs() * half[0] + by_v.abs() * half[1] + F::of(ROUNDING) * terms;
        let (least, most) = ((middle - span).max_of(F::ZERO), middle + span);
        let spread = far_u + far_v;
        // Beyond these limits `rasterize_rays` clamps.
        let known = spread < F::of(WHITENED_MAX) && terms < F::of(WHITENED_MAX * WHITENED_MAX);
        if known { Self { least, most, spread } } else { Self { least: F::ZERO, most: F::MAX, spread } }
    }

    /// Returns a disc that holds the part of the visible region in the picture; with a negative scale if there is none.
    fn disc(&self, slope: [F; 2], square: F) -> Option<Whitened<F>> {
        if !(self.most < F::MAX) {
            return None;
        }
        let (sum, product) = (self.least + self.most, self.least * self.most);
        let middle = slope.map(|slope| F::of(-0.5) * square * sum * slope);
        let away = middle[0] * middle[0] + middle[1] * middle[1];
        let slack = F::of(ROUNDING) * (away + square * (sum + product));
        let radius = away + square * (sum - product) + slack;
        let scale =
            if radius < F::ZERO { -F::ONE } else { (radius.sqrt() + F::of(ROUNDING) * self.spread) / F::of(EXTENT) };
        Some(Whitened { middle, column: [F::ZERO; 2], scale })
    }
}
