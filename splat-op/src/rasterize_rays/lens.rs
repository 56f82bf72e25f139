//! The gradient of the columns that a lens adds to the depth slopes, in the CPU twin, for eight Gaussians at a time; `mod.rs` derives it.

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::RayLayers;
use crate::depth_slope::{DEPTH_SLOPE, LENS_COLUMNS};
use crate::options::Projection;
use crate::project::{COLUMNS, Ellipse};
use crate::rasterize::RasterizeSpec;
use crate::simd::each;
use crate::simd::lanes::{BLOCK, Columns};
use crate::simd::real::{LANES, Real};

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
    let chunks = (
        out.par_chunks_mut(CHUNK * LENS_COLUMNS),
        inputs.projected.par_chunks(CHUNK * COLUMNS),
        inputs.depth_slope.par_chunks(CHUNK * LENS_COLUMNS),
        grad_projected.par_chunks(CHUNK * COLUMNS),
        grad_slopes.par_chunks(CHUNK * DEPTH_SLOPE),
    );
    chunks.into_par_iter().for_each(|(out, ellipses, slopes, grad, of_slopes)| {
        dispatch!(Level::new(), simd => chunk::<_, F>(simd, out, [ellipses, slopes, grad, of_slopes]));
    });
    out
}

/// Writes the gradients of consecutive Gaussians.
#[inline(always)]
fn chunk<S: Simd, F: Real>(simd: S, out: &mut [F], [ellipses, slopes, grad, of_slopes]: [&[F]; 4]) {
    let (mut e, mut row, mut of_e) =
        (Columns::<F, COLUMNS>::new(), Columns::<F, LENS_COLUMNS>::new(), Columns::<F, COLUMNS>::new());
    let (mut of_row, mut found) = (Columns::<F, DEPTH_SLOPE>::new(), Columns::<F, LENS_COLUMNS>::new());
    for (block, out) in out.chunks_mut(BLOCK * LENS_COLUMNS).enumerate() {
        let first = block * BLOCK;
        e.read(&ellipses[first * COLUMNS..]);
        row.read(&slopes[first * LENS_COLUMNS..]);
        of_e.read(&grad[first * COLUMNS..]);
        of_row.read(&of_slopes[first * DEPTH_SLOPE..]);
        for at in (0..out.len() / LENS_COLUMNS).step_by(LANES) {
            let of_row = of_row.all_lanes(simd, at);
            let of_e = of_e.all_lanes(simd, at);
            let frame =
                of_frame::<S, F>(&Ellipse::from_row(&e.all_lanes(simd, at)), &row.all_lanes(simd, at), &of_e, &of_row);
            let zero = F::Lanes::<S>::splat(simd, F::ZERO);
            let mut nothing = of_row[0].simd_eq(zero);
            for value in of_row[1..].iter().chain(&of_e) {
                nothing &= value.simd_eq(zero);
            }
            for (column, value) in of_row.into_iter().enumerate() {
                found.store(column, at, value);
            }
            for (column, value) in frame.into_iter().enumerate() {
                found.store(DEPTH_SLOPE + 2 + column, at, nothing.select(zero, value));
            }
        }
        found.write(out);
    }
}

/// Returns the gradients of `G`, row by row, from those of ellipses, of depth slopes and of thicknesses.
#[inline(always)]
fn of_frame<S: Simd, F: Real>(
    e: &Ellipse<F::Lanes<S>>,
    row: &[F::Lanes<S>; LENS_COLUMNS],
    of_e: &[F::Lanes<S>; COLUMNS],
    of_row: &[F::Lanes<S>; DEPTH_SLOPE],
) -> [F::Lanes<S>; 4] {
    // Σ U u, Σ U v, Σ V u, Σ V v
    let (uu, vv) = (-(e.sigma_u * of_e[2]), -(e.sigma_v * of_e[4]));
    let vu = -(e.sigma_v / e.sigma_u * of_e[3]);
    let uv = vu + row[0] * of_row[1] - row[1] * of_row[0];
    // L⁻ᵀ M Lᵀ, row by row.
    let [lower_u, lower_v] =
        each!([[uu, uv], [vu, vv]], |[u, v]| [u * e.sigma_u, e.shear * e.sigma_u * u + e.sigma_v * v]);
    let across = each!(lower_v, |value| value / e.sigma_v);
    let along = each!([0, 1], |k| lower_u[k] / e.sigma_u - e.shear * across[k]);
    // The offsets t − t₀ are G⁻¹ d.
    let [.., a, b, c, d] = *row;
    let determinant = a * d - b * c;
    let [[of_a, of_b], [of_c, of_d]] =
        each!([along, across], |[x, y]| [(x * d - y * b) / determinant, (y * a - x * c) / determinant]);
    [of_a, of_b, of_c, of_d]
}
