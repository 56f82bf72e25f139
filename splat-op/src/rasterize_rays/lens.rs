//! The gradient of the columns that a lens adds to the depth slopes, in the CPU twin; `mod.rs` derives it.

use rayon::prelude::*;

use super::RayLayers;
use crate::depth_slope::{DEPTH_SLOPE, LENS_COLUMNS, LensFrame};
use crate::options::Projection;
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::simd::real::Real;

/// Gaussians per task.
const CHUNK: usize = 1024;

/// Adds the gradient of the lens's columns to that of the depth slopes: `[N, 3]` → `[N, 9]`. `grad_projected` is the gradient of
/// the ellipses, `[N, 7]`. With the affine projection both are zero.
pub(super) fn with_frames<F: Real>(
    inputs: &RayLayers<&[F]>,
    grad_projected: &[F],
    grad_slopes: &[F],
    spec: &RasterizeSpec,
) -> Vec<F> {
    let mut out = vec![F::ZERO; grad_slopes.len() / DEPTH_SLOPE * LENS_COLUMNS];
    if spec.options.projection == Projection::Affine {
        return out;
    }
    out.par_chunks_mut(LENS_COLUMNS).with_min_len(CHUNK).enumerate().for_each(|(i, out)| {
        let grad = &grad_projected[i * COLUMNS..][..COLUMNS];
        let of_slopes = &grad_slopes[i * DEPTH_SLOPE..][..DEPTH_SLOPE];
        out[..DEPTH_SLOPE].copy_from_slice(of_slopes);
        if grad.iter().chain(of_slopes).all(|value| *value == F::ZERO) {
            return;
        }
        let e = Ellipse::from_row(&inputs.projected[i * COLUMNS..]);
        let row = &inputs.depth_slope[i * LENS_COLUMNS..][..LENS_COLUMNS];
        let Some(frame) = LensFrame::of(row) else { return };
        // Σ U u, Σ U v, Σ V u, Σ V v
        let (uu, vv) = (-(e.sigma_u * grad[2]), -(e.sigma_v * grad[4]));
        let vu = -(e.sigma_v / e.sigma_u * grad[3]);
        let uv = vu + row[0] * of_slopes[1] - row[1] * of_slopes[0];
        // L⁻ᵀ M Lᵀ, row by row.
        let [lower_u, lower_v] =
            [[uu, uv], [vu, vv]].map(|[u, v]| [u * e.sigma_u, e.shear * e.sigma_u * u + e.sigma_v * v]);
        let across = [0, 1].map(|k| lower_v[k] / e.sigma_v);
        let along = [0, 1].map(|k| lower_u[k] / e.sigma_u - e.shear * across[k]);
        // The offsets t − t₀ are G⁻¹ d.
        let [[a, b], [c, d]] = frame.by;
        let determinant = a * d - b * c;
        for (k, [x, y]) in [along, across].into_iter().enumerate() {
            out[DEPTH_SLOPE + 2 + 2 * k] = (x * d - y * b) / determinant;
            out[DEPTH_SLOPE + 3 + 2 * k] = (y * a - x * c) / determinant;
        }
    });
    out
}
