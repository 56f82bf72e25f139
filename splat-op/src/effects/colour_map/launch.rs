//! Launches of the colour map.

use cubecl::prelude::CubeDim;

use super::kernels::{RUN, colour_map_kernel, image_backward_kernel, map_backward_kernel};
use super::{MAP, Mapped};
use crate::gpu::reduce::launch_column_sums;
use crate::gpu::{Buffer, Gpu, UNITS, cubes, elementwise};

/// Returns the mapped picture, `[3, H, W]`.
pub(crate) fn launch_colour_map(gpu: &Gpu, inputs: &Mapped<Buffer<f32>>) -> Buffer<f32> {
    let out = Buffer::new(gpu, inputs.image.len);
    let pixels = out.len / 3;
    let (grid, dim) = elementwise(pixels);
    let (image, map) = (inputs.image.arg(), inputs.map.arg());
    // SAFETY: units beyond the last pixel do nothing.
    unsafe { colour_map_kernel::launch_unchecked(&gpu.client, grid, dim, image, map, out.arg(), pixels as u32) };
    out
}

/// Returns the gradients that are needed from `grad`, that of the mapped picture.
pub(crate) fn launch_colour_map_backward(
    gpu: &Gpu,
    inputs: &Mapped<Buffer<f32>>,
    grad: &Buffer<f32>,
    needs: Mapped<bool>,
) -> Mapped<Option<Buffer<f32>>> {
    let (pixels, client) = (inputs.image.len / 3, &gpu.client);
    let of_image = Buffer::if_needed(gpu, needs.image, inputs.image.len);
    if let Some(out) = &of_image {
        let (grid, dim) = elementwise(pixels);
        let (map, grad) = (inputs.map.arg(), grad.arg());
        // SAFETY: units beyond the last pixel do nothing.
        unsafe { image_backward_kernel::launch_unchecked(client, grid, dim, map, grad, out.arg(), pixels as u32) };
    }
    let of_map = needs.map.then(|| {
        let runs = pixels.div_ceil(RUN);
        let sums = Buffer::new(gpu, runs * MAP);
        let (grid, dim) = (cubes(runs), CubeDim::new_1d(UNITS as u32));
        let (image, grad) = (inputs.image.arg(), grad.arg());
        // SAFETY: cubes beyond the last run do nothing, and runs end with the picture.
        unsafe {
            let (pixels, runs) = (pixels as u32, runs as u32);
            map_backward_kernel::launch_unchecked(client, grid, dim, image, grad, sums.arg(), pixels, runs);
        }
        launch_column_sums(gpu, &sums, MAP)
    });
    Mapped { image: of_image, map: of_map }
}
