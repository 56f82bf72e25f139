//! Launch of the tally.

use super::forward::tally_kernel;
use crate::gpu::math::Vec2Launch;
use crate::gpu::{Buffer, Gpu, elementwise};

/// Adds a step to `sums` and `counts`, `[N]`, in place; writes them without reading if the tally `begins`.
pub(crate) fn launch_tally(
    gpu: &Gpu,
    grad: &Buffer<f32>,
    sums: &Buffer<f32>,
    counts: &Buffer<f32>,
    [x, y]: [f32; 2],
    begins: bool,
) {
    if sums.len > 0 {
        let (grid, dim) = elementwise(sums.len);
        let (grad, count, sums, counts) = (grad.arg(), sums.len as u32, sums.arg(), counts.arg());
        // SAFETY: every access is guarded by the number of Gaussians.
        unsafe {
            tally_kernel::launch_unchecked(
                &gpu.client,
                grid,
                dim,
                grad,
                sums,
                counts,
                Vec2Launch::new(x, y),
                count,
                begins,
            );
        }
    }
}
