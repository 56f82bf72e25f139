//! The gradient of the columns that a lens adds to the depth slopes, in a kernel; `mod.rs` derives it.

use cubecl::prelude::*;

use super::RayLayers;
use crate::depth_slope::{DEPTH_SLOPE, LENS_FRAME, LensFrameKernel as LensFrame};
use crate::gpu::math::Vec2;
use crate::gpu::{Buffer, Gpu, elementwise};
use crate::options::Projection;
use crate::project::COLUMNS;
use crate::project::forward::PackedEllipse;
use crate::rasterize::RasterizeSpec;

/// Writes the gradient of the depth slopes, `[N, 9]`, from that of the ellipses, `[N, 7]`, and of the first three columns, `[N, 3]`.
#[cube(launch_unchecked)]
fn frames_kernel(
    projected: &[f32],
    depth_slopes: &[f32],
    grad_projected: &[f32],
    grad_slopes: &[f32],
    out: &mut [f32],
    count: u32,
) {
    let gaussian = ABSOLUTE_POS;
    if gaussian < count as usize {
        let row = gaussian * comptime!(DEPTH_SLOPE + LENS_FRAME);
        let e = PackedEllipse::load(projected, gaussian);
        let grad = PackedEllipse::load(grad_projected, gaussian);
        let frame = LensFrame::load(depth_slopes, gaussian);
        let slopes = gaussian * comptime!(DEPTH_SLOPE);
        let (of_u, of_v) = (grad_slopes[slopes], grad_slopes[slopes + 1]);
        let uu = -(e.sigma_u * grad.sigma_u);
        let vv = -(e.sigma_v * grad.sigma_v);
        let vu = -(e.sigma_v / e.sigma_u * grad.shear);
        let uv = vu + depth_slopes[row] * of_v - depth_slopes[row + 1] * of_u;
        let lean = e.shear * e.sigma_u;
        let inverse_v = 1.0 / e.sigma_v;
        let across = Vec2::new(vu * e.sigma_u * inverse_v, (lean * vu + e.sigma_v * vv) * inverse_v);
        let along = Vec2::new(uu - e.shear * across.x, (lean * uu + e.sigma_v * uv) / e.sigma_u - e.shear * across.y);
        let determinant = frame.x.x * frame.y.y - frame.x.y * frame.y.x;
        // A culled Gaussian has no lens.
        let seen = determinant != 0.0;
        let inverse = select(seen, 1.0 / select(seen, determinant, 1.0), 0.0);
        out[row] = of_u;
        out[row + 1] = of_v;
        out[row + 2] = grad_slopes[slopes + 2];
        out[row + 3] = 0.0;
        out[row + 4] = 0.0;
        out[row + 5] = (along.x * frame.y.y - along.y * frame.x.y) * inverse;
        out[row + 6] = (along.y * frame.x.x - along.x * frame.y.x) * inverse;
        out[row + 7] = (across.x * frame.y.y - across.y * frame.x.y) * inverse;
        out[row + 8] = (across.y * frame.x.x - across.x * frame.y.x) * inverse;
    }
}

/// Adds the gradient of the lens's columns to that of the depth slopes: `[N, 3]` → `[N, 9]`. With the affine projection both are
/// zero.
pub(super) fn launch_frames(
    gpu: &Gpu,
    inputs: &RayLayers<Buffer<f32>>,
    grad_projected: &Buffer<f32>,
    grad_slopes: &Buffer<f32>,
    spec: &RasterizeSpec,
) -> Buffer<f32> {
    let count = grad_projected.len / COLUMNS;
    let len = count * (DEPTH_SLOPE + LENS_FRAME);
    if spec.options.projection == Projection::Affine {
        return Buffer::zeros(gpu, len);
    }
    let out = Buffer::new(gpu, len);
    if count > 0 {
        let (grid, dim) = elementwise(count);
        // SAFETY: every access is guarded by the number of Gaussians.
        unsafe {
            frames_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                inputs.projected.arg(),
                inputs.depth_slope.arg(),
                grad_projected.arg(),
                grad_slopes.arg(),
                out.arg(),
                count as u32,
            );
        }
    }
    out
}
