//! The CPU twin of the bounds.

use rayon::prelude::*;

use super::{DEPTH_SLOPE, EXTENT, LEAST, SLACK};
use crate::intersect::extent::whitened_limit;
use crate::linalg::norm;
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::simd::real::Real;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Returns rows `[N, 7]` for `intersect`, from packed ellipses `[N, 7]` and depth slopes `[N, 3]`. Culled Gaussians stay culled.
pub(crate) fn bounds_cpu<F: Real>(packed: &[F], depth_slopes: &[F], spec: &RasterizeSpec) -> Vec<F> {
    let mut bounds = vec![F::ZERO; packed.len()];
    let rows = (bounds.par_chunks_mut(COLUMNS), packed.par_chunks(COLUMNS), depth_slopes.par_chunks(DEPTH_SLOPE));
    rows.into_par_iter().with_min_len(CHUNK).for_each(|(out, row, depth_slope)| {
        out.copy_from_slice(
            &bounding_ellipse(&Ellipse::from_row(row), [depth_slope[0], depth_slope[1], depth_slope[2]], spec).to_row(),
        );
    });
    bounds
}

/// Returns the bounds of a Gaussian from its packed ellipse and its depth slope.
pub(crate) fn bounding_ellipse<F: Real>(
    e: &Ellipse<F>,
    [depth_slope_u, depth_slope_v, thickness]: [F; DEPTH_SLOPE],
    spec: &RasterizeSpec,
) -> Ellipse<F> {
    let alpha_min = F::of(spec.options.alpha_min);
    if !(e.opacity > F::ZERO && e.opacity >= alpha_min) {
        return *e;
    }
    let camera = &spec.intrinsics;
    let reached = alpha_min * F::of((0.5 * EXTENT * EXTENT).exp());
    let [width, height] = [camera.width, camera.height].map(|px| F::of(px as f64));
    let everywhere = Ellipse {
        mean_px: [width * F::of(0.5), height * F::of(0.5)],
        sigma_u: width + height,
        shear: F::ZERO,
        sigma_v: width + height,
        depth: e.depth,
        opacity: if alpha_min > F::ZERO { reached } else { F::ONE },
    };
    let [relative, absolute] = SLACK.map(F::of);
    let tau = whitened_limit(e.opacity, alpha_min) * (F::ONE + relative) + absolute;
    let across = thickness * tau.sqrt();
    let thin = F::ONE - across * across;
    if !(alpha_min > F::ZERO && thin > F::of(LEAST)) {
        return everywhere;
    }
    let c = (tau / thin).sqrt();
    let length = norm([depth_slope_u, depth_slope_v, F::ZERO]);
    let eccentricity = c * length;
    let rest = (F::ONE - eccentricity) * (F::ONE + eccentricity);
    if !(rest > F::of(LEAST)) {
        return everywhere;
    }
    let along = if length > F::ZERO { eccentricity / length } else { F::ZERO };
    // Offset from the focus to the middle, and the additional column, both in whitened coordinates.
    let shift = [depth_slope_u, depth_slope_v].map(|depth_slope| -(along * depth_slope) * (c / rest));
    let [g_u, g_v] = [depth_slope_u, depth_slope_v].map(|depth_slope| along * depth_slope / rest.sqrt());
    let scale = c / (rest.sqrt() * F::of(EXTENT));
    let wide = F::ONE + g_u * g_u;
    let row = Ellipse {
        mean_px: [
            e.mean_px[0] + e.sigma_u * shift[0],
            e.mean_px[1] + e.shear * e.sigma_u * shift[0] + e.sigma_v * shift[1],
        ],
        sigma_u: scale * e.sigma_u * wide.sqrt(),
        shear: e.shear + e.sigma_v / e.sigma_u * (g_u * g_v / wide),
        sigma_v: scale * e.sigma_v * ((wide + g_v * g_v) / wide).sqrt(),
        depth: e.depth,
        opacity: reached,
    };
    if row.to_row().iter().all(|value| value.finite()) { row } else { everywhere }
}
